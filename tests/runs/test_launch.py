import json
import os
import shutil
import subprocess
import sys
from collections import namedtuple
from dataclasses import replace
from pathlib import Path

import pytest
import tyro

from offairl_lite.core.acceleration import Execution
from offairl_lite.runs import checkpoints, folders, jobs, launch
from offairl_lite.runs.records import HEADER, RunSpec, read, read_json, write_json

SMALL = "--seeds 0 3 --total-steps 200 --learning-starts 100 --eval-every 100"

# In the place of the worker: the step's return is ten times the temperature, plus the seed.
WORK = """
import json, sys
from pathlib import Path

folder = Path(sys.argv[1])
about = json.loads((folder / "config.json").read_text())
value = about["config"].get("temperature")
if value == 0.4:
    sys.exit("too hot")
seeds = about["seeds"]
curve = "seed,step,episodes,mean_return,returns,learned_return\\n"
for seed in seeds:
    mean = 10 * (value or 0) + seed
    curve += f"{seed},200,2,{mean},{mean},nan\\n"
(folder / "curve.csv").write_text(curve)
lost = {"3": "too cold"} if value == 0.01 else {}
state = "stopped: every member has diverged" if lost and len(seeds) == 1 else "finished"
run = {"state": state, "step": 200, "diverged": lost}
(folder / "part").write_text(json.dumps(run))
(folder / "part").replace(folder / "run.json")
"""


@pytest.fixture
def offairl(tmp_path, monkeypatch):
    """The command, with stand-ins for the making of folders and for the work in them."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(jobs, "POLL_S", 0.02)
    script = tmp_path / "work.py"
    script.write_text(WORK)
    made = []

    def create(folder, spec, given):
        made.append((folder, {"spec": spec, **given}))
        folder.mkdir(parents=True)
        spec.write(folder)
        (folder / "run.json").write_text('{"state": "waiting", "step": 0}')
        (folder / "curve.csv").write_text(HEADER)

    def is_finished(folder):
        return json.loads((folder / "run.json").read_text())["state"] != "waiting"

    def work(folder, **_):
        subprocess.run([sys.executable, str(script), str(folder)], check=True)

    monkeypatch.setattr(folders, "create", create)
    monkeypatch.setattr(folders, "is_finished", is_finished)
    monkeypatch.setattr(folders, "work", work)
    monkeypatch.setattr(jobs, "command", lambda folder: [sys.executable, str(script), str(folder)])

    def call(line, name="maze-expert"):
        made.clear()
        command = launch.run_command(name, "demo")
        tyro.extras.subcommand_cli_from_dict(
            {"run": command, "other": print}, prog="offairl", args=["run", *line.split()]
        )
        return list(made)

    return call


def test_a_sweep_makes_its_folders_does_its_work_and_shows_the_returns(offairl, capsys, tmp_path):
    line = f"maze-expert --grid temperature=0.1,0.2 --grid hidden=8,8x8 {SMALL}"
    made = offairl(line)
    folder = Path("runs/sweep-maze-expert-demo")
    names = [f"temperature={t},hidden={h}" for t in ("0.1", "0.2") for h in ("8", "8x8")]
    assert [path for path, _ in made] == [folder / name for name in names]
    spec = made[0][1]["spec"]
    assert (spec.experiment, spec.scale) == ("maze-expert", "demo")
    assert (spec.execution["device"], spec.demonstrations) == ("cpu", None)
    assert sorted(os.listdir(folder)) == sorted(names)
    out = capsys.readouterr().out
    assert out.startswith(f"{folder / names[0]} takes up to 16.8 MB of disk, mostly replay;")
    for name, numbers in zip(names, ["2.50 1.00 4.00"] * 2 + ["3.50 2.00 5.00"] * 2, strict=True):
        assert f"200 {numbers} {name}" in " ".join(out.split())

    # The same command again finds all done; a wider grid does what is missing.
    assert offairl(line) == []
    assert capsys.readouterr().out == out[out.index("     step") :]
    wider = line.replace("0.1,0.2", "0.1,0.2,0.3")
    assert [path.name for path, _ in offairl(wider)] == [
        "temperature=0.3,hidden=8",
        "temperature=0.3,hidden=8x8",
    ]


def test_runs_are_told_where_their_reward_is_from(offairl):
    reward = Path(__file__).parents[2] / "book/records/maze-imitation-demo/reward.safetensors"
    seeds = SMALL.replace("0 3", "0 1 2 3 4")
    line = f"maze-transfer --grid temperature=0.1,0.2 --frozen-reward {reward} {seeds}"
    made = [given for _, given in offairl(line, "maze-transfer")]
    files = [given["spec"].inherited["frozen_reward"]["files"] for given in made]
    assert files == [[str(reward)]] * 2
    assert all(len(given["frozen_reward"]) == 5 for given in made)


def test_what_a_run_sets_itself_is_not_taken_from_the_command_line(offairl):
    message = r"\w+ sets env_id itself: vary that with grid=, .*or choose other runs with only="
    with pytest.raises(ValueError, match=message):
        offairl("locomotion --env-id Pendulum-v1", "locomotion")
    with pytest.raises(ValueError, match="sac-fixed sets temperature itself"):
        offairl("experts --temperature 0.5", "experts")
    line = "experts --grid temperature=0.5 --only PointMazeLeft-sac-fixed"
    assert len(offairl(line, "experts")) == 1


@pytest.mark.parametrize(
    ("line", "parts"),
    [
        ("--hidden 256", 2),
        ("--hidden 64", 1),
        ("--hidden 256 --processes 3", 1),
        ("--hidden 256 --processes 4 --prepare", 2),
        ("--hidden 256 --prepare", 1),
        ("--hidden 256 --device cuda --prepare", 1),
    ],
)
def test_idle_cores_share_large_networks(line, parts, offairl, monkeypatch):
    monkeypatch.setattr(jobs, "cores", lambda: 5)
    monkeypatch.setattr(launch, "choose_execution", lambda *_: Execution())
    made = offairl(f"maze-expert --grid temperature=0.1,0.2 {line} {SMALL}")
    assert len(made) == 2 * parts
    names = [path.name for path, _ in made if path.parent.name == "temperature=0.1"]
    assert names == (["seeds-0", "seeds-3"] if parts == 2 else [])


def test_a_disk_must_have_room_for_all_runs(offairl, monkeypatch):
    usage = namedtuple("Usage", "total used free")(10**9, 10**9, 3 * checkpoints.MARGIN)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    line = f"maze-expert --grid temperature=0.1,0.2 {SMALL} --out here"
    with pytest.raises(OSError, match=r"MB of disk are needed.* left: lower replay_size"):
        offairl(line)
    assert not Path("here").exists()
    assert len(offairl(line.replace("0.1,0.2", "0.1"))) == 1


def test_a_seed_is_given_once(offairl):
    with pytest.raises(ValueError, match=r"seeds are \(0, 0\): two members with one seed"):
        offairl(f"maze-expert {SMALL.replace('0 3', '0 0')} --processes 2")


def test_seeds_that_are_missing_are_made(offairl):
    line = f"maze-expert {SMALL} --temperature 0.1 --out here"
    assert [path for path, _ in offairl(line)] == [Path("here")]
    assert [path for path, _ in offairl(line.replace("0 3", "0 1 2 3"))] == [Path("here/seeds-1-2")]
    assert offairl(line.replace("0 3", "0 1 2 3")) == []


def test_folders_can_be_prepared_and_worked_on_later(offairl):
    line = f"maze-expert --grid temperature=0.1,0.2 {SMALL} --out here"
    assert len(offairl(f"{line} --prepare")) == 2
    assert not any(read(path.parent).rows for path in Path("here").glob("*/curve.csv"))
    assert offairl(line) == []
    assert [len(read(path.parent).rows) for path in Path("here").glob("*/curve.csv")] == [2, 2]


def test_what_is_there_must_be_of_the_same_kind(offairl, tmp_path):
    offairl(f"maze-expert --grid temperature=0.1 {SMALL} --out here")
    for other, message in [
        (
            "--discount 0.9",
            r"temperature=0.1 is a run with discount 0.99, not 0.9: give the same, or",
        ),
        ("--seeds 1", r"is a run with seeds \(0, 3\), not \(1,\)"),
    ]:
        with pytest.raises(ValueError, match=message):
            offairl(f"maze-expert --grid temperature=0.05,0.1 {SMALL} {other} --out here")
    assert os.listdir("here") == ["temperature=0.1"]
    path = Path("here/temperature=0.1")
    shown = {"dataset": None, "trajectories": 50, "subsample": 1, "experts": None}
    inherited = {"frozen_reward": {"files": ["one"], "digest": ""}}
    plan, line = RunSpec.read(path), f"maze-expert --grid temperature=0.1 {SMALL} --out here"
    for changes, same, other, message in [
        (
            {"demonstrations": shown, "config": plan.config.change(reward="dac")},
            "--reward dac",
            "--trajectories 5",
            "is a run with trajectories 50, not 5: give the same, or choose",
        ),
        (
            {"inherited": inherited, "config": plan.config.change(reward="frozen")},
            "--reward frozen --frozen-reward one",
            "--frozen-reward two",
            r"is a run with frozen_reward \['one'\], not \['two'\]",
        ),
    ]:
        replace(plan, **changes).write(path)
        assert offairl(f"{line} {same}") == []
        with pytest.raises(ValueError, match=message):
            offairl(f"{line} {same} {other}")
    about = read_json(Path("here/temperature=0.1/config.json"))
    about["config"]["gone"] = 1
    write_json(Path("here/temperature=0.1/config.json"), about)
    with pytest.raises(ValueError, match=r"temperature=0.1/config\.json does not describe a run"):
        offairl(f"maze-expert --grid temperature=0.1 {SMALL} --out here")


def test_failures_are_reported_and_the_rest_is_done(offairl, capsys):
    with pytest.raises(ChildProcessError, match=r"1 of 2 jobs failed, twice: see above; .*here"):
        offairl(f"maze-expert --grid temperature=0.4,0.1 {SMALL} --out here")
    out, err = capsys.readouterr()
    assert "too hot" in err
    assert "        0          -          -          -  temperature=0.4" in out
    assert "2.50       1.00       4.00  temperature=0.1" in out


def test_members_that_diverged_are_named(offairl, capsys):
    offairl(f"maze-expert --grid temperature=0.01,0.1 {SMALL}")
    assert "temperature=0.01 (diverged: 3)" in capsys.readouterr().out
    with pytest.raises(FloatingPointError, match="too cold"):  # It is the only run.
        offairl(f"maze-expert --grid temperature=0.01 {SMALL} --out one")


def test_runs_without_a_member_left_are_an_error(offairl, capsys):
    with pytest.raises(FloatingPointError, match="too cold"):
        offairl(f"maze-expert --grid temperature=0.01,0.1 {SMALL.replace(' 0 3', ' 3')}")
    assert "temperature=0.01 (diverged: 3)" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("choice", "hidden", "steps", "compiler", "expected"),
    [
        ("auto", "400x300", 50_000, "g++", True),
        ("auto", "400x300", 50_000, None, False),
        ("auto", "64x64", 50_000, "g++", True),
        ("auto", "400x300", 20_000, "g++", False),
        ("yes", "64x64", 20_000, "g++", True),
        ("no", "400x300", 50_000, "g++", False),
    ],
)
def test_long_runs_are_compiled(choice, hidden, steps, compiler, expected, offairl, monkeypatch):
    monkeypatch.setattr("offairl_lite.core.acceleration.compiler", lambda: compiler)
    monkeypatch.setattr("offairl_lite.core.acceleration.onednn_is_faster", lambda: True)
    line = f"maze-expert --grid hidden={hidden} --compile {choice} {SMALL} --total-steps {steps}"
    (_, given), *_ = offairl(line.replace("--total-steps 200 ", "") + " --temperature 0.1")
    assert given["spec"].execution["compile"] is expected
    assert given["spec"].execution["onednn"] is (hidden == "400x300")


def test_an_interrupt_tells_how_to_go_on(offairl, monkeypatch):
    def interrupted(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(jobs, "execute", interrupted)
    with pytest.raises(SystemExit, match=r"stopped; `offairl resume runs/.*demo` goes on"):
        offairl(f"maze-expert --grid temperature=0.1,0.2 {SMALL}")


def test_demonstrations_and_rewards_are_given_where_they_are_needed(
    offairl, shipped_experts, minari_folder, tmp_path
):
    given = dict(
        (path.name, given)
        for path, given in offairl(
            "maze-imitation --grid reward=dac,environment --temperature 0.1 "
            f"--trajectories 2 --subsample 20 {SMALL}",
            "maze-imitation",
        )
    )
    assert given["reward=dac"]["spec"].demonstrations["trajectories"] == 2
    assert given["reward=dac"]["spec"].demonstrations["subsample"] == 20
    assert given["reward=environment"]["spec"].demonstrations is None
    with pytest.raises(
        ValueError,
        match=r"first `offairl run maze-imitation --scale demo`, then add frozen_reward=",
    ):
        offairl(f"maze-transfer --grid temperature=0.1 {SMALL} --out there", "maze-transfer")
    assert not Path("there").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--reward environment --dataset my/own-v0", "dataset=my/own-v0 .* no reward is learned"),
        ("--reward environment --subsample 7", "subsample=7 would not be used, since no reward"),
        ("--reward environment --experts 1", "experts=1 would not be used, since no reward"),
        ("--dataset my/own-v0 --experts 1", "experts=1 would .* since my/own-v0 is by none"),
    ],
)
def test_demonstrations_that_would_not_be_used_are_refused(options, message, offairl):
    with pytest.raises(ValueError, match=message):
        offairl(f"maze-imitation --grid temperature=0.1 {SMALL} {options}", "maze-imitation")


@pytest.mark.parametrize("axis", ["temperature", "=1", "temperature=0.1 --grid temperature=0.2"])
def test_an_axis_has_a_form(axis, offairl):
    with pytest.raises(ValueError, match=r"SETTING=VALUE,VALUE|^no setting ''"):
        offairl(f"maze-expert --grid {axis} {SMALL}")


def test_an_experiment_of_several_runs_is_some_or_all_of_them(offairl):
    line = "experts --seeds 0 --only Hopper-td3 PointMazeLeft-sac-learned"
    made = offairl(line, "experts")
    folder = Path("runs/experts-demo")
    assert [path for path, _ in made] == [
        folder / "Hopper-td3",
        folder / "PointMazeLeft-sac-learned",
    ]
    configs = [json.loads((path / "config.json").read_text())["config"] for path, _ in made]
    assert [config["env_id"] for config in configs] == ["Hopper-v5", "offairl/PointMazeLeft-v0"]
    # All of them, and each at every point of a grid.
    assert len(offairl("experts --seeds 0", "experts")) == 24 - 2
    made = offairl("experts --seeds 0 --only Ant-td3 --grid target_rate=0.1,0.2", "experts")
    assert [path.name for path, _ in made] == ["Ant-td3,target_rate=0.1", "Ant-td3,target_rate=0.2"]
    assert made[0][0].parent == Path("runs/sweep-experts-demo")


def test_an_unknown_run_is_refused_with_those_there_are(offairl):
    with pytest.raises(ValueError, match=r"no runs \['Hopper'\]; there are: HalfCheetah-td3, "):
        offairl("experts --only Hopper", "experts")
