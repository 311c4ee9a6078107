"""That the benchmark measures what it says. How fast anything is, is asserted nowhere."""

import json
import subprocess
import sys
import time
from itertools import count, pairwise
from types import SimpleNamespace

import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from offairl_lite.core.replay import CHUNK
from offairl_lite.runs import bench, cli
from offairl_lite.runs.bench import Options

QUICK = "--rounds 1 --seconds 0.02 --populations 1 2 --no-compile --hidden 8 6 --json"


@pytest.fixture(autouse=True)
def same_threads():
    """Torch keeps its number of threads."""
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def in_a_process_of_its_own(line):
    command = [sys.executable, "-c", "from offairl_lite.runs import cli; cli.main()", "bench"]
    done = subprocess.run([*command, *line.split()], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def report():
    """The whole standard output of a quick run."""
    return json.loads(in_a_process_of_its_own(QUICK))


def test_the_json_has_everything(report):
    assert set(report) == {"origin", "options", "rates"}
    assert {"torch", "offairl-lite"} <= set(report["origin"]["versions"])
    assert (report["options"]["populations"], report["origin"]["threads"]) == ([1, 2], 1)
    assert list(report["rates"]) == [
        f"{what}, 8-6, batch 100, members {n}" for n in (1, 2) for what in ("updates", "steps")
    ]
    assert min(report["rates"].values()) > 0


def test_the_table_shows_it_all(report):
    text = bench.table(report)
    assert max(map(len, text.splitlines())) <= 100
    for title, rate in report["rates"].items():
        assert f"\n{title:60} {rate:8.0f}\n" in text


def test_the_command_prints_table_or_json(report, monkeypatch, capsys):
    seen = []
    monkeypatch.setattr(cli, "measure", lambda options: seen.append(options) or report)
    cli.main(["bench", "--hidden", "32", "--rounds", "2"])
    assert capsys.readouterr().out.strip() == bench.table(report)
    cli.main(["bench", "--json"])
    assert json.loads(capsys.readouterr().out) == report
    assert seen == [Options(hidden=(32,), rounds=2), Options()]


def multiply(rows, *sizes):
    """FLOP of a network's forward pass: two for each weight and row.

    A layer of one unit is a sum, and no product of matrices.
    """
    return 2 * rows * sum(i * o for i, o in pairwise(sizes) if o > 1)


@pytest.mark.parametrize("population", [1, 3])
def test_the_flop_of_a_combined_update_are_those_of_its_layers(population):
    batch, obs, action, (h, k), (r, s) = 100, 17, 6, (5, 7), (100, 100)
    actor, critic = (obs, h, k, 2 * action), (obs + action, h, k, 1)
    reward = shaping = (obs, r, s, 1)

    def backward(rows, first, *rest, to_input=False):
        """As much as forward for the weights, and again for what comes in, if it is asked for."""
        by_weights, by_input = multiply(rows, first, *rest), multiply(rows, *rest)
        return by_weights + by_input + to_input * multiply(rows, first, rest[0])

    def penalty(rows, inputs, *layers):
        """The gradient by the input, and the backward pass of that."""
        hidden = (inputs, *layers[:-1])
        chain_rule = multiply(rows, *hidden)
        # Both factors of each product have a derivative; the hidden layers' outputs have one
        # through their slopes, which goes on to the weights below.
        return chain_rule + 2 * chain_rule + backward(rows, *hidden)

    discriminator = multiply(2 * batch, *actor)  # log π of expert and policy
    # r of both sides; V of both sides, at s and at s'.
    for rows, net in ((2 * batch, reward), (4 * batch, shaping)):
        discriminator += multiply(rows, *net) + backward(rows, *net)
    # The penalty, at one point between each two, which has an s and an s'.
    for rows, net in ((batch, reward), (2 * batch, shaping)):
        discriminator += multiply(rows, *net) + penalty(rows, *net)

    critics = multiply(batch, *actor) + 2 * multiply(batch, *critic)  # the target
    critics += 2 * (multiply(batch, *critic) + backward(batch, *critic))
    by_action = 2 * multiply(batch, *critic)  # critics' weights get no gradient from the actor
    learn_actor = multiply(batch, *actor) + backward(batch, *actor)
    learn_actor += 2 * multiply(batch, *critic) + by_action
    sac = multiply(batch, *reward) + critics + learn_actor / 2  # every second time

    options = Options(compile=False)
    updates = bench.measured(options, (h, k), population)["updates"]
    with FlopCounterMode(display=False) as counter:
        updates()
    assert counter.get_total_flops() / (2 * CHUNK * population) == discriminator + sac


def test_a_turn_lasts(monkeypatch):
    monkeypatch.setattr(time, "perf_counter", count().__next__)
    assert bench.turn(lambda: None, 3) == 1  # three times in three seconds
    acted = []
    assert bench.turn(lambda: acted.append(1), 0) == 1  # once at least
    assert acted == [1]


def test_rates_count_every_member_and_are_medians_over_the_rounds(monkeypatch):
    made = {"updates": "the updates", "steps": "the steps"}
    monkeypatch.setattr(bench, "measured", lambda options, hidden, members: made)
    turns = iter((1.0, 10.0, 9.0, 90.0, 2.0, 20.0))
    monkeypatch.setattr(bench, "turn", lambda act, seconds: next(turns))
    report = bench.measure(Options(hidden=(8,), populations=(3,), rounds=3))
    of = "8, batch 100, members 3"
    amount = 2 * CHUNK * 3
    assert report["rates"] == {f"updates, {of}": 2 * amount, f"steps, {of}": 20 * amount}


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_missing_gpu_is_named():
    with pytest.raises(ValueError, match="sees no GPU here: use cpu"):
        bench.measure(Options(device="cuda"))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("--rounds 0", "rounds is 0; expected positive numbers"),
        ("--seconds -1", "seconds is -1.0; expected positive numbers"),
        ("--populations 1 0", "populations is (1, 0); expected positive numbers"),
        ("--hidden", "hidden is (); expected positive numbers"),
    ],
)
def test_options_that_make_no_sense_are_refused(line, message, capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(["bench", *line.split()])
    said = f"{stop.value.code} {capsys.readouterr().err.replace('│', ' ')}"
    assert message in " ".join(said.split())


LAYERS = {"trunk_hidden": (8,), "primitive_hidden": (8,), "gate_hidden": (8,)}
PRIMITIVES = {"primitives": 2, **LAYERS}


@pytest.mark.parametrize(
    "changes",
    [
        {"reward": "logit-s"},
        {"reward": "frozen", "pretrained": "primitives", "guide_steps": 20, **PRIMITIVES},
        {"reward": "frozen", "env_id": "Hopper-v5", "absorbing": "bootstrap"},
        {"learner": "ppo", "train_every": 40, "reward": "gail-survival"},
        {"env_id": "Hopper-v5", "absorbing": "bootstrap"},
    ],
)
def test_a_run_is_estimated_from_a_block_and_an_episode_of_evaluation(tiny, monkeypatch, changes):
    config = tiny.change(**changes)
    # A clock that goes on by a second whenever it is looked at.
    monkeypatch.setattr(time, "perf_counter", count().__next__)
    every = changes.get("train_every", 20)
    schedule = config.schedule
    evaluations = schedule.total_steps / schedule.eval_every
    seconds = schedule.total_steps / every + schedule.eval_episodes * evaluations
    assert bench.estimate(config, 2) == pytest.approx(seconds)


def test_another_library_takes_as_many_steps_with_the_same_networks(monkeypatch):
    learned, made = [], []

    class SAC:
        def __init__(self, policy, env, **options):
            made.append((policy, env.spec.id, options))

        def learn(self, steps, reset_num_timesteps=True):
            learned.append((steps, reset_num_timesteps))

    monkeypatch.setitem(sys.modules, "sbx", SimpleNamespace(SAC=SAC))
    act = bench.peer("sbx", (8, 6))
    act()
    assert learned[1:] == [(2 * CHUNK, False)]
    ((_, task, options),) = made
    assert (task, options["policy_kwargs"]) == (bench.TASK, {"net_arch": [8, 6]})
    assert (options["batch_size"], options["device"]) == (bench.BATCH, "cpu")


def test_a_library_that_is_not_there_is_named_with_its_cure(monkeypatch):
    monkeypatch.setitem(sys.modules, "sbx", None)
    with pytest.raises(ModuleNotFoundError, match=r"SBX is not installed: pip install .*\[sbx\]"):
        bench.peer("sbx", (8,))
