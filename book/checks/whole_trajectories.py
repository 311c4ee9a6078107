"""What the note on whole trajectories says."""

import numpy as np

from checks import exact, live, recorded


@exact
def episodes_vary_more(spread):
    """The best logit of whole episodes varies more than seven times as much
    as that of single steps."""
    for whole, single in spread.values():
        assert whole[-1] > 7 * single[-1]


@exact
def episodes_do_not_count(share):
    """Against a policy that takes every action alike, 8,000 episodes of 100
    steps are worth fewer than ten."""
    # Over seeds 0-9 the share is below 0.0008.
    whole, _ = share["takes every action alike"]
    assert whole[-1] < 0.001
    assert whole[-1] * 8_000 < 10


@exact
def imitated_episodes_count_a_little(share):
    """Against a policy that has begun to imitate, episodes are worth a few
    percent of their number."""
    # Over seeds 0-9 from 0.035 to 0.044
    whole, _ = share["has begun"]
    assert 0.02 < whole[-1] < 0.07


@exact
def steps_count(share):
    """Single steps keep more than half of their worth."""
    for _, single in share.values():
        assert single.min() > 0.55


@live
def soon_certain(rounds):
    """After 10,000 steps the logits are far from 0 on both sides."""
    # Over seeds 0-7 the expert's is 14 to 60, the policy's -58 to -16.
    expert, policy, *_ = rounds[4]
    assert expert > 6
    assert policy < -6


@live
def slowly_better(rounds):
    """The return rises slowly: after 20,000 steps it is still far from the
    expert's."""
    # Over seeds 0-7 it is -42 to -18; the expert has -6.5.
    assert rounds[-1][-1] < -10


@recorded
def nothing_left_to_learn(found):
    """After 20,000 steps GAN-GCL's logits are in the tens, on the right
    side, and its cross-entropy is 0."""
    expert, policy, entropy = found["gan-gcl"]
    assert policy < -10
    assert expert > 10
    assert entropy < 1e-3


@recorded
def stuck_at_first(runs):
    """Then three of GAN-GCL's five policies are stuck under the barrier or
    worse; in the end three find the way, and in two of these the
    cross-entropy is about 5."""
    run = runs["gan-gcl"]
    now = run.returns[:, list(run.steps).index(20_000)]
    assert (now < -25).sum() == 3
    out = run.returns[:, -1] > -20
    last = [row.metrics["cross_entropy"] for row in run.rows[-5:]]
    assert out.sum() == 3
    lost = np.array(last)[out & (np.array(last) > 4)]
    assert len(lost) == 2
    assert (np.abs(lost - 5) < 1).all()
    assert np.median(run.returns[:, -1]) < -14


@recorded
def single_transitions_stay_undecided(found, runs):
    """The discriminators of single transitions are undecided, and all their
    policies find the way."""
    for name in ("state-action", "state"):
        assert found[name][-1] > 1
        assert runs[name].returns[:, -1].min() > -12


@exact
def whole_or_single(errors):
    """Against a policy that is nearly the expert whole episodes tell more
    than single steps, against one that has begun to imitate as much, and
    against one that takes every action alike much less."""
    # Over seeds 0-3 the first whole is 1.3 to 10.1 and the single 0.40,
    # the second 0.44 to 0.53 and 0.49.
    ratios = [whole / single for whole, single in errors.values()]
    assert ratios[0] > 3
    assert 0.85 < ratios[1] < 1.15
    assert ratios[2] < 1 / 4
