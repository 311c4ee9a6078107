"""What the note on PPO says."""

import numpy as np
import torch

from checks import exact, recorded
from offairl_lite.core import ppo


@exact
def as_in_the_package(advantages, surrogate):
    """Both functions agree with the package's on random numbers."""
    rng = torch.Generator().manual_seed(0)
    reward, v, v_next, now, old = torch.randn(5, 1, 40, generator=rng)
    ends = torch.rand(1, 40, generator=rng) < 0.1
    ends[:, -1] = True
    died = (ends & (torch.rand(1, 40, generator=rng) < 0.5)).float()
    packaged = ppo.gae(reward, v, v_next, died, ends, 0.99, 0.95)
    delta = reward + 0.99 * (1 - died) * v_next - v
    by_hand = advantages(delta[0], ends[0], 0.99, 0.95)
    assert torch.allclose(packaged[0], by_hand, atol=1e-5)
    loss = ppo.clipped_surrogate(now, old, packaged, 0.2)
    assert torch.isclose(loss, -surrogate(now[0], old[0], by_hand, 0.2))


@exact
def ten_passes():
    """PPO goes through a block ten times, with the usual settings."""
    assert (ppo.CLIP, ppo.GAE_DECAY, ppo.EPOCHS) == (0.2, 0.95, 10)


@exact
def time_limits_blame_nobody(at_the_end):
    """With a time limit all advantages are 0."""
    assert at_the_end["as a time limit"].abs().max() < 1e-3


@exact
def terminations_blame_the_last_actions(at_the_end, gamma, v):
    """A termination's last action is blamed for all that would have come,
    and the actions before it as well."""
    wrong = at_the_end["as a termination"]
    assert torch.allclose(wrong[-1], -gamma * v[0, -1])
    assert wrong[-20] < -20


@recorded
def survival_is_last(out):
    """The medians pass -12 after 15,000 steps with log D, 20,000 with the
    log odds and 25,000 with the published reward."""
    assert out == {
        "log D": 15_000,
        "log D − log(1 − D)": 20_000,
        "−log(1 − D)": 25_000,
    }


@recorded
def all_end_above_the_demonstrations(ends, level):
    """All 15 seeds end above the demonstrations, at -6.5."""
    assert sum(map(len, ends.values())) == 15
    assert min(values.min() for values in ends.values()) > level
    assert round(level, 1) == -6.5


@recorded
def most_end_above_the_modes(ends, modes):
    """The experts' modes return -5.8 to -6.0, and 14 of 15 seeds end above
    the best of them."""
    assert (round(min(modes), 1), round(max(modes), 1)) == (-6.0, -5.8)
    assert sum((x > max(modes)).sum() for x in ends.values()) == 14


@recorded
def first_policies_are_told_apart(runs):
    """D is small where the first policy is."""
    run = runs["−log(1 − D)"]
    first = [row for row in run.rows if row.step == run.steps[0]]
    assert np.mean([row.metrics["policy_logit"] for row in first]) < -0.5


@recorded
def two_stand_still(hoppers, last_episodes):
    """After 20,000 steps two of five seeds of DAC with SAC stand still for
    1,000 steps, which pays 1,000."""
    run = hoppers["DAC with SAC"]
    last = run.returns[:, -1]
    standing = last_episodes(run) == 1_000
    assert run.steps[-1] == 20_000
    assert standing.sum() == 2
    assert (np.abs(last[standing] - 1_000) < 50).all()
    assert last.min() > 200


@recorded
def episodes_of_the_last_steps(hoppers):
    """The lengths are those of the last 2,000 steps."""
    for run in hoppers.values():
        assert run.steps[-1] - run.steps[-2] == 2_000
