import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from itertools import count
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from filelock import FileLock
from run_folders import create

from offairl_lite import envs
from offairl_lite.config import flat_settings
from offairl_lite.core.acceleration import Execution
from offairl_lite.core.collector import Collector
from offairl_lite.core.networks import Normaliser, StackedMLP
from offairl_lite.core.policies import Policy, SquashedGaussian
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rng import Rng
from offairl_lite.core.rollouts import rollout
from offairl_lite.core.sac import SAC
from offairl_lite.demonstrations import EXPERTS, Recording, write
from offairl_lite.experiments import EXPERIMENTS
from offairl_lite.runs import cli, folders, inputs, jobs, launch, messages
from offairl_lite.runs.grid import docstrings
from offairl_lite.runs.records import RunSpec, read, read_json, run_folders, write_json

SMALL = (
    "--seeds 0 1 --total-steps 200 --learning-starts 100 --batch-size 8 --eval-every 100 "
    "--eval-episodes 2 --hidden 8"
)
LEARNED = f"{SMALL} --reward-hidden 8 --shaping-hidden 8"


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch, minari_folder):
    """Runs and films go to a temporary folder; torch keeps its number of threads."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("OFFAIRL_SCALE", raising=False)
    threads = torch.get_num_threads()
    yield tmp_path
    torch.set_num_threads(threads)


def offairl(line):
    cli.main(line.split())


def failure(line, capsys):
    """The one line of a command that fails."""
    with pytest.raises(SystemExit) as stop:
        offairl(line)
    assert isinstance(stop.value.code, str), capsys.readouterr().err  # to stderr, exit status 1
    assert stop.value.code.startswith("offairl: ")
    assert "\n" not in stop.value.code
    return stop.value.code


def test_list_shows_experiments_and_experts(capsys, shipped_experts):
    offairl("list")
    out = capsys.readouterr().out
    for name, experiment in EXPERIMENTS.items():
        assert f"  {name} " in out
        assert messages.in_options(experiment.about) in out
    assert "demo: offairl/PointMazeLeft-v0, 6,000 steps, 5 seeds\n" in out
    assert "full: Hopper-v5, 1,000,000 steps, 10 seeds\n" in out
    several = "PointMazeRight-v0, offairl/PointMazeLeft-v0, 8,000 steps, 5 seeds"
    assert several in " ".join(out.split())  # every task, whatever the lines
    assert "offairl/PointMazeLeft-v0   2 policies" in out


def test_list_shows_one_experiment_if_named(capsys):
    offairl("list maze-mcp")
    out = capsys.readouterr().out
    assert "  maze-mcp " in out
    assert "maze-dac" not in out
    assert "Experts" not in out


def test_list_says_how_long_a_run_takes_if_asked(capsys, monkeypatch):
    asked = []

    def estimate(config, members):
        asked.append(config)
        return members * config.total_steps / 100

    monkeypatch.setattr(cli, "estimate", estimate)
    offairl("list --times")
    out = capsys.readouterr().out
    assert "6,000 steps, 5 seeds, about 5 minutes" in out
    assert "1,000,000 steps, 10 seeds, about 28 hours" in out
    assert len(asked) == 2 * len(EXPERIMENTS)
    assert asked[0].learner.kind == "td3"  # the first of its variants
    words = [cli._words(seconds) for seconds in (90, 7_000, 10**6)]
    assert words == ["about 90 seconds", "about 117 minutes", "about 12 days"]


def test_demos_makes_and_describes_demonstrations(capsys, shipped_experts):
    offairl("demos offairl/PointMazeLeft-v0 --trajectories 3")
    assert "PointMazeLeft-v0: 3 trajectories, 300 steps, return -" in capsys.readouterr().out


def test_demos_makes_a_data_set_of_a_policy_and_overwrites_none(capsys, elsewhere, minari_folder):
    actor = SquashedGaussian(3, 1, (8,))
    params, normaliser = actor.init(Rng((0, 1))), Normaliser.identity(2, 3)
    Policy("Pendulum-v1", actor, params, normaliser).save("mine/policy.safetensors")
    line = "demos Pendulum-v1 --trajectories 3"
    message = failure(f"{line} --policy mine", capsys)
    assert "--policy mine makes a data set, which needs a name: add --dataset" in message
    offairl(f"{line} --policy mine --dataset own/folder-v0")
    assert "Pendulum-v1: 3 trajectories, 600 steps, return -" in capsys.readouterr().out
    offairl(f"{line} --policy mine/policy.safetensors --dataset own/file-v0")
    made = capsys.readouterr().out
    message = failure(f"{line} --policy mine --dataset own/file-v0", capsys)
    assert "the data set own/file-v0 exists already, and is not overwritten" in message
    offairl(f"{line} --dataset own/folder-v0")
    assert capsys.readouterr().out == made  # the same policy's, and as it was
    assert "3 trajectories were asked for" not in made
    offairl("demos Pendulum-v1 --dataset own/folder-v0")  # All of them, unless it is said.
    assert capsys.readouterr().out == made
    message = failure("demos Pendulum-v1 --dataset own/file-v0 --trajectories 50", capsys)
    assert "50 trajectories were asked for; it has 3: give --trajectories 3, or fewer" in message


def test_demos_says_what_recordings_do_not_have_and_how_they_end(capsys, own, minari_folder):
    own("Arm-v0")
    at_limit, short = (Recording(np.zeros((n + 1, 2)), np.zeros((n, 2)), True) for n in (5, 3))
    cut = at_limit._replace(terminated=False)
    write([at_limit, short, cut], "Arm-v0", "own/ends-v0")
    offairl("demos Arm-v0 --dataset own/ends-v0")
    said = capsys.readouterr()
    first, second = said.out.splitlines()
    assert first == "Arm-v0: 3 trajectories, 13 steps, no rewards; 2 of them terminated"
    assert second == "actions use 0, 0 % of their ranges"
    assert said.err.startswith("note: 1 terminated in the last step of the time limit; ")
    swung = np.zeros((5, 2))
    swung[0], swung[1, 0] = 1, 0.5
    rewarded = cut._replace(reward=np.ones(5), action=swung)
    write([rewarded], "Arm-v0", "own/rewarded-v0")
    offairl("demos Arm-v0 --dataset own/rewarded-v0")
    first, second = capsys.readouterr().out.splitlines()
    assert first.endswith("return 5.00 (from 5.00 to 5.00); 0 of them terminated")
    assert second == "actions use 17, 100 % of their ranges"
    joined = Recording(np.zeros((11, 2)), np.zeros((10, 2)), False)
    write([joined, cut], "Arm-v0", "own/joined-v0")
    offairl("demos Arm-v0 --dataset own/joined-v0")
    assert "note: episodes longer than the time limit of 5 steps: 1; " in capsys.readouterr().err


def test_a_run_says_if_demonstrations_terminate_and_nothing_follows(
    capsys, own, minari_folder, elsewhere
):
    own("Arm-v0")
    write([Recording(np.zeros((4, 2)), np.zeros((3, 2)), True)] * 2, "Arm-v0", "own/ends-v0")
    line = f"run imitate --env-id Arm-v0 --dataset own/ends-v0 --trajectories 2 --prepare {LEARNED}"
    said = "note: 2 of 2 demonstrations terminate; to learn that something comes after the end, set"
    said += " --absorbing bootstrap"
    offairl(f"{line} --out none")
    assert said in capsys.readouterr().err
    offairl(f"{line} --out loop --absorbing bootstrap")
    assert "note" not in capsys.readouterr().err


def test_a_run_on_thinned_demonstrations_says_so_and_is_resumed(shipped_experts, elsewhere, capsys):
    offairl(f"run maze-imitation --trajectories 2 --subsample 20 --experts 1 --out thin {LEARNED}")
    about = RunSpec.read(elsewhere / "thin").demonstrations
    assert (about["trajectories"], about["subsample"], about["experts"]) == (2, 20, 1)
    offairl("resume thin --steps 300")
    assert read(elsewhere / "thin").steps[-1] == 300
    assert "subsample is 0" in failure(
        f"run maze-imitation --subsample 0 --out zero {LEARNED}", capsys
    )


def test_run_then_transfer_then_watch(capsys, shipped_experts, elsewhere):
    offairl(f"run maze-imitation --trajectories 2 {LEARNED}")
    folder = elsewhere / "runs" / "maze-imitation-demo"
    run = read(folder)
    assert (run.seeds, run.steps.tolist()) == ((0, 1), [100, 200])
    assert (run.config.schedule.batch_size, run.config.learner.hidden) == (8, (8,))
    # What was not asked for is the experiment's own.
    assert (run.config.learner.temperature, run.config.schedule.random_hold) == (None, 10.0)
    assert json.loads((folder / "run.json").read_text())["state"] == "finished"
    out = capsys.readouterr().out
    assert "takes up to 16.8 MB of disk, mostly replay; updates: not compiled" in out
    assert f"{run.rows[-1].mean_return:10.2f}" in out
    assert "recorded in runs/maze-imitation-demo" in out

    reward = folder / "reward.safetensors"
    offairl(f"run maze-transfer --frozen-reward {reward} --out transfer {SMALL}")
    transfer = read(elsewhere / "transfer")
    assert transfer.config.env_id == "offairl/PointMazeRight-v0"
    assert torch.equal(transfer.reward.params, run.reward.params)

    policy, guide = folder / "policy.safetensors", EXPERTS / "PointMazeRight.safetensors"
    given = f"--frozen-reward {reward} --guide-steps 20"
    given += f" --pretrained policy --pretrained-policy {policy}"
    offairl(f"run maze-transfer {given} --guide {guide} --out carried {SMALL}")
    assert read(elsewhere / "carried").config.schedule.guide_steps == 20
    sources = RunSpec.read(elsewhere / "carried").inherited
    files = {name: about["files"] for name, about in sources.items()}
    assert files == {
        "frozen_reward": [str(reward)],
        "pretrained_policy": [str(policy)],
        "guide": [str(guide)],
    }
    assert len(Policy.load(elsewhere / "carried" / "guide.safetensors")) == 2
    message = failure(f"run maze-transfer {given} --out other {SMALL}", capsys)
    assert "a guide of another run is needed: give --guide RUN/policy" in message

    offairl(f"watch {folder} --member 1 --max-steps 3 --out one.mp4")
    assert (elsewhere / "one.mp4").read_bytes()[4:8] == b"ftyp"
    assert "one.mp4: 4 frames of offairl/PointMazeLeft-v0" in capsys.readouterr().out
    assert "member is 2" in failure(f"watch {folder} --member 2", capsys)


def test_watch_takes_a_task_or_a_policy_s_file(capsys, shipped_experts, elsewhere):
    for what in ("offairl/PointMazeLeft-v0", "experts/PointMazeLeft.safetensors"):
        offairl(f"watch {what} --max-steps 2 --env-id offairl/PointMazeRight-v0")
        assert "film.mp4: 3 frames of offairl/PointMazeRight-v0" in capsys.readouterr().out
    offairl("watch offairl/PointMazeLeft-v0 --max-steps 2 --out films/new/one.mp4")
    assert not (elsewhere / "films/new/one.mp4.part").exists()
    assert (elsewhere / "films" / "new" / "one.mp4").read_bytes()[4:8] == b"ftyp"


def test_clones_are_policies_like_any_other(capsys, shipped_experts, elsewhere):
    line = "clone offairl/PointMazeLeft-v0 --trajectories 2 --seeds 4 5 --hidden 8 8 --steps 10"
    message = failure(f"{line} --out left", capsys)
    assert message.endswith("out is left; expected a policy's file: --out left.safetensors")
    offairl(f"{line} --out clones/left.safetensors --eval-episodes 2")
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("clones/left.safetensors: 2 policies; demonstrations return -")
    assert [part.split(":")[0] for part in said[1:]] == ["seed 4", "seed 5"]
    offairl("watch clones/left.safetensors --member 1 --max-steps 2")
    assert "film.mp4: 3 frames" in capsys.readouterr().out
    offairl("export clones/left.safetensors --out robot --member 0")
    assert Path("robot/policy-0.pt2").is_file()
    line = "run imitate --env-id offairl/PointMazeLeft-v0 --trajectories 2 --hidden 8 8 --seeds 0 1"
    offairl(
        f"{line} --pretrained policy --pretrained-policy clones/left.safetensors --prepare --out go"
    )
    kept = Policy.load("go/pretrained_policy.safetensors")
    assert torch.equal(kept.params, Policy.load("clones/left.safetensors").params)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("watch runs/imm", "no run or policy file runs/imm, and no expert is shipped for runs/imm"),
        # The name of a task with experts, but not the task's.
        ("watch runs/PointMazeLeft", "no run or policy file runs/PointMazeLeft"),
        ("watch begun", "begun has no policy.safetensors, .*: `offairl resume begun` goes on"),
        ("watch experts", "no policy at experts/policy.safetensors"),
        ("watch begun/config.json", "begun/config.json is no safetensors file"),
        ("watch Pendulum-v1", "no expert is shipped for Pendulum-v1"),
        ("watch offairl/PointMazeLeft-v0 --out a.gif", "out is a.gif; expected .*: --out a.mp4"),
        ("watch offairl/PointMazeLeft-v0 --env-id Hopper-v5", "sees 3 numbers, .* given 11"),
        (
            "watch offairl/PointMazeLeft-v0 --env-id Pendulum-v1",
            r"gives 2 numbers, .* \(1,\): choose",
        ),
    ],
)
def test_what_cannot_be_watched_is_said_before_it_is_drawn(
    line, message, capsys, shipped_experts, elsewhere
):
    create(elsewhere / "begun", EXPERIMENTS["maze-expert"].configs["demo"], (0,))
    assert re.search(message, failure(line, capsys))
    assert not list(elsewhere.rglob("*.mp4"))


def test_a_task_and_data_of_one_s_own(capsys, write_dataset, elsewhere):
    write_dataset("my/pendulum-v0")
    offairl(
        "run imitate --env-id Pendulum-v1 --dataset my/pendulum-v0 --trajectories 2 "
        f"--train-every 50 --out mine {LEARNED}"
    )
    run = read(elsewhere / "mine")
    assert run.config.env_id == run.policy.env_id == "Pendulum-v1"
    assert (run.config.schedule.train_every, len(run.rows)) == (50, 4)


def test_the_scale_decides_the_defaults(capsys, monkeypatch):
    for line, variable, steps in [
        ("run maze-imitation --help", "demo", "6000"),
        ("run maze-imitation --help", "full", "1000000"),
        ("run maze-imitation --scale full --help", "demo", "1000000"),
        ("run maze-imitation --scale=full --help", "demo", "1000000"),
        ("run maze-expert --help", "demo", "16000"),
    ]:
        monkeypatch.setenv("OFFAIRL_SCALE", variable)
        with pytest.raises(SystemExit):
            offairl(line)
        text = " ".join(capsys.readouterr().out.split())
        assert f"(default: {steps})" in text.split("--total-steps INT", 1)[1][:120]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            "run maze-transfer",
            "`offairl run maze-imitation --scale demo`, then add --frozen-reward "
            "runs/maze-imitation-demo",
        ),
        ("run maze-transfer --frozen-reward no.safetensors", "no reward at no.safetensors"),
        (
            f"run --centre-reward maze-expert {SMALL}",
            "the defaults are those of imitate at demo scale: name the experiment before",
        ),
        ("run maze-imitation --env-id Nowhere-v0", "unknown environment 'Nowhere-v0'"),
        (f"run maze-expert --env-id Nowhere-v0 {SMALL}", "unknown environment 'Nowhere-v0'"),
        ("run imitate --env-id Nowhere-v0 --dataset my/pendulum-v0", "Nowhere"),
        ("run imitate --env-id Pendulum-v1 --dataset my/other-v0", "no local data set"),
        ("demos Nowhere-v0", "unknown environment 'Nowhere-v0'"),
        ("watch Nowhere-v0", "no expert is shipped for Nowhere-v0"),
        ("watch no.safetensors", "no policy at no.safetensors"),
        (
            "resume nowhere",
            "nowhere: it has no config.json; `offairl run NAME --out nowhere` starts",
        ),
        (
            f"run maze-expert --processes 0 {SMALL}",
            "processes is 0; expected a whole number of at least 1, or None",
        ),
    ],
)
def test_mistakes_are_answered_in_one_line(
    line, message, capsys, shipped_experts, write_dataset, elsewhere
):
    write_dataset("my/pendulum-v0", episodes=1)
    assert message in failure(line, capsys)
    assert not (elsewhere / "runs").exists()


def test_a_reader_of_the_list_may_stop_reading():
    """As `offairl list | head -1` does."""
    command = [sys.executable, "-m", "offairl_lite.runs.cli", "list"]
    listing = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    listing.stdout.close()
    assert listing.communicate()[1] == b""


def test_earlier_names_of_options_are_understood():
    args = [
        "run",
        "imitate",
        "--reward",
        "r(s,a)",
        "--warmup_steps=9",
        "--update-every",
        "5",
        "--loss=exact",
    ]
    now = [
        "run",
        "imitate",
        "--reward",
        "r-sa",
        "--learning_starts",
        "9",
        "--train_every",
        "5",
        "--loss",
        "airl",
    ]
    assert cli.in_current_words(args) == cli.in_current_words(now) == now
    assert cli.in_current_words(["--out", "exact"]) == ["--out", "exact"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--discount 2", "discount is 2.0; expected a number in [0, 1]"),
        ("--hidden 8 0", "hidden is (8, 0); expected a tuple, each part a whole"),
        ("--no-log-prob-in-reward", "--no-log-prob-in-reward, and rew"),
        ("--learner td3", "reward 'r-s' needs log π, and td3's"),
        (
            "--learner td3 --reward dac --temperature 0.2 --seeds 0",
            "temperature has no use with --learner td3, --reward dac: leave it out",
        ),
        ("--reward environment --loss exact", "loss has no use with --learner sac, --reward env"),
        ("--composition exact", "composition has no use with --learner sac, --rew"),
        ("--reward environment --ablation state-pairs", "ablation has no use with --learner sac"),
        ("--grid discount=2", "discount is 2; expected a number in [0, 1]"),
    ],
)
def test_a_value_that_makes_no_sense_is_explained(options, message, capsys, elsewhere):
    assert message in failure(f"run maze-imitation {options}", capsys)
    assert not (elsewhere / "runs").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--temperature hot", "could not convert string to float: 'hot'"),
        ("--train-every 1.5", "invalid literal for int() with base 10: '1.5'"),
        ("--ablation two-sided", "invalid choice 'two-sided' for argument '--ablation'"),
    ],
)
def test_a_text_that_is_no_value_is_explained(options, message, capsys):
    with pytest.raises(SystemExit) as stop:
        offairl(f"run maze-imitation {options}")
    said = " ".join(re.sub(r"[│╭╮╰╯─]", " ", capsys.readouterr().err).split())
    assert stop.value.code == 2
    assert message in said
    assert options.split()[0] in said
    assert "dummy" not in said
    assert "Annotated" not in said


def test_every_setting_is_an_option_with_its_default_and_what_it_is_for(capsys):
    with pytest.raises(SystemExit):
        offairl("run maze-imitation --help")
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    texts = docstrings()
    assert set(texts) == set(flat_settings())
    for name in flat_settings():
        option = re.split(rf" --{name.replace('_', '-')}[ ,]", text, maxsplit=1)[1]
        assert texts[name][:40] in option[:300], name
    assert "--temperature {None}|FLOAT α. None: learned from 0.2 on" in text
    assert "(default: 64 64)" in text.split("--hidden [INT [INT ...]]", 1)[1][:90]
    assert "--normalise, --no-normalise" in text
    assert "(default, where it has a use: released)" in text.split("--composition {", 1)[1][:160]


def test_only_what_was_given_changes_an_experiment(elsewhere, monkeypatch):
    made = []
    monkeypatch.setattr(launch, "_create", lambda place, points, *_: made.append(points) or {})
    monkeypatch.setattr(launch, "_finish", lambda *_, **__: None)

    def of(line):
        made.clear()
        offairl(f"run {line}")
        return made[0]

    base = EXPERIMENTS["maze-imitation"].configs["demo"]
    assert of("maze-imitation") == {"": base}
    # What another learner and reward have no use for does not get in the way.
    assert of("maze-imitation --learner td3 --reward dac") == {
        "": base.change(learner="td3", reward="dac")
    }
    options = "--loss released --temperature None --hidden 8 8 --no-normalise --train-every 50"
    changed = {"loss": "log-ratio", "temperature": None, "hidden": (8, 8), "normalise": False}
    assert of(f"maze-imitation {options}") == {"": base.change(**changed, train_every=50)}
    assert of("maze-imitation --learner sac-released --composition exact") == {
        "": base.change(learner="sac-released", composition="exact")
    }
    assert of("maze-imitation --reward-sees 0 1") == {"": base.change(reward_sees=(0, 1))}
    # Of several runs, it changes those that have a use for it.
    runs = of("hopper-dac --temperature 0.5")
    assert runs["sac"].learner.temperature == 0.5
    assert "temperature" not in runs["td3"].flat()
    (config,) = of("maze-dac --only td3 --hidden 8 8").values()
    assert config.learner.hidden == (8, 8)


def test_an_unknown_scale_is_answered_in_one_line(capsys, monkeypatch):
    monkeypatch.setenv("OFFAIRL_SCALE", "huge")
    assert "OFFAIRL_SCALE is 'huge'; expected one of ('demo', 'full')" in failure("list", capsys)


def test_a_folder_in_use_is_left_alone(capsys, elsewhere):
    (elsewhere / "used").mkdir()
    (elsewhere / "used" / "notes.txt").write_text("mine")
    line = f"run maze-expert --out used {SMALL}"
    assert "used is not empty" in failure(line, capsys)
    assert [path.name for path in (elsewhere / "used").iterdir()] == ["notes.txt"]
    assert "`offairl resume used` goes on" in failure(line, capsys)


def test_a_run_is_resumed_and_extended(capsys, elsewhere, monkeypatch, write_dataset):
    write_dataset("my/pendulum-v0")
    task = "--env-id Pendulum-v1 --dataset my/pendulum-v0 --trajectories 2 --train-every 50"
    offairl(f"run imitate --out whole {task} {LEARNED}")
    step = Collector.step

    def stop(self, explore):
        if self.steps == 150:
            raise KeyboardInterrupt
        return step(self, explore)

    with monkeypatch.context() as patch:
        patch.setattr(Collector, "step", stop)
        line = f"run imitate --out mine {task} {LEARNED}"
        assert failure(line, capsys) == "offairl: stopped; `offairl resume mine` goes on"
    assert manifest(elsewhere / "mine")["state"] == "stopped: KeyboardInterrupt()"
    assert [row.step for row in read(elsewhere / "mine").rows] == [100, 100]
    offairl("resume mine")
    for name in ("curve.csv", "policy.safetensors", "reward.safetensors"):
        assert (elsewhere / "mine" / name).read_bytes() == (elsewhere / "whole" / name).read_bytes()
    offairl("resume mine --steps 300 --seeds 5 --processes 1")
    run = read(elsewhere / "mine")
    assert (run.config.total_steps, run.seeds) == (300, (0, 1, 5))
    assert [row.step for row in run.rows if row.seed == 5] == [100, 200, 300]
    assert len(run.policy) == 3
    assert "reached step 300; it cannot end at 200" in failure("resume mine --steps 200", capsys)


def test_a_scheduler_may_stop_a_run(capsys, elsewhere, monkeypatch):
    step = Collector.step

    def stop(self, explore):
        if self.steps == 150:
            os.kill(os.getpid(), signal.SIGTERM)
        return step(self, explore)

    monkeypatch.setattr(Collector, "step", stop)
    before = signal.getsignal(signal.SIGTERM)
    line = f"run maze-expert --out mine {SMALL}"
    assert failure(line, capsys) == "offairl: stopped; `offairl resume mine` goes on"
    assert manifest(elsewhere / "mine")["state"] == "stopped: KeyboardInterrupt('SIGTERM')"
    assert failure("resume mine", capsys) == "offairl: stopped; `offairl resume mine` goes on"
    assert signal.getsignal(signal.SIGTERM) is before


def test_what_cannot_be_extended_is_left_as_it_was(capsys, elsewhere):
    offairl(f"run maze-expert --out mine {SMALL}")
    before = {path: path.read_bytes() for path in Path("mine").rglob("*") if path.is_file()}
    for line in ("--steps 300 --seeds 1", "--steps 100", "--processes 0"):
        assert failure(f"resume mine {line}", capsys).startswith("offairl: ")
    assert {path: path.read_bytes() for path in before} == before


def manifest(folder):
    return json.loads((folder / "run.json").read_text())


def test_a_member_that_diverges_is_told_of(capsys, elsewhere, monkeypatch):
    original, updates = SAC.update, count()

    def update(self, *batch):
        if next(updates) == 150:
            self.critic_params.data[:, 1] = torch.inf
        return original(self, *batch)

    monkeypatch.setattr(SAC, "update", update)
    with pytest.warns(UserWarning, match="seed 1 diverged"):
        message = failure(f"run maze-expert --out one {SMALL}", capsys)
    assert message.startswith("offairl: seed 1 diverged by step 200: its ")
    assert "recorded in one" in capsys.readouterr().out
    again = f"{message}. It is not tried again: start a new run"
    assert failure("resume one", capsys) == again
    assert [(row.seed, row.step) for row in read(elsewhere / "one").rows] == [
        (0, 100),
        (1, 100),
        (0, 200),
    ]


ARM = """
import gymnasium
import numpy as np
from gymnasium.spaces import Box

class Arm(gymnasium.Env):
    observation_space, action_space = Box(-9, 9, (3,)), Box(-2, 2, (2,))

    def __init__(self, mass=1):
        self.mass = mass

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.obs = self.np_random.uniform(-1, 1, 3).astype(np.float32)
        return self.obs, {}

    def step(self, action):
        self.obs = self.obs + np.float32(0.01 / self.mass) * np.append(action, 0)
        self.obs = self.obs.astype(np.float32)
        return self.obs, float(-np.abs(self.obs).sum()), False, False, {}

gymnasium.register("Arm-v0", entry_point=Arm, max_episode_steps=20)
gymnasium.register("Heavy-v0", entry_point=Arm, kwargs={"mass": 3}, max_episode_steps=20)
"""


def test_a_task_of_one_s_own_from_a_module_to_its_transfer(capsys, elsewhere, monkeypatch):
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p])
    (elsewhere / "arm.py").write_text(ARM)
    small, net = f"{SMALL} --train-every 50", StackedMLP((3, 4, 1))
    try:
        offairl(f"run imitate --reward environment --env-id arm:Arm-v0 {small} --out one")
        assert RunSpec.read("one").config.env_id == "arm:Arm-v0"
        assert read("one").config.env_id == "Arm-v0"
        learned = net.init(Rng((0, 1))), Normaliser.identity(2, 3)
        Reward("arm:Arm-v0", net, True, *learned).save("one/reward.safetensors")
        line = f"run imitate --env-id arm:Heavy-v0 --reward frozen --frozen-reward one {small}"
        offairl(f"{line} --pretrained policy --pretrained-policy one --out two --processes 2")
        assert read("two").steps.tolist() == [100, 200]
        offairl("verify two")
        message = failure(f"{line} --pretrained-policy one --out three", capsys)
        assert "--pretrained-policy one would not be used: add --pretrained policy" in message
        assert not Path("three").exists()
    finally:
        forget_arm()


def forget_arm():
    """Be as a new process, which has not imported the module."""
    for name in ("Arm-v0", "Heavy-v0"):
        gymnasium.registry.pop(name, None)
    sys.modules.pop("arm", None)


@pytest.fixture
def arm_folder(elsewhere, monkeypatch):
    """A run on a task of a module of one's own, at its end; the module is forgotten."""
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p])
    (elsewhere / "arm.py").write_text(ARM)
    line = f"run imitate --reward environment --env-id arm:Arm-v0 {SMALL} --train-every 50"
    offairl(f"{line} --out one")
    forget_arm()
    yield Path("one")
    forget_arm()


@pytest.mark.parametrize(
    "command",
    ["resume one --steps 250", "resume one --seeds 5", "verify one", "export --out files one"],
)
def test_no_file_s_module_is_imported_unless_the_user_names_it(command, arm_folder, capsys):
    before = {path: path.read_bytes() for path in arm_folder.rglob("*") if path.is_file()}
    verb = command.partition(" one")[0]
    message = failure(command, capsys)
    assert (
        "one is a run on arm:Arm-v0; for safety, no module is imported because a file names it"
        in message
    )
    assert message.endswith(f"`offairl {verb} one --env-id arm:Arm-v0`")
    wrong = failure(f"{command} --env-id arm:Heavy-v0", capsys)
    assert "--env-id is 'arm:Heavy-v0'; expected one of ('arm:Arm-v0',)" in wrong
    assert "arm" not in sys.modules
    assert {path: path.read_bytes() for path in before} == before
    offairl(f"{command} --env-id arm:Arm-v0")


def test_nor_is_it_for_python(arm_folder):
    run = read(arm_folder)
    for use in (
        lambda: folders.extend(arm_folder, 250),
        lambda: folders.verify(arm_folder),
        lambda: folders.work(arm_folder),
        lambda: rollout(run.policy, run.config.env_id, run.seeds, 1),
        lambda: envs.make(run.config.env_id, 1, 0),
    ):
        with pytest.raises(ValueError, match=r"env[-_]id"):
            use()
    assert "arm" not in sys.modules
    # Its curve, its settings and its policy can be had without.
    assert run.returns.shape == (2, 2)
    offairl("resume one")
    assert "arm" not in sys.modules


def test_what_a_command_names_its_processes_import(arm_folder, capsys):
    line = f"run imitate --reward environment --env-id arm:Arm-v0 {SMALL} --train-every 50"
    offairl(f"{line} --out both --processes 2 --prepare")
    forget_arm()
    assert "--env-id arm:Arm-v0`" in failure("resume both --processes 2", capsys)
    offairl("resume both --processes 2 --env-id arm:Arm-v0")
    assert read("both").returns.shape == (2, 2)
    forget_arm()
    offairl(f"{line} --out both --processes 2")  # All is there; the same command goes on.


def test_watching_names_the_task_as_well(arm_folder, capsys):
    assert failure("watch one", capsys).endswith("`offairl watch one --env-id arm:Arm-v0`")


def test_what_has_no_policy_yet_names_the_task_as_well(arm_folder, capsys):
    line = f"run imitate --reward environment --env-id arm:Arm-v0 {SMALL} --train-every 50"
    offairl(f"{line} --out begun --prepare")
    told = "has no policy.safetensors, .*: `offairl resume begun --env-id arm:Arm-v0` goes on"
    for command in ("watch begun", "export begun --out robot"):
        assert re.search(told, failure(f"{command} --env-id arm:Arm-v0", capsys))


@pytest.mark.parametrize(
    ("drawn", "elsewhere_drawn"),
    [
        ("self.np_random.uniform", "np.random.uniform"),
        ("self.obs.astype", "(self.obs + np.random.normal()).astype"),
    ],
)
def test_a_task_that_cannot_be_played_again_is_noted(drawn, elsewhere_drawn, arm_folder, capsys):
    Path("arm.py").write_text(Path("arm.py").read_text().replace(drawn, elsewhere_drawn))
    line = f"run imitate --reward environment --env-id arm:Arm-v0 {SMALL} --train-every 50"
    assert "played again" not in capsys.readouterr().err
    offairl(f"{line} --out noisy --prepare")
    said = capsys.readouterr().err
    assert "played again, so a run on it cannot be resumed: let the task draw from self" in said


def test_a_film_plays_as_fast_as_the_task(shipped_experts, capsys, monkeypatch):
    monkeypatch.setitem(envs.SingleEnv.metadata, "render_fps", 100)
    given = []
    monkeypatch.setattr(cli.films, "mp4", lambda pictures, fps: given.append(fps) or b"film")
    offairl("watch offairl/PointMazeLeft-v0 --max-steps 20")
    assert "film.mp4: 6 frames of" in capsys.readouterr().out
    assert given == [25]


def test_a_longer_run_is_told_to_extend(arm_folder, capsys):
    line = f"run imitate --reward environment --env-id arm:Arm-v0 {SMALL} --train-every 50"
    said = failure(f"{line} --out one --total-steps 400", capsys)
    assert "200, not 400: `offairl resume --steps 400 one --env-id arm:Arm-v0` extends it" in said


def test_a_task_that_never_ends_is_refused_before_the_first_step(arm_folder, capsys):
    Path("arm.py").write_text(Path("arm.py").read_text().replace(", max_episode_steps=20", ""))
    line = f"run imitate --reward environment --env-id arm:Arm-v0 {SMALL} --train-every 50"
    said = failure(f"{line} --out endless --prepare", capsys)
    assert "an episode of arm:Arm-v0 has not ended after 20,000 steps: give the task a time" in said
    assert not Path("endless").exists()


def test_what_stops_a_run_says_how_to_go_on_with_it(arm_folder, capsys, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(Collector, "step", stop)
    message = failure("resume one --steps 250 --env-id arm:Arm-v0", capsys)
    assert message == "offairl: stopped; `offairl resume one --env-id arm:Arm-v0` goes on"


def test_a_folder_may_have_the_name_of_an_experiment(elsewhere):
    offairl(f"run --seeds 0 --out imitate maze-expert {SMALL}")
    assert RunSpec.read(elsewhere / "imitate").experiment == "maze-expert"


def test_processes_share_the_seeds(capsys, elsewhere):
    line = f"run maze-expert --out both {SMALL} --processes 2"
    offairl(line)
    run = read(elsewhere / "both")
    assert (len(run.policy), run.returns.shape) == (2, (2, 2))
    names = [path.name for path in run_folders("both")]
    assert names == ["seeds-0", "seeds-1"]
    for path in run_folders("both"):
        assert "seed" not in (path / "checkpoint" / "log.txt").read_text()
        assert manifest(path)["state"] == "finished"
    # The same command again finds all done; further seeds join them.
    shutil.rmtree("both/seeds-1")
    offairl(line)
    assert torch.equal(read("both").policy.params, run.policy.params)
    offairl("resume both --seeds 5 --steps 300")
    assert (read("both").seeds, read("both").steps[-1]) == ((0, 1, 5), 300)


def test_what_is_given_of_other_runs_is_shared_out_with_the_seeds(elsewhere):
    offairl(f"run maze-expert --out one {SMALL}")
    given = "--pretrained policy --pretrained-policy one --guide-steps 20 --guide one"
    offairl(f"run maze-expert --out both {SMALL} {given} --processes 2 --prepare")
    params = read("one").policy.params
    for i, path in enumerate(run_folders("both")):
        assert RunSpec.read(path).inherited["pretrained_policy"]["members"] == [i]
        kept = [path / f"{name}.safetensors" for name in ("pretrained_policy", "guide")]
        assert all(torch.equal(Policy.load(file).params, params[[i]]) for file in kept)
        for file in kept:
            file.unlink()  # As it is in a record.
        given = inputs.recorded(path, RunSpec.read(path))
        assert all(torch.equal(thing.params, params[[i]]) for thing in given.values())


def test_a_process_that_fails_is_told_of(capsys, elsewhere):
    offairl(f"run maze-expert --out both {SMALL} --processes 2")
    offairl("resume both --steps 300")
    folders.extend(Path("both"), 400)
    log, replay = (Path("both/seeds-0/checkpoint") / name for name in ("log.txt", "replay.f32"))
    content = bytearray(replay.read_bytes())
    content[:] = bytes(len(content))
    replay.write_bytes(content)
    message = failure("resume both --processes 2", capsys)
    assert message.endswith(
        "1 of 2 jobs failed, twice: see above; `offairl resume both` goes on with them"
    )
    assert log.read_text().count("replay.f32 is damaged") == 2
    assert [row.step for row in read("both/seeds-1").rows] == [100, 200, 300, 400]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_processes_end_with_the_one_that_started_them(number, elsewhere):
    line = f"run maze-expert --out both {SMALL} --total-steps 1000000 --processes 2"
    command = [sys.executable, "-m", "offairl_lite.runs.cli", *line.split()]
    parent = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    parts = [elsewhere / "both" / f"seeds-{seed}" for seed in (0, 1)]
    while not all(part.exists() and manifest(part)["state"] == "running" for part in parts):
        time.sleep(0.1)
        assert parent.poll() is None
    parent.send_signal(number)
    said, end = parent.communicate()[1], time.monotonic() + 30
    if number == signal.SIGINT:
        assert b"offairl: stopped; `offairl resume both` goes on" in said
        assert parent.returncode == 1
    while number == signal.SIGKILL and "running" in [manifest(part)["state"] for part in parts]:
        time.sleep(0.1)  # They notice it within a second.
        assert time.monotonic() < end
    assert [manifest(part)["state"] for part in parts] == ["stopped: KeyboardInterrupt()"] * 2
    for part in parts:  # A process lets go of its lock a moment after it has said that it stopped.
        with FileLock(part / "checkpoint" / "lock", timeout=30):
            pass
    folders.extend(elsewhere / "both", 2_000_000)


@pytest.mark.parametrize(
    ("line", "compiler", "processes", "compiled"),
    [
        ("run maze-expert --scale full", "g++", 4, True),
        ("run maze-expert --scale full --seeds 0 1", None, 2, False),
        ("run maze-expert --scale full --processes 3 --compile no", "g++", 3, False),
        ("run maze-expert --scale full --total-steps 49000", "g++", 4, False),
        ("run maze-expert", "g++", 1, False),
    ],
)
def test_large_networks_are_compiled_and_spread(
    line, compiler, processes, compiled, capsys, monkeypatch
):
    made = []

    def create(folder, spec, _):
        made.append((folder.name, Execution(**spec.execution)))

    monkeypatch.setattr("offairl_lite.core.acceleration.compiler", lambda: compiler)
    monkeypatch.setattr("offairl_lite.core.acceleration.onednn_is_faster", lambda: True)
    monkeypatch.setattr(jobs, "cores", lambda: 4)
    monkeypatch.setattr(folders, "create", create)
    monkeypatch.setattr(launch, "_finish", lambda *_, **__: None)
    offairl(line)
    assert len(made) == processes
    assert {execution for _, execution in made} == {
        Execution("cpu", 1, compiled, onednn=processes > 1)
    }
    if processes == 4:
        assert made[0][0] == "seeds-0-1-2"


def test_a_record_is_verified(capsys, elsewhere, monkeypatch):
    offairl(f"run maze-expert {SMALL} --out one")
    offairl("verify one")
    assert "the same, every return of every episode" in capsys.readouterr().out
    curve, origin = elsewhere / "one" / "curve.csv", elsewhere / "one" / "run.json"
    rows = curve.read_text().splitlines()
    fields = rows[1].split(",")
    fields[4] = fields[4].replace("-", "-1", 1)
    curve.write_text("\n".join([rows[0], ",".join(fields), *rows[2:]]) + "\n")
    spec = RunSpec.read("one")
    replace(spec, execution={**spec.execution, "compile": True}).write(Path("one"))
    monkeypatch.setattr(Execution, "accelerate", lambda self, step, hidden: step)
    others = {"processor": "an abacus", "vectors": "ten"}
    write_json(origin, {**read_json(origin), "curve.csv": None, **others})
    message = failure("verify one", capsys)
    assert "one comes out otherwise here" in message
    assert "its updates are compiled, and every compiler rounds in its own way" in message
    assert "processor: an abacus, here" in message
    assert "vectors: ten, here" in message
    assert "(the environment variable ATEN_CPU_CAPABILITY sets them)" in message
    assert "versions" not in message
