"""What is made of runs: statistics, distances between rewards, figures and films."""
