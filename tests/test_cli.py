import json

import pytest
import torch

from offairl_lite import cli
from offairl_lite.experiments import EXPERIMENTS
from offairl_lite.records import read

SMALL = (
    "--seeds 0 1 --total-steps 200 --warmup-steps 100 --batch-size 8 --eval-every 100 "
    "--eval-episodes 2 --hidden 8 --reward-hidden 8 --shaping-hidden 8"
)


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
        assert experiment.about in out
    assert "demo: 6,000 steps, 5 seeds" in out
    assert "full: 1,000,000 steps, 10 seeds" in out
    assert "offairl/PointMazeLeft-v0   2 policies" in out


def test_demos_makes_and_describes_demonstrations(capsys, shipped_experts):
    offairl("demos offairl/PointMazeLeft-v0 --trajectories 3")
    assert "PointMazeLeft-v0: 3 trajectories, 300 steps, return -" in capsys.readouterr().out


def test_run_then_transfer_then_watch(capsys, shipped_experts, elsewhere):
    offairl(f"run maze-imitation --trajectories 2 {SMALL}")
    folder = elsewhere / "runs" / "maze-imitation-demo"
    run = read(folder)
    assert (run.seeds, run.steps.tolist()) == ((0, 1), [100, 200])
    assert (run.config.batch_size, run.config.hidden) == (8, (8,))
    # What was not asked for is the experiment's own.
    assert (run.config.temperature, run.config.warmup_hold) == (None, 10.0)
    assert json.loads((folder / "run.json").read_text())["state"] == "finished"
    out = capsys.readouterr().out
    assert f"{run.rows[-1].mean_return:10.2f}" in out
    assert "recorded in runs/maze-imitation-demo" in out

    reward = folder / "reward.safetensors"
    offairl(f"run maze-transfer --frozen {reward} --out transfer {SMALL}")
    transfer = read(elsewhere / "transfer")
    assert transfer.config.env_id == "offairl/PointMazeRight-v0"
    assert torch.equal(transfer.reward.params, run.reward.params)

    offairl(f"watch {folder} --member 1 --max-steps 3 --out one.mp4")
    assert (elsewhere / "one.mp4").read_bytes()[4:8] == b"ftyp"
    assert "one.mp4: 4 frames of offairl/PointMazeLeft-v0" in capsys.readouterr().out
    assert "member is 2" in failure(f"watch {folder} --member 2", capsys)


def test_watch_takes_a_task_or_a_policy_s_file(capsys, shipped_experts, elsewhere):
    for what in ("offairl/PointMazeLeft-v0", "experts/PointMazeLeft.safetensors"):
        offairl(f"watch {what} --max-steps 2 --env-id offairl/PointMazeRight-v0")
        assert "film.mp4: 3 frames of offairl/PointMazeRight-v0" in capsys.readouterr().out


def test_a_task_and_data_of_one_s_own(capsys, write_dataset, elsewhere):
    write_dataset("my/pendulum-v0")
    offairl(
        "run imitate --env-id Pendulum-v1 --dataset my/pendulum-v0 --trajectories 2 "
        f"--update-every 50 --out mine {SMALL}"
    )
    run = read(elsewhere / "mine")
    assert run.config.env_id == run.policy.env_id == "Pendulum-v1"
    assert (run.config.update_every, len(run.rows)) == (50, 4)


def test_the_scale_decides_the_defaults(capsys, monkeypatch):
    for line, variable, steps in [
        ("run maze-imitation --help", "demo", "6000"),
        ("run maze-imitation --help", "full", "1000000"),
        ("run maze-imitation --scale full --help", "demo", "1000000"),
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
            "`offairl run maze-imitation`, then add --frozen runs/maze-imitation-demo/reward",
        ),
        ("run maze-transfer --frozen no.safetensors", "no reward at no.safetensors"),
        ("run maze-imitation --env-id Nowhere-v0", "no expert is shipped for Nowhere-v0"),
        (f"run maze-expert --env-id Nowhere-v0 {SMALL}", "unknown environment 'Nowhere-v0'"),
        ("run imitate --env-id Nowhere-v0 --dataset my/pendulum-v0", "Nowhere"),
        ("run imitate --env-id Pendulum-v1 --dataset my/other-v0", "no local data set"),
        ("demos Nowhere-v0", "no expert is shipped for Nowhere-v0"),
        ("watch Nowhere-v0", "no expert is shipped for Nowhere-v0"),
        ("watch no.safetensors", "no policy at no.safetensors"),
    ],
)
def test_mistakes_are_answered_in_one_line(
    line, message, capsys, shipped_experts, write_dataset, elsewhere
):
    write_dataset("my/pendulum-v0", episodes=1)
    assert message in failure(line, capsys)
    assert not (elsewhere / "runs").exists()


def test_a_value_that_makes_no_sense_is_explained(capsys):
    with pytest.raises(SystemExit) as stop:
        offairl("run maze-imitation --discount 2")
    assert stop.value.code == 2
    assert "discount is 2.0; expected a number" in capsys.readouterr().err


def test_an_unknown_scale_is_answered_in_one_line(capsys, monkeypatch):
    monkeypatch.setenv("OFFAIRL_SCALE", "huge")
    assert "'demo' or 'full'" in failure("list", capsys)


def test_a_folder_in_use_is_left_alone(capsys, elsewhere):
    (elsewhere / "used").mkdir()
    (elsewhere / "used" / "notes.txt").write_text("mine")
    line = f"run maze-expert --out used {SMALL}"
    assert "used is not empty" in failure(line, capsys)
    assert [path.name for path in (elsewhere / "used").iterdir()] == ["notes.txt"]
