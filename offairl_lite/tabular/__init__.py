"""Tabular Markov decision processes (MDPs), solved exactly, and maximum entropy IRL on them.

In this package S and A are the number of states and the number of actions, and T is the horizon; S
is not the size of the population, as it is elsewhere. Everything is NumPy and SciPy in double
precision, for any MDP given as arrays. A reward has shape (S,), (S, A) or (S, A, S), and is finite.
A policy has shape (S, A), or with a horizon also (T, S, A). Functions raise ValueError for
arguments of another shape, and for a policy that is not a distribution over actions. Occupancies
are sums, not averages: they add up to 1 + γ + γ² + ..., so that the return of a reward is its sum
weighted by the occupancy.
"""

# ruff: noqa: F401, I001
from offairl_lite.tabular.identification import Apart, Separation, apart, counted, hidden
from offairl_lite.tabular.identification import separation, shapings, shared_reward
from offairl_lite.tabular.maxent import Fit, log_likelihood, maxent_irl
from offairl_lite.tabular.mazes import MOVES, Maze, maze
from offairl_lite.tabular.mdp import MDP
from offairl_lite.tabular.planning import Solution, occupancy, policy_return, shaping
from offairl_lite.tabular.planning import soft_evaluation, soft_value_iteration
from offairl_lite.tabular.sampling import Trajectories, empirical_occupancy, sample
