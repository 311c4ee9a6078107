"""What is exported does what the package does: in ONNX Runtime, and as a program of PyTorch."""

import re
import sys
from contextlib import closing

import gymnasium
import numpy as np
import pytest
import torch
from run_folders import create

from offairl_lite.cloning import clone
from offairl_lite.core.policies import Policy
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rollouts import action
from offairl_lite.learned_reward import LearnedReward
from offairl_lite.runs import cli, records
from offairl_lite.runs.export import export
from offairl_lite.runs.folders import work
from offairl_lite.runs.inputs import load_one
from offairl_lite.runs.records import read_json, write_json

SHORT = {"train_every": 20, "total_steps": 40, "learning_starts": 20, "eval_every": 40}
SMALL = {"trunk_hidden": (8,), "primitive_hidden": (8,), "gate_hidden": (8,)}
CASES = {
    "sac": {},
    "td3": {"learner": "td3", "reward": "dac"},
    "sac-mcp": {"primitives": 2, **SMALL},
    "state-action": {"reward": "r-sa"},
    "absorbing": {"absorbing": "bootstrap"},
}
ROWS = 1_000


@pytest.fixture
def finished(tiny, tmp_path, own, random_demonstrations):
    """Make a run on a task with actions from -2 to 4 and from 0 to 1."""

    def make(seeds=(0, 3), **changes):
        config = tiny.change(env_id=own("Arm-v0"), **SHORT, **changes)
        shown = random_demonstrations("Arm-v0") if config.imitates else None
        create(tmp_path / "run", config, seeds, shown)
        work(tmp_path / "run", demonstrations=shown, progress=False)
        return tmp_path / "run"

    return make


def samples():
    """Observations and actions of `Arm-v0`, in its own units."""
    rng, space = np.random.default_rng(0), gymnasium.make("Arm-v0").action_space
    obs = rng.normal(0, 2, (ROWS, 2)).astype(np.float32)
    return obs, rng.uniform(space.low, space.high, (ROWS, 2)).astype(np.float32), space


def expected(run, member):
    """What a member does, one observation after another, and its reward of all of them."""
    obs, actions, space = samples()
    done = np.stack([action(run.policy.member(member), x, space) for x in obs])
    unit = torch.tensor((actions - space.low) / (space.high - space.low) * 2 - 1)
    return {
        "policy": done,
        "reward": run.reward.member(member)(torch.tensor(obs)[None], unit[None])[0].numpy(),
    }


def inputs(kind, reward):
    obs, actions, _ = samples()
    return {"obs": obs} | ({} if kind == "policy" or reward.state_only else {"action": actions})


@pytest.mark.parametrize("case", CASES)
def test_a_program_of_pytorch_does_the_same(case, finished, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    run = records.read(folder := finished(**CASES[case]))
    export(folder, tmp_path / "out")
    for member in (0, 1):
        for kind, wanted in expected(run, member).items():
            program = torch.export.load(tmp_path / f"out/{kind}-{member}.pt2").module()
            given = [torch.tensor(x) for x in inputs(kind, run.reward).values()]
            np.testing.assert_allclose(program(*given), wanted, atol=1e-5)
            assert len(program(*(x[:1] for x in given))) == 1
            assert np.ptp(wanted, 0).min() > 1e-3


@pytest.mark.parametrize("case", CASES)
def test_onnx_runtime_does_the_same(case, finished, tmp_path, capfd):
    onnxruntime = pytest.importorskip(
        "onnxruntime", reason="ONNX is not installed: pip install -e '.[export]'"
    )
    run = records.read(folder := finished(**CASES[case]))
    capfd.readouterr()
    assert export(folder, tmp_path / "out", 1) == []
    assert capfd.readouterr() == ("", "")
    for kind, wanted in expected(run, 1).items():
        session = onnxruntime.InferenceSession(tmp_path / f"out/{kind}-1.onnx")
        given = inputs(kind, run.reward)
        (found,) = session.run(None, given)
        np.testing.assert_allclose(found, wanted, atol=1e-5)
        assert found.dtype == np.float32
        (found,) = session.run(None, {name: x[:1] for name, x in given.items()})
        np.testing.assert_allclose(found, wanted[:1], atol=1e-5)
    assert not (tmp_path / "out/policy-0.onnx").exists()


def test_the_text_beside_the_files_loads_them(finished, tmp_path, monkeypatch, capsys):
    folder = finished(reward="r-sa")
    cli.main(["export", str(folder), "--out", str(tmp_path / "out")])
    assert "how to load it" in capsys.readouterr().out
    monkeypatch.chdir(tmp_path / "out")
    text = (tmp_path / "out/README.txt").read_text()
    assert "from [-2.0, 0.0] to [4.0, 1.0]" in text
    assert re.search(r"Member 1: seed 3, return \S+ at step 40", text)
    blocks = re.findall(r"(?:    .+\n)+", text)
    assert len(blocks) == (4 if (tmp_path / "out/policy-0.onnx").exists() else 2)
    for block in blocks:
        known = {}
        exec(re.sub("(?m)^    ", "", block), known)
        shape = (1, 2) if "policy" in block else (1,)
        assert known["action" if "policy" in block else "reward"].shape == shape


def test_the_text_says_what_an_end_is_worth(finished, tmp_path):
    run = records.read(folder := finished(absorbing="bootstrap"))
    export(folder, tmp_path / "out")
    text = (tmp_path / "out/README.txt").read_text()
    found = re.findall(r"terminates, add (\S+) to reward-(\d), at a discount of 0.99", text)
    assert [i for _, i in found] == ["0", "1"]
    with closing(gymnasium.make("Arm-v0")) as env:
        for worth, i in found:
            paid = LearnedReward(env, run.reward, int(i))
            assert float(worth) == pytest.approx(paid._rest, rel=1e-4)


def test_without_onnx_programs_are_written_and_the_remedy_is_told(
    finished, tmp_path, monkeypatch, capsys
):
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    cli.main(["export", str(finished()), "--out", str(tmp_path / "out"), "--member", "0"])
    assert "note: ONNX is not installed" in (said := capsys.readouterr().err)
    assert "pip install onnx onnxscript" in said
    names = {"README.txt", "policy-0.pt2", "reward-0.pt2"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == names
    assert "InferenceSession" not in (tmp_path / "out/README.txt").read_text()


def test_a_run_on_the_tasks_own_reward_has_none_to_export(finished, tmp_path, capsys):
    cli.main(["export", str(finished(reward="environment")), "--out", str(tmp_path / "out")])
    assert "has no reward to export: it was trained on the task's own" in capsys.readouterr().err
    assert not [*(tmp_path / "out").glob("reward*")]
    assert (tmp_path / "out/policy-1.pt2").is_file()


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"reward": "sqil"}, "sqil imitates without learning one"),
        ({"reward": "iq-learn"}, "iq-learn imitates without learning one"),
        ({"reward": "dac", "ablation": "state-pairs"}, "state-only DAC judges steps"),
        ({"reward": "environment"}, "it was trained on the task's own"),
    ],
)
def test_a_run_that_learned_no_reward_has_none_to_use_again(finished, tmp_path, changes, why):
    folder = finished(**changes)
    with pytest.raises(ValueError, match=f"run has no reward to use again: {why}"):
        load_one(folder, Reward)
    assert len(load_one(folder, Policy)) == 2
    assert f"no reward to export: {why}" in " ".join(export(folder, tmp_path / "out"))


def test_a_clone_is_exported_like_the_policy_of_a_run(own, random_demonstrations, tmp_path, capsys):
    policy = clone(random_demonstrations(own("Arm-v0")), (4, 5), hidden=(8,), steps=10)
    policy.save(file := tmp_path / "arm.safetensors")
    cli.main(["export", str(file), "--out", str(tmp_path / "out"), "--member", "1"])
    assert "arm.safetensors has no reward to export: it is the file of a policy" in (
        capsys.readouterr().err
    )
    program = torch.export.load(tmp_path / "out/policy-1.pt2").module()
    obs, _, space = samples()
    wanted = action(policy.member(1), obs, space)
    np.testing.assert_allclose(program(torch.tensor(obs)), wanted, atol=1e-5)
    text = (tmp_path / "out/README.txt").read_text()
    assert f"From {file}, trained on Arm-v0.\n\nMember 1\n" in text
    assert not [*(tmp_path / "out").glob("*-0.*"), *(tmp_path / "out").glob("reward*")]
    for option, why in (("--step 5", "leave out step"), ("--env-id Swimmer-v5", "given 8")):
        line = ["export", str(file), "--out", str(tmp_path / "other"), *option.split()]
        with pytest.raises(SystemExit, match=why):
            cli.main(line)


def test_members_that_have_diverged_are_left_out(finished, tmp_path):
    folder = finished(reward="environment")
    about = read_json(folder / "run.json")
    write_json(folder / "run.json", about | {"diverged": {"0": "seed 0 diverged by step 20"}})
    why = "member 0 of .* cannot be exported: seed 0 diverged by step 20"
    with pytest.raises(ValueError, match=why):
        export(folder, tmp_path / "out", 0)
    assert not (tmp_path / "out").exists()
    assert re.search(why, export(folder, tmp_path / "out")[0])
    assert not (tmp_path / "out/policy-0.pt2").exists()
    assert (tmp_path / "out/policy-1.pt2").is_file()
    both = {"0": "seed 0 diverged by step 20", "3": "seed 3 diverged by step 40"}
    write_json(folder / "run.json", about | {"diverged": both})
    with pytest.raises(ValueError, match=r"step 20; .*step 40"):
        export(folder, tmp_path / "more")
