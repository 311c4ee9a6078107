"""What the note on paths and policies says."""

from itertools import product

import numpy as np

from checks import exact
from offairl_lite.tabular import MDP


@exact
def equal_without_slip(differences):
    """In deterministic dynamics the two policies are the same."""
    assert differences[0] < 1e-9


@exact
def different_with_slip(differences):
    """In random dynamics they differ."""
    assert min(differences[1:]) > 0.01


@exact
def causal_gambles_half(causal):
    """The causal policy takes the lottery with probability 0.5."""
    assert np.allclose(causal, 0.5)


@exact
def optimist_weighs_by_cosh(optimist, stakes):
    """Under the distribution over paths the lottery weighs cosh(x)."""
    weight = np.cosh(stakes)
    assert np.allclose(optimist, weight / (1 + weight))


@exact
def optimist_gambles_more(optimist):
    """The optimist gambles more, the more there is to lose."""
    assert (np.diff(optimist) > 0).all()


@exact
def causal_does_not_learn_the_stake(likelihood):
    """The causal likelihood is the same for all stakes."""
    assert np.ptp(likelihood["causal"]) < 1e-12


@exact
def paths_conclude_that_nothing_is_at_stake(likelihood):
    """The likelihood of the path model is largest at x = 0."""
    assert np.all(np.diff(likelihood["paths"]) < -0.1)


@exact
def messages_count_all_paths(path_messages, path_occupancy):
    """The messages give the partition sum and the visits of all paths of a
    small random process, added one by one."""
    rng = np.random.default_rng(0)
    p, r = rng.dirichlet(np.ones(3), (3, 2)), rng.normal(size=(3, 2))
    partition, visited = 0.0, np.zeros((3, 2))
    for s, t, a, b, c in product(range(3), range(3), *[range(2)] * 3):
        path = (0, a), (s, b), (t, c)
        reward = sum(r[pair] for pair in path)
        weight = p[0, a, s] * p[s, b, t] * np.exp(reward / 0.7)
        partition += weight
        for pair in path:
            visited[pair] += weight
    small = MDP(p, np.eye(3)[0], discount=1.0, horizon=3)
    policies, value, after = path_messages(small, r, 0.7)
    visits = path_occupancy(small, policies, after, 0.7)
    assert np.isclose(value[0], 0.7 * np.log(partition))
    assert np.allclose(visits, visited / partition)


@exact
def tilted_visits_are_the_gradient(path_likelihood, claimed, jacobian):
    """With visits in tilted dynamics the difference is the gradient."""
    e = 1e-5
    up, down = (path_likelihood(np.array([0, 1 + d, -1])) for d in (e, -e))
    tilted, _ = claimed([1.0, -1.0])
    assert np.isclose((up - down) / (2 * e), tilted[0], atol=1e-6)
    assert np.allclose(jacobian(0), jacobian(0).T, atol=1e-6)


@exact
def true_visits_are_no_gradient(claimed, jacobian):
    """With visits in the true dynamics it is not, nor any gradient: its
    Jacobian is not symmetric."""
    tilted, true = claimed([1.0, -1.0])
    assert abs(tilted[0] - true[0]) > 0.05
    assert np.abs(jacobian(1) - jacobian(1).T).max() > 0.02
