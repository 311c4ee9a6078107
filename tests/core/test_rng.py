import pytest
import torch

from offairl_lite.core.rng import Rng

DRAWS = {
    "normal": lambda s: s.normal(4, 3),
    "uniform": lambda s: s.uniform(12),
    "integers": lambda s: s.integers([1000] * len(s), 4, 3),
}


def draw_all(streams):
    return [draw(streams) for draw in DRAWS.values()]


def test_a_member_draws_the_same_alone_and_among_others():
    many, alone = Rng((1, 3, 7)), Rng((3,))
    for _ in range(2):
        for a, b in zip(draw_all(many), draw_all(alone), strict=True):
            assert torch.equal(a[1:2], b)


@pytest.mark.parametrize("draw", DRAWS.values(), ids=DRAWS)
def test_seeds_decide(draw):
    assert torch.equal(draw(Rng((0, 1))), draw(Rng((0, 1))))
    zero, one = draw(Rng((0, 1)))
    assert not torch.equal(zero, one)


def test_a_restored_state_goes_on_from_there():
    streams = Rng((0, 5))
    streams.normal(3)
    state = streams.state
    expected = draw_all(streams)
    other = Rng((8, 9))
    other.state = state
    for a, b in zip(draw_all(other), expected, strict=True):
        assert torch.equal(a, b)


def test_a_state_of_another_population_is_refused():
    with pytest.raises(ValueError, match="zip"):
        Rng((0, 1)).state = Rng((0,)).state


def test_torch_s_global_generator_is_left_alone():
    before = torch.get_rng_state()
    draw_all(Rng((0,)))
    assert torch.equal(torch.get_rng_state(), before)


def test_numbers_have_their_distribution():
    streams = Rng((0, 1))
    normal, uniform = streams.normal(20_000), streams.uniform(20_000)
    torch.testing.assert_close(normal.mean(1), torch.zeros(2), atol=0.03, rtol=0)
    torch.testing.assert_close(normal.std(1), torch.ones(2), atol=0.03, rtol=0)
    assert uniform.min() >= 0
    assert uniform.max() < 1
    torch.testing.assert_close(uniform.mean(1), torch.full((2,), 0.5), atol=0.01, rtol=0)


def test_integers_have_a_bound_for_each_member():
    draws = Rng((0, 1)).integers([3, 5], 500)
    assert draws[0].unique().tolist() == [0, 1, 2]
    assert draws[1].unique().tolist() == [0, 1, 2, 3, 4]
