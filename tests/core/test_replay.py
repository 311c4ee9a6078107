import pytest
import torch

from offairl_lite.core.replay import Batch, Replay, pack, split, unpack
from offairl_lite.core.rng import Rng


def numbered(values, obs_dim=2, action_dim=1):
    """One transition for each value, recognisable in all its parts."""
    x = torch.tensor(values, dtype=torch.float32)
    obs = x.unsqueeze(-1).expand(-1, obs_dim)
    return Batch(obs, x.unsqueeze(-1).expand(-1, action_dim) + 0.25, obs + 0.5, -x, x % 2)


def held(replay, member):
    return replay.held(member).obs[:, 0].tolist()


def test_packing_is_undone_by_unpacking():
    streams = Rng((0, 1))
    batch = Batch(*(streams.normal(4, n) for n in (3, 2, 3)), *(streams.normal(4) for _ in "rt"))
    assert pack(batch).shape == (2, 4, 10)
    for part, again in zip(batch, unpack(pack(batch), 3), strict=True):
        assert torch.equal(part, again)


def test_minibatches_are_cut_from_the_second_axis():
    wide, flat = Rng((0, 1)).normal(5, 2), torch.arange(10.0).view(2, 5)
    batch = Batch(wide, wide, wide, flat, flat)
    parts = split(batch, 2)
    assert [part.reward.shape[1] for part in parts] == [2, 2, 1]
    for whole, *pieces in zip(batch, *parts, strict=True):
        assert torch.equal(whole, torch.cat(pieces, 1))


def test_actions_are_squashed():
    batch = numbered([0.0, 1.0])
    assert torch.equal(batch.action, torch.tanh(batch.pre_tanh))


def test_the_oldest_are_overwritten():
    replay = Replay(2, 3, 2, 1)
    for step in range(5):
        replay.add(numbered([step, 10 + step]))
    assert replay.sizes == [3, 3]
    assert held(replay, 0) == [2, 3, 4]
    assert held(replay, 1) == [12, 13, 14]


def test_members_fill_at_their_own_pace():
    replay = Replay(3, 4, 2, 1)
    replay.add(numbered([0, 10, 20]))
    replay.add(numbered([11]), torch.tensor([1]))
    replay.add(numbered([2, 22]), torch.tensor([0, 2]))
    replay.add(numbered([13, 23]), torch.tensor([1, 2]))
    assert [held(replay, i) for i in range(3)] == [[0, 2], [10, 11, 13], [20, 22, 23]]


def test_samples_are_the_rows_held_and_no_others():
    replay = Replay(2, 6, 2, 1)
    for step in range(4):
        replay.add(numbered([step + 1, step + 11]))
    replay.add(numbered([15]), torch.tensor([1]))
    batch = replay.sample(Rng((0, 1)), 300)
    assert batch.obs.shape == (2, 300, 2)
    assert batch.obs[0, :, 0].unique().tolist() == [1, 2, 3, 4]
    assert batch.obs[1, :, 0].unique().tolist() == [11, 12, 13, 14, 15]
    # A row is drawn whole.
    again = numbered(batch.obs[0, :, 0].tolist())
    assert all(torch.equal(a[0], b) for a, b in zip(batch, again, strict=True))


def test_sampling_is_uniform():
    replay = Replay(1, 8, 2, 1)
    for step in range(4):
        replay.add(numbered([step]))
    counts = replay.sample(Rng((0,)), 40_000).obs[0, :, 0].long().bincount(minlength=4)
    # Four standard deviations of a binomial count.
    assert (counts - 10_000).abs().max() < 4 * (40_000 * 0.25 * 0.75) ** 0.5


def test_the_last_are_given_in_their_order():
    replay = Replay(2, 3, 2, 1, slots=4)
    for step in range(6):
        replay.add(numbered([step, 10 + step]))
    replay.add(numbered([16]), torch.tensor([1]))
    assert replay.last(2).obs[..., 0].tolist() == [[4, 5], [15, 16]]
    for whole, some in zip(
        replay.last(3), zip(*map(replay.held, (0, 1)), strict=True), strict=True
    ):
        assert torch.equal(whole, torch.stack(some))
    with pytest.raises(ValueError, match=r"last 4 transitions are wanted; held are \[3, 3\]"):
        replay.last(4)


def test_a_replay_that_is_put_back_finds_its_rows_as_they_were():
    """As many steps as it has slots more than capacity; the same rows are then drawn."""
    replay = Replay(2, 3, 2, 1, slots=5)
    for step in range(7):
        replay.add(numbered([step, 10 + step]))
    added, before = replay.added.clone(), replay.sample(Rng((0, 1)), 50)
    for step in range(7, 9):
        replay.add(numbered([step, 10 + step]))
    assert held(replay, 0) == [6, 7, 8]
    replay.added.copy_(added)
    assert held(replay, 0) == [4, 5, 6]
    for part, again in zip(before, replay.sample(Rng((0, 1)), 50), strict=True):
        assert torch.equal(part, again)


def test_spare_slots_change_no_draw():
    few, many = Replay(1, 3, 2, 1), Replay(1, 3, 2, 1, slots=7)
    for step in range(11):
        few.add(numbered([step]))
        many.add(numbered([step]))
        drawn = [r.sample(Rng((0,)), 40).obs for r in (few, many)]
        assert torch.equal(*drawn)
        assert held(few, 0) == held(many, 0)


def test_rows_in_a_file_are_found_again_and_the_file_can_grow(tmp_path):
    file = tmp_path / "rows"
    replay = Replay(2, 3, 2, 1, file=file)
    for step in range(3):
        replay.add(numbered([step, 10 + step]))
    replay.flush()
    assert file.stat().st_size == 3 * 2 * 7 * 4
    again = Replay(2, 3, 2, 1, file=file, slots=6)
    again.added.copy_(replay.added)
    assert [held(again, i) for i in (0, 1)] == [[0, 1, 2], [10, 11, 12]]
    again.add(numbered([3, 13]))
    assert held(again, 1) == [11, 12, 13]


@pytest.mark.parametrize("reserves", [True, False])  # macOS does not.
def test_a_file_takes_its_room_at_once(tmp_path, monkeypatch, reserves):
    if not reserves:
        monkeypatch.delattr("os.posix_fallocate", raising=False)
    file = tmp_path / "rows"
    Replay(4, 10_000, 20, 6, file=file)
    assert file.stat().st_blocks * 512 >= file.stat().st_size == 4 * 10_000 * 48 * 4


def test_an_empty_member_cannot_be_sampled():
    replay = Replay(2, 3, 2, 1)
    replay.add(numbered([1]), torch.tensor([1]))
    with pytest.raises(ValueError, match=r"empty \(sizes \[0, 1\]\)"):
        replay.sample(Rng((0, 1)), 1)


@pytest.mark.parametrize("batch", [numbered([0, 1, 2]), numbered([0, 1], action_dim=2)])
def test_transitions_of_another_shape_are_refused(batch):
    with pytest.raises(ValueError, match=r"this replay takes \(2, 7\)"):
        Replay(2, 3, 2, 1).add(batch)
