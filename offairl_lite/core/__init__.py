"""Off-policy AIRL for a population of seeds: networks, losses, learners and Algorithm 1."""
