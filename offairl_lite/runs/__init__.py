"""Runs as folders: made, killed, resumed, swept over, and the command line."""
