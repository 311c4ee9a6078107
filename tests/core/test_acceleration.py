"""However an update is executed, it is the same update."""

from contextlib import closing
from functools import partial

import pytest
import torch

from offairl_lite.core import acceleration as execution
from offairl_lite.core.acceleration import (
    PIECE,
    CudaGraphed,
    Execution,
    compiler,
    onednn_is_exact,
    onednn_is_faster,
    piecewise,
    with_onednn,
)
from offairl_lite.core.loop import Trainer, train

MAZE = "offairl/PointMazeLeft-v0"
HOPPER = "Hopper-v5"

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C++ compiler")
needs_onednn = pytest.mark.skipif(not onednn_is_exact(), reason="oneDNN rounds to 16 bits here")
needs_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")

VARIANTS = [
    {"temperature": None, "train_every": 20},
    {
        "env_id": HOPPER,
        "train_every": 20,
        "absorbing": "analytic",
        "ablation": "penalty-on-probability",
    },
    {"env_id": HOPPER, "train_every": 20, "reward": "dac", "learner": "td3"},
    {"env_id": HOPPER, "train_every": 20, "learner": "ppo"},
]
NAMES = ["airl", "absorbing", "td3", "ppo"]


def trained(config, demonstrations, execution):
    """Weights after the first updates, the same batches for each execution."""
    with closing(Trainer(config, (0, 1), demonstrations, execution=execution)) as trainer:
        for _ in trainer.run():
            if trainer.trained:
                break
        return torch.cat([x.flatten() for x in trainer.weights().values()]).cpu()


def assert_same_updates(config, demonstrations, other):
    """Equal up to rounding, which is small beside how far the weights have moved."""
    written = trained(config, demonstrations, Execution())
    torch.testing.assert_close(
        trained(config, demonstrations, other), written, rtol=1e-3, atol=1e-4
    )


@needs_compiler
@pytest.mark.parametrize("changes", VARIANTS, ids=NAMES)
def test_a_compiled_update_is_the_same_update(tiny, random_demonstrations, changes):
    config = tiny.change(learning_starts=20, **changes)
    config = config.change(hidden=(16,), reward_hidden=(8,), shaping_hidden=(8,))
    assert_same_updates(config, random_demonstrations(config.env_id), Execution(compile=True))


@needs_onednn
@pytest.mark.parametrize("compile", [False, pytest.param(True, marks=needs_compiler)])
def test_an_update_with_onednn_is_the_same_update(tiny, random_demonstrations, compile):
    """Networks are wide enough for PyTorch to ask it; rounding to 16 bits would be seen."""
    config = tiny.change(learning_starts=20, train_every=20, hidden=(64, 64), batch_size=64)
    other = Execution(compile=compile, onednn=True)
    assert_same_updates(config, random_demonstrations(config.env_id), other)


@needs_onednn
@pytest.mark.parametrize(("rows", "width", "out"), [(100, 17, 400), (200, 400, 300), (256, 64, 1)])
def test_products_by_onednn_are_in_single_precision(rows, width, out):
    draw = partial(torch.randn, generator=torch.Generator().manual_seed(0))
    x, weight, grad, bias = draw(2, rows, width), draw(2, width, out), draw(2, rows, out), draw(out)
    for product in (
        lambda x, weight, grad, bias: torch.baddbmm(bias, x, weight),
        lambda x, weight, grad, bias: torch.bmm(x.mT, grad),
        lambda x, weight, grad, bias: torch.bmm(grad, weight.mT),
    ):
        exact = product(*(t.double() for t in (x, weight, grad, bias)))
        found = with_onednn(product)(x, weight, grad, bias).double()
        torch.testing.assert_close(found, exact, rtol=1e-5, atol=1e-4)


def test_where_products_would_be_rounded_onednn_is_not_asked(monkeypatch):
    """A processor with units for 16 bits is imitated by rounding to them."""

    def rounding(step):
        return lambda *args: step(*(x.bfloat16() for x in args)).float()

    onednn_is_exact.cache_clear()
    monkeypatch.setattr(execution, "with_onednn", rounding)
    assert not onednn_is_exact()
    assert Execution(onednn=True).accelerate(torch.bmm, (256,)) is torch.bmm
    onednn_is_exact.cache_clear()


def test_only_large_networks_are_multiplied_by_onednn(monkeypatch):
    monkeypatch.setattr(execution, "onednn_is_exact", lambda: True)
    assert Execution(onednn=True).accelerate(torch.bmm, (128, 100)) is torch.bmm
    assert Execution(onednn=True).accelerate(torch.bmm, (64, 129)) is not torch.bmm


@pytest.mark.parametrize("faster", [True, False])
def test_onednn_is_chosen_by_its_time(monkeypatch, faster):
    def timed(step):
        return (lambda x, w: x) if faster else (lambda *args: [step(*args) for _ in range(3)])

    monkeypatch.setattr(execution, "with_onednn", timed)
    onednn_is_faster.cache_clear()
    assert onednn_is_faster() == faster
    onednn_is_faster.cache_clear()


def test_onednn_is_asked_during_an_update_alone():
    settings = torch.backends.mkldnn.matmul
    before = settings.fp32_precision

    def step():
        assert settings.fp32_precision == "bf16"
        raise ArithmeticError

    with pytest.raises(ArithmeticError):
        with_onednn(step)()
    assert settings.fp32_precision == before


@pytest.mark.parametrize("rows", [1, PIECE, 2 * PIECE + 7])
def test_member_by_member_and_piece_by_piece_it_is_the_same_function(rows):
    weights = torch.arange(1.0, 4.0).view(3, 1)
    x, y = torch.randn(2, 3, rows, 2, generator=torch.Generator().manual_seed(0))
    shapes = []

    def function(weights, x, y):
        shapes.append(x.shape)
        return weights * (x - 2 * y).sum(-1)

    assert torch.equal(piecewise(function)(weights, x, y), function(weights, x, y))
    *pieces, _ = shapes
    assert all(len(shape) == 3 and shape[0] == 1 and shape[1] <= PIECE for shape in pieces)


@needs_gpu
@pytest.mark.parametrize("compile", [False, True])
@pytest.mark.parametrize("changes", VARIANTS, ids=NAMES)
def test_a_captured_update_is_the_same_update(tiny, random_demonstrations, changes, compile):
    config = tiny.change(learning_starts=20, **changes)
    demonstrations = random_demonstrations(config.env_id)
    assert_same_updates(config, demonstrations, Execution("cuda", compile=compile))


@needs_gpu
def test_a_run_on_a_gpu_is_the_run_on_a_cpu_at_first(tiny, random_demonstrations):
    """Rounding differs, so that later they part."""
    demonstrations = random_demonstrations(MAZE)
    runs = [train(tiny, (0, 1), demonstrations, execution=Execution(d)) for d in ("cpu", "cuda")]
    first, second = (run.rows[0].mean_return for run in runs)
    assert first == pytest.approx(second, rel=1e-2)


@needs_gpu
def test_a_frozen_reward_serves_on_a_gpu(tiny, random_demonstrations):
    reward = train(tiny, (0, 1), random_demonstrations(MAZE), progress=False).reward
    frozen = tiny.change(reward="frozen")
    assert train(frozen, (0, 1), frozen_reward=reward, execution=Execution("cuda")).rows


@needs_gpu
def test_a_graph_is_captured_once_for_each_flag_and_makes_no_update_twice():
    total, calls = torch.zeros(3, device="cuda"), []

    def step(x, double):
        calls.append(double)
        total.add_(2 * x if double else x)
        return {"total": total * 1}

    graphed, ones = CudaGraphed(step), torch.ones(3, device="cuda")
    for count in range(1, 7):
        assert graphed(ones, False)["total"].tolist() == [count] * 3
    assert graphed(ones, True)["total"].tolist() == [8] * 3
    # As written, then captured; the other flag for the first time.
    assert calls == [False, False, True]


def test_before_it_is_captured_a_step_sees_tensors_as_its_graph_will():
    """A compiled step is compiled again for another stride, and capturing forbids that."""
    strides = []

    def step(x):
        strides.append(x.stride())
        return {"sum": x.sum()}

    part, _ = torch.arange(12.0).view(2, 6).split(3, 1)
    assert part.stride() == (6, 1)
    assert CudaGraphed(step)(part)["sum"] == part.sum()
    assert strides == [part.clone().stride()] == [(3, 1)]


def test_without_a_gpu_cuda_is_refused(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ValueError, match=r"'cuda', and PyTorch sees no GPU here: use cpu"):
        Execution("cuda")


def test_without_a_compiler_compile_is_refused(monkeypatch):
    monkeypatch.setattr(execution.shutil, "which", lambda name: None)
    assert compiler() is None
    with pytest.raises(ValueError, match=r"needs a C\+\+ compiler.*install g\+\+"):
        Execution(compile=True)


def test_no_threads_no_run():
    with pytest.raises(ValueError, match="threads is 0; expected a number from 1 to 256"):
        Execution(threads=0)
