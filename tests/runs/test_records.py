"""The files of a run's folder."""

import math
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from offairl_lite.core.loop import Row, train
from offairl_lite.core.networks import Normaliser, save_weights
from offairl_lite.core.policies import Deterministic, Policy
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rng import Rng
from offairl_lite.runs.records import (
    HEADER,
    METRICS,
    RunSpec,
    lines,
    read,
    read_json,
    seeds_name,
    write_json,
    write_whole,
)

SEEDS = (3, 7)


def rows(step):
    """Numbers whose shortest decimal form is long, and one that is missing."""
    metrics = {"cross_entropy": 0.1 + 0.2, "q": -1e-17}
    returns = (math.pi, -step / 3)
    return [Row(seed, step, step // 100, math.e, returns, 2 / 3, metrics) for seed in SEEDS]


BEGUN = {"state": "running", "step": 0}


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "runs" / "one"


@pytest.fixture
def spec(tiny):
    return RunSpec(tiny, SEEDS, {"device": "cpu", "threads": 1}, None, 60, "maze", "demo")


@pytest.fixture
def record(folder, spec):
    """What there is of a run after two evaluations."""
    folder.mkdir(parents=True)
    spec.write(folder)
    (folder / "curve.csv").write_text(HEADER + lines(rows(100) + rows(200)))
    return folder


def test_a_specification_comes_back_as_it_was(record, spec):
    assert RunSpec.read(record) == spec
    assert spec.seeds == SEEDS


def test_a_curve_from_before_a_diagnostic_existed_is_read(record):
    path = record / "curve.csv"
    older = [line.rsplit(",", 1)[0] + "\n" for line in path.read_text().splitlines()]
    path.write_text("".join(older))
    assert read(record).rows == rows(100) + rows(200)
    # The run was resumed since: its first lines are shorter than the others.
    path.write_text(path.read_text() + lines(rows(300)))
    assert read(record).rows == rows(100) + rows(200) + rows(300)


def test_a_record_comes_back_as_it_was(record, tiny):
    run = read(record)
    assert (run.config, run.seeds, run.rows) == (tiny, SEEDS, rows(100) + rows(200))
    assert (run.policy, run.reward, run.diverged) == (None, None, {})
    assert run.steps.tolist() == [100, 200]
    assert run.returns.tolist() == [[math.e, math.e]] * 2


@pytest.mark.parametrize("ablation", [None, "penalty-on-probability"])
def test_what_a_run_measures_has_a_column(tiny, random_demonstrations, ablation):
    config = tiny.change(ablation=ablation)
    run = train(config, SEEDS, random_demonstrations(tiny.env_id), progress=False)
    assert set(run.rows[0].metrics) <= set(METRICS)


def test_what_there_is_not_is_left_out(record, spec):
    replace(spec, config=spec.config.change(reward="environment")).write(record)
    row = rows(100)[0]._replace(learned_return=math.nan, metrics={})
    (record / "curve.csv").write_text(HEADER + lines([row]))
    (again,) = read(record).rows
    assert math.isnan(again.learned_return)
    assert again.metrics == {}


def test_members_that_were_given_up_are_named(record):
    write_json(record / "run.json", {**BEGUN, "diverged": {"7": "seed 7 diverged"}})
    assert read(record).diverged == {7: "seed 7 diverged"}


@pytest.fixture
def parts(folder, spec):
    """A run whose seeds are in two run folders."""
    for seed in SEEDS:
        part = folder / f"seeds-{seed}"
        part.mkdir(parents=True)
        replace(spec, seeds=(seed,)).write(part)
        own = [row for row in rows(100) + rows(200) if row.seed == seed]
        (part / "curve.csv").write_text(HEADER + lines(own))
        write_json(part / "run.json", {**BEGUN, "diverged": {str(seed): "far away"}})
    return folder


def test_several_run_folders_are_one_run(parts, tiny):
    run = read(parts)
    assert (run.config, run.seeds, run.rows) == (tiny, SEEDS, rows(100) + rows(200))
    assert (run.policy, run.reward) == (None, None)
    assert run.diverged == dict.fromkeys(SEEDS, "far away")
    actor, params, normaliser = policy_parts()
    whole = Policy("x", actor, params, normaliser)
    whole.member(0).save(parts / "seeds-3" / "policy.safetensors")
    assert read(parts).policy is None
    whole.member(1).save(parts / "seeds-7" / "policy.safetensors")
    assert torch.equal(read(parts).policy.params, params)
    # One that is being made is none yet.
    shutil.copytree(parts / "seeds-7", parts / ".seeds-9.x" / "run")
    assert read(parts).seeds == SEEDS


def test_runs_of_several_configurations_are_not_one(parts, spec):
    other = replace(spec, config=spec.config.change(discount=0.5), seeds=(7,))
    other.write(parts / "seeds-7")
    with pytest.raises(
        ValueError, match=r"several configurations: discount and .* differ between .*-3"
    ):
        read(parts)
    replace(spec, seeds=(3,)).write(parts / "seeds-7")
    with pytest.raises(ValueError, match="several runs of the same seeds"):
        read(parts)


def test_a_line_that_is_being_written_is_not_read(record):
    path = record / "curve.csv"
    path.write_text(path.read_text()[:-5])
    assert read(record).rows == [*rows(100), rows(200)[0]]
    path.write_text(HEADER[:-1])
    assert read(record).rows == []


def test_many_seeds_make_a_name_that_a_disk_takes():
    seeds = tuple(range(10**9, 10**9 + 30))
    assert seeds_name(SEEDS) == "seeds-3-7"
    assert len(seeds_name(seeds)) < 50
    assert seeds_name(seeds) != seeds_name((seeds[0], *seeds[1:-1][::-1], seeds[-1]))


def test_a_file_is_the_old_one_or_the_new(tmp_path):
    path = tmp_path / "x.json"
    write_json(path, {"a": 1})

    def fail(part):
        part.write_text("half")
        raise OSError("the disk is full")

    with pytest.raises(OSError, match="the disk is full"):
        write_whole(path, fail)
    assert read_json(path) == {"a": 1}
    write_json(path, {"a": 2})
    assert read_json(path) == {"a": 2}
    assert list(tmp_path.iterdir()) == [path]


def policy_parts():
    actor = Deterministic(3, 2, (4,))
    return actor, actor.init(Rng(SEEDS)), Normaliser.identity(2, 3)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("config.json", "there is no run in .*one: it has no config.json; `offairl run NAME"),
        ("curve.csv", "no record of a run: it has no curve.csv"),
    ],
)
def test_a_folder_that_is_no_record_is_refused(record, name, message):
    (record / name).unlink()
    with pytest.raises(FileNotFoundError, match=message):
        read(record)


def test_a_chapter_that_is_run_from_another_folder_is_told_where_to_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileNotFoundError, match=f"{tmp_path}/records.* run in the folder `book`"):
        read(Path("records/maze-imitation-demo"))


def test_a_configuration_of_another_version_is_refused(record):
    path = record / "config.json"
    content = read_json(path)
    write_json(path, {**content, "config": {**content["config"], "momentum": 0.9}})
    with pytest.raises(ValueError, match=r"config.json does not describe a run: .*momentum"):
        read(record)
    write_json(path, {**content, "format": 4})
    with pytest.raises(ValueError, match=r"config.json has format 4, and .* reads format 3"):
        read(record)
    # The first format had no number.
    write_json(path, {"seeds": [0], **content["config"]})
    with pytest.raises(ValueError, match=r"config.json has format 1, and .* reads format 3"):
        read(record)
    path.write_text("{")
    with pytest.raises(ValueError, match=r"config.json is damaged: Expecting"):
        read(record)


def test_a_curve_with_other_columns_is_refused(record):
    path = record / "curve.csv"
    path.write_text(path.read_text().replace("mean_return", "reward", 1))
    with pytest.raises(
        ValueError, match=r"curve.csv is damaged: it has columns .*'reward'.*expected"
    ):
        read(record)


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
        ValueError, match=rf"params is .* \(2, 25\); expected .* \(2, {actor.net.num_params}\)"
    ):
        Policy.load(tmp_path / "x.safetensors")


def test_a_run_becomes_a_data_frame(record):
    pytest.importorskip("pandas", reason="pandas is not installed: pip install -e '.[frames]'")
    run = read(record)
    frame = run.to_frame()
    assert list(frame.columns[:5]) == ["run", "task", "seed", "step", "episodes"]
    assert {*frame["run"]} == {record.name}
    assert {*frame["task"]} == {run.config.env_id}
    assert len(frame) == len(run.rows)
    for (_, line), row in zip(frame.iterrows(), run.rows, strict=True):
        numbers = {**row._asdict(), **row.metrics}
        del numbers["returns"], numbers["metrics"]
        found = line.drop(["run", "task"]).to_dict()
        assert found == pytest.approx(numbers, nan_ok=True)
    assert replace(run, rows=[]).to_frame().empty


def test_polars_takes_the_frame(record):
    pytest.importorskip("pandas", reason="pandas is not installed: pip install -e '.[frames]'")
    polars = pytest.importorskip("polars", reason="Polars is not installed: pip install polars")
    run = read(record)
    frame = polars.DataFrame(run.to_frame().to_dict("list"))
    assert frame["mean_return"].to_list() == [row.mean_return for row in run.rows]
    assert {*frame["run"]} == {record.name}


def test_a_missing_pandas_is_told_with_the_remedy(record, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match="pip install pandas"):
        read(record).to_frame()
