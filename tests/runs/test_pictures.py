"""The picture in a run's folder: there at every evaluation, small, and never in the way."""

import logging
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
from matplotlib.figure import Figure
from PIL import Image
from run_folders import create

from offairl_lite.core.results import Row
from offairl_lite.runs import pictures, records
from offairl_lite.runs.folders import work

HOME = Path(__file__).parents[2] / "book/records"


@pytest.fixture
def panels(monkeypatch):
    """The titles and the lines' data of each picture."""
    seen, mosaic = [], Figure.subplot_mosaic

    def keep(self, *args, **kwargs):
        seen.append(places := mosaic(self, *args, **kwargs))
        return places

    monkeypatch.setattr(Figure, "subplot_mosaic", keep)
    return seen


def copy(name, folder):
    folder.mkdir()
    for file in ("config.json", "curve.csv", "run.json"):
        (folder / file).write_bytes((HOME / name / file).read_bytes())
    return records.read(folder)


def test_it_shows_what_the_recipe_says_to_look_at(tmp_path, panels, drawn):
    run = copy("what-decides-demo/Hopper-released-fixed-short", folder := tmp_path / "run")
    drawn(folder)
    (places,) = panels
    heads = [title.split(",")[0].split(":")[0] for title in places]
    assert heads == [
        "return",
        "logit gap",
        "entropy of the verdict",
        "steps of an episode in training",
    ]
    top, gap, entropy, length = ([x.get_ydata() for x in axes.lines] for axes in places.values())
    assert [list(line) for line in top] == run.returns.tolist()
    for i, seed in enumerate(run.seeds):
        rows = [row for row in run.rows if row.seed == seed]
        metrics = [row.metrics for row in rows]
        assert list(gap[i]) == [m["expert_logit"] - m["policy_logit"] for m in metrics]
        assert list(entropy[i]) == [m["entropy"] for m in metrics]
        assert length[i][0] == rows[0].step / rows[0].episodes
        assert 0 < length[i].min() < length[i].max() <= 1000
    path = folder / "curve.png"
    assert path.stat().st_size < 60_000
    with Image.open(path) as picture:
        assert picture.size == (720, 696)
    assert not plt.get_fignums()
    assert not (folder / "curve.png.part").exists()


def test_a_frozen_reward_shows_the_return_by_it(tmp_path, panels, drawn):
    run = copy("decides-transfer-demo/velocity/scratch", folder := tmp_path / "run")
    drawn(folder)
    (places,) = panels
    assert list(places)[:2] == [pictures.RETURN, pictures.LEARNED]
    learned = [line.get_ydata() for line in places[pictures.LEARNED].lines]
    for seed, line in zip(run.seeds, learned, strict=True):
        assert list(line) == [row.learned_return for row in run.rows if row.seed == seed]


@pytest.mark.parametrize("seeds", [10, 11])
def test_many_seeds_without_a_reward_of_the_task(seeds, tmp_path, panels, drawn):
    copy("maze-expert-left-demo", folder := tmp_path / "run")
    spec = records.RunSpec.read(folder)
    vars(spec)["seeds"] = tuple(range(seeds))
    spec.write(folder)
    rows = [
        Row(seed, step, episodes, 0.0, (0.0,), float("nan"), {})
        for step, episodes in ((4_000, 40), (8_000, 40), (12_000, 60))
        for seed in range(seeds)
    ]
    (folder / "curve.csv").write_text(records.HEADER + records.lines(rows))
    about = records.read_json(folder / "run.json")
    records.write_json(folder / "run.json", about | {"curve.csv": None, "diverged": {"3": "why"}})
    drawn(folder)
    (places,) = panels
    ((title, axes),) = places.items()
    assert title.startswith("steps of an episode")
    assert len(axes.lines) == seeds
    assert axes.lines[0].get_ydata() == pytest.approx([100, float("nan"), 200], nan_ok=True)
    assert bool(axes.figure.legends) == (seeds <= 10)
    assert axes.figure.get_suptitle().endswith("step 12,000 of 40,000; diverged: 3")


def test_where_there_is_nothing_to_see_there_is_no_picture(tmp_path, drawn):
    copy("maze-expert-left-demo", folder := tmp_path / "run")
    (folder / "curve.csv").write_text(records.HEADER)
    about = records.read_json(folder / "run.json")
    records.write_json(folder / "run.json", about | {"curve.csv": None})
    drawn(folder)
    assert not (folder / "curve.png").exists()


def test_a_run_draws_each_evaluation_and_goes_on_where_that_fails(
    tiny, tmp_path, drawn, monkeypatch, caplog
):
    seen = []

    def draw(folder):
        seen.append(records.read(folder).steps.tolist())
        drawn(folder)
        if len(seen) == 2:
            raise RuntimeError("no ink")

    monkeypatch.setattr(pictures, "draw", draw)
    create(tmp_path / "run", tiny.change(reward="environment"), (0, 1))
    with caplog.at_level(logging.WARNING):
        work(tmp_path / "run", progress=False)
    assert seen == [[100], [100, 200]]
    assert "curve.png could not be drawn: RuntimeError('no ink')" in caplog.text
    assert (tmp_path / "run/curve.png").is_file()
    assert records.read_state(tmp_path / "run")["state"] == "finished"
