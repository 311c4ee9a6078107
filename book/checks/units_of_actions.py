"""What the note on entropy, units, and the end of an episode says."""

import math

import numpy as np

from checks import exact
from offairl_lite import tabular
from offairl_lite.core.experience import analytic_return

LEFT, RIGHT, END, ALPHA = 0, 2, 3, 0.2


@exact
def entropy_of_the_end(gap, entropy, gamma):
    """Entropy that is counted after the end is worth γ α H / (1 − γ) to the
    step that ends."""
    assert math.isclose(gap, gamma * ALPHA * entropy / (1 - gamma))


@exact
def without_entropy(without, gamma):
    """Without it the last step is worth what the closed form says."""
    last = analytic_return(1, -0.2, gamma)
    assert np.allclose(without[2, RIGHT], last)


@exact
def uniform_in_the_end(mdp, reward):
    """Nothing draws the actor to one action in the end: it is uniform
    there."""
    reply = tabular.soft_value_iteration(mdp, reward(-0.2), ALPHA)
    assert np.allclose(reply.policy[END], 1 / 3)


@exact
def bonus_for_dying():
    """With three motors and α = 0.2 the entropy adds 41 to the value of the
    end."""
    bonus = 0.99 * 0.2 * 3 * math.log(2) / (1 - 0.99)
    assert round(bonus) == 41


@exact
def no_reward(falls):
    """If no reward is paid and entropy is counted in the end, the agent
    falls in one case of three; if it is not, hardly ever."""
    assert math.isclose(falls[0], 1 / 3)
    assert falls[1] < 0.05


@exact
def at_the_target():
    """With three motors c is −0.25 a step at α = 0.05, and −0.15 by the
    package's choice."""
    counted, left_out = 0.05 * (-3 - 3 * math.log(2)), 0.05 * -3
    assert (round(counted, 2), round(left_out, 2)) == (-0.25, -0.15)


@exact
def unit_free_at_1(replies, taught_by):
    """At α = 1 the best reply is what the expert does, in any unit, and the
    expert hardly ever falls."""
    assert np.allclose(replies[1.0][:, :END], taught_by[:END])
    assert taught_by[0, LEFT] < 1e-2


@exact
def fine_units(replies):
    """If α is well below 1, the best reply in a fine unit is to fall, and
    in the expert's own it is not."""
    for alpha in (0.3, 0.05):
        assert replies[alpha][0, 0, LEFT] < 1e-4
        assert replies[alpha][-1, 0, LEFT] > 0.8


@exact
def a_dozen_copies(replies, copies):
    """At α = 0.05 the best reply is to fall at once from a dozen copies
    on."""
    assert (replies[0.05][copies >= 12, 0, LEFT] > 0.99).all()


@exact
def large_temperatures(reply_to_f):
    """Above 1 a fine unit does the opposite."""
    assert reply_to_f(32, 1.5)[0, LEFT] < 1e-6


@exact
def proposition(mdp, taught_by, replies, copies):
    """As the proposition says, twelve copies act as a constant of
    −(1 − α) log 12 in each step of life."""
    reply = _reply_in_unit(mdp, taught_by, -math.log(12), 0.05)
    (twelve,) = replies[0.05][copies == 12]
    assert np.allclose(reply[:END], twelve[:END])


@exact
def larger_unit(mdp, taught_by):
    """At α = 0.05 and k = 1/2 the best reply ends the episode in fewer than
    one step in a million."""
    reply = _reply_in_unit(mdp, taught_by, 0.5, 0.05)
    assert max(reply[0, LEFT], reply[2, RIGHT]) < 1e-6


@exact
def wrapper(k, lifetime):
    """In tenths every density of three motors is a thousandth, f is 6.9
    lower, and a long life is worth 656 less at α = 0.05 and nothing less at
    α = 1."""
    assert math.isclose(k, math.log(1e-3))
    assert round(k, 1) == -6.9
    assert round(0.2 * -k, 1) == 1.4
    assert round(0.05 * -k, 2) == 0.35
    assert round(lifetime[0.05]) == 656
    assert lifetime[1.0] == 0


def _reply_in_unit(mdp, taught_by, k, alpha):
    # The best reply by the proposition, for any k.
    f = np.log(taught_by) + (1 - alpha) * k
    f[END] = -alpha * math.log(3)
    return tabular.soft_value_iteration(mdp, f, alpha).policy
