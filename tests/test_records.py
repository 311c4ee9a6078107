import json
import math
from dataclasses import replace

import pytest
import torch

from offairl_lite import records
from offairl_lite.discriminators import Reward
from offairl_lite.imitate import Row, Run, Trainer, complete
from offairl_lite.networks import Normaliser, save_weights
from offairl_lite.policies import Deterministic, Policy
from offairl_lite.records import COLUMNS, METRICS, Recorder, read
from offairl_lite.streams import Streams

SEEDS = (3, 7)


def rows(step):
    """Numbers whose shortest decimal form is long, and one that is missing."""
    metrics = {"cross_entropy": 0.1 + 0.2, "q": -1e-17}
    returns = (math.pi, -step / 3)
    return [Row(seed, step, step // 100, math.e, returns, 2 / 3, metrics) for seed in SEEDS]


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "runs" / "one"


@pytest.fixture
def unfinished(folder, tiny):
    recorder = Recorder(folder, tiny, SEEDS)
    recorder.add(rows(100))
    recorder.add(rows(200))
    return recorder


def test_a_run_comes_back_as_it_was(folder, tiny, random_demonstrations):
    recorder = Recorder(folder, tiny, SEEDS)
    demonstrations = random_demonstrations(tiny.env_id)
    run = complete(Trainer(tiny, SEEDS, demonstrations), False, recorder.add)
    recorder.finish(run)
    again = read(folder)
    assert (again.config, again.seeds, again.rows) == (tiny, SEEDS, run.rows)
    assert set(run.rows[0].metrics) <= set(METRICS)
    obs = Streams(SEEDS).normal(5, 3)
    assert torch.equal(again.policy.act(obs), run.policy.act(obs))
    assert torch.equal(again.reward(obs), run.reward(obs))
    assert (again.policy.env_id, again.reward.env_id) == (tiny.env_id, tiny.env_id)


def test_without_a_learned_reward_none_is_kept(folder, tiny):
    config = replace(tiny, reward="environment", hidden=(4,))
    recorder = Recorder(folder, config, SEEDS)
    recorder.finish(complete(Trainer(config, SEEDS), False, recorder.add))
    again = read(folder)
    assert again.config == config
    assert again.reward is None
    assert all(math.isnan(row.learned_return) for row in again.rows)


def test_a_run_cut_short_leaves_its_curve(unfinished, tiny):
    run = read(unfinished.folder)
    assert (run.config, run.rows) == (tiny, rows(100) + rows(200))
    assert (run.policy, run.reward) == (None, None)
    assert run.steps.tolist() == [100, 200]
    assert run.returns.tolist() == [[math.e, math.e]] * 2


def test_the_manifest_says_what_made_the_run(unfinished):
    def manifest():
        return json.loads((unfinished.folder / "run.json").read_text())

    assert manifest()["state"] == "running"
    assert manifest()["versions"]["torch"] == torch.__version__
    assert set(manifest()["versions"]) == set(records.PACKAGES)
    actor = Policy("x", *policy_parts())
    unfinished.finish(Run(read(unfinished.folder).config, SEEDS, [], actor))
    assert manifest()["state"] == "finished"
    assert not list(unfinished.folder.glob("*.part"))


def test_what_stopped_a_run_is_noted(folder, tiny):
    def run():
        with Recorder(folder, tiny, SEEDS) as recorder:
            recorder.add(rows(100))
            raise FloatingPointError("seed 7 diverged")

    with pytest.raises(FloatingPointError):
        run()
    state = json.loads((folder / "run.json").read_text())["state"]
    assert state == "stopped: FloatingPointError: seed 7 diverged"
    assert len(read(folder).rows) == 2


def policy_parts():
    actor = Deterministic(3, 2, (4,))
    return actor, actor.init(Streams(SEEDS)), Normaliser.identity(2, 3)


def test_nothing_is_overwritten(unfinished, tiny):
    with pytest.raises(FileExistsError, match="is not empty"):
        Recorder(unfinished.folder, tiny, (0,))
    assert len(read(unfinished.folder).rows) == 4


def test_an_empty_folder_is_taken(folder, tiny):
    folder.mkdir(parents=True)
    Recorder(folder, tiny, SEEDS)
    assert read(folder).rows == []


@pytest.mark.parametrize("name", ["config.json", "curve.csv"])
def test_a_folder_that_is_no_record_is_refused(unfinished, name):
    (unfinished.folder / name).unlink()
    with pytest.raises(FileNotFoundError, match=f"no record of a run: it has no {name}"):
        read(unfinished.folder)


def test_a_configuration_of_another_version_is_refused(unfinished):
    path = unfinished.folder / "config.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "momentum": 0.9}))
    with pytest.raises(ValueError, match=r"config.json is of another version: .*momentum"):
        read(unfinished.folder)


def test_a_curve_with_other_columns_is_refused(unfinished):
    path = unfinished.folder / "curve.csv"
    assert path.read_text().splitlines()[0] == ",".join(COLUMNS)
    path.write_text(path.read_text().replace("mean_return", "reward", 1))
    with pytest.raises(ValueError, match=r"curve.csv has columns .*'reward'.*expected"):
        read(unfinished.folder)


@pytest.mark.parametrize("kind", [Policy, Reward])
def test_foreign_weights_are_refused(tmp_path, kind):
    path = tmp_path / "x.safetensors"
    name = kind.__name__.lower()
    with pytest.raises(FileNotFoundError, match=f"no {name} at"):
        kind.load(path)
    path.write_bytes(b"something else altogether")
    with pytest.raises(ValueError, match="no safetensors file"):
        kind.load(path)
    other = "reward" if kind is Policy else "policy"
    save_weights(path, {"params": torch.zeros(1, 2)}, {"kind": other})
    with pytest.raises(ValueError, match=f"holds '{other}', not a {name}"):
        kind.load(path)


def test_weights_that_do_not_fit_their_architecture_are_refused(tmp_path):
    actor, params, normaliser = policy_parts()
    Policy("x", actor, params[:, 1:], normaliser).save(tmp_path / "x.safetensors")
    with pytest.raises(
        ValueError, match=rf"weights \(2, 25\), expected \(S, {actor.net.num_params}\)"
    ):
        Policy.load(tmp_path / "x.safetensors")
