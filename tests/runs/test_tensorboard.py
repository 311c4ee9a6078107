"""Evaluations as TensorBoard reads them back."""

import math
import sys

import pytest
from run_folders import create

from offairl_lite.runs import cli, records
from offairl_lite.runs import tensorboard as logs
from offairl_lite.runs.folders import work


def scalars(folder, seed):
    """What TensorBoard reads: for each tag, the values by step."""
    accumulator = pytest.importorskip(
        "tensorboard.backend.event_processing.event_accumulator"
    ).EventAccumulator(str(folder / f"seed-{seed}"))
    accumulator.Reload()
    tags = accumulator.Tags()["scalars"]
    return {tag: {e.step: e.value for e in accumulator.Scalars(tag)} for tag in tags}


def test_every_evaluation_of_every_seed_is_written(tiny, tmp_path, random_demonstrations):
    folder, events = tmp_path / "run", tmp_path / "events"
    shown = random_demonstrations(tiny.env_id)
    create(folder, tiny, (3, 7), shown)
    work(folder, demonstrations=shown, progress=False)
    rows = records.read(folder).rows
    assert logs.export(folder, events) == len(rows) > 2
    assert {path.name for path in events.iterdir()} == {"seed-3", "seed-7"}
    for row in rows:
        found = {tag: values[row.step] for tag, values in scalars(events, row.seed).items()}
        expected = {"return/true": row.mean_return, "return/learned": row.learned_return}
        expected |= {f"update/{name}": value for name, value in row.metrics.items()}
        assert found == pytest.approx(expected, rel=1e-6)
        assert 0 <= found["update/entropy"] <= math.log(2) + 1e-6


def test_a_record_is_written_once_and_followed_to_its_end(tiny, tmp_path, monkeypatch, capsys):
    config, folder = tiny.change(reward="environment"), tmp_path / "run"
    create(folder, config, (0,))
    looks = []

    def wait(seconds):
        looks.append(seconds)
        work(folder, progress=False)

    monkeypatch.setattr(logs.time, "sleep", wait)
    cli.main(["tensorboard", str(folder), "--follow"])
    assert looks == [logs.POLL_S]
    out = folder / "tensorboard"
    assert f"2 evaluations written; to look at them: tensorboard --logdir {out}" in (
        capsys.readouterr().out
    )
    cli.main(["tensorboard", str(folder)])  # Anew, and not twice.
    found = scalars(out, 0)
    assert list(found["return/true"]) == [100, 200]
    with pytest.raises(SystemExit, match=r"has files already, .*: choose a new folder"):
        cli.main(["tensorboard", str(folder), "--out", str(out)])
    assert "return/learned" not in found  # There is none: it is NaN in the record.


def test_a_missing_tensorboard_is_told_with_the_remedy(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with pytest.raises(ImportError, match="pip install tensorboard"):
        logs.export(tmp_path, tmp_path / "events")


def test_no_run_no_events(tmp_path):
    with pytest.raises(SystemExit, match="there is no run in"):
        cli.main(["tensorboard", str(tmp_path / "nothing")])
    assert not any(tmp_path.iterdir())
