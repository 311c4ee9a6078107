"""How long chapters and notes take, and the page that says so."""

import json
import re
import runpy
from importlib.metadata import version
from pathlib import Path

import pytest
from bs4 import BeautifulSoup
from sphinx_external_toc.parsing import parse_toc_yaml

ROOT = Path(__file__).parents[2]
EXTENSION = runpy.run_path(str(ROOT / "book/_ext/status.py"))
BUDGET = json.loads((ROOT / "book/minutes.json").read_text())
MINUTES = BUDGET["chapters"]
CHAPTERS = [
    Path(page).name
    for page in parse_toc_yaml(ROOT / "_toc.yml")
    if page[5:6].isdigit() and (ROOT / f"{page}.ipynb").exists()
]
NOTES = BUDGET["notes"]
PATHS = {f"book/{name}": minutes for name, minutes in MINUTES.items()}
PATHS |= {f"book/notes/{name}": minutes for name, minutes in NOTES.items()}
WORDS = {"a": 1, "one": 1, "two": 2, "three": 3, "four": 4}


def seconds(path):
    """How long an executed chapter took."""
    start, end = EXTENSION["executed"](path)
    return (end - start).total_seconds()


def test_every_chapter_has_a_budget_of_four_minutes_at_most():
    assert list(MINUTES) == CHAPTERS
    assert all(0 < minutes <= 4 for minutes in MINUTES.values())


def test_every_note_has_a_budget_of_four_minutes_at_most():
    assert sorted(NOTES) == sorted(path.stem for path in (ROOT / "book/notes").glob("*.ipynb"))
    assert all(0 < minutes <= 4 for minutes in NOTES.values())


@pytest.mark.parametrize("page", PATHS)
def test_the_minutes_that_are_promised_are_the_budget(page):
    cells = json.loads((ROOT / f"{page}.ipynb").read_text())["cells"]
    text = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    promised = re.search(r"\*\*It takes\*\*[^.:]*?(\w+) minute", text)
    assert promised, f"{page}: say how long it takes: **It takes** about …"
    assert WORDS[promised[1]] == PATHS[page]


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_the_minutes_of_a_chapter_are_on_the_front_page(chapter):
    front = (ROOT / "book/index.md").read_text()
    assert f"{{doc}}`{chapter}` |" in front
    assert "Each chapter's code runs in one or two minutes on one core." in front
    assert MINUTES[chapter] in (1, 2)


@pytest.mark.parametrize("page", PATHS)
def test_page_keeps_its_budget(book, page):
    """In seconds, or where the machine is slow, as a ratio to work timed before and after it.

    A quarter more of the ratio may be noise. Not all machines that are fast at this work are as
    fast at a chapter. A kernel starts, and imports PyTorch, in no less than a second.
    """
    if book.name != "demo":
        pytest.skip("chapters have no time limit at full scale")
    path = book / f"{page}.ipynb"
    metadata = json.loads(path.read_text("utf-8"))["metadata"]
    assert "calibration" in metadata, "run `make test`, which measures it around each chapter"
    assert metadata["processor_seconds"] > 1
    promised = 60 * PATHS[page]
    slower = metadata["calibration"] / BUDGET["calibration"]
    assert metadata["processor_seconds"] <= max(promised, 1.25 * promised * slower)


def test_an_unexecuted_chapter_has_no_times(tmp_path):
    path = tmp_path / "chapter.ipynb"
    path.write_text(json.dumps({"cells": [{"metadata": {}}]}))
    assert EXTENSION["executed"](path) is None


def test_the_status_page_has_each_page_and_what_it_ran_with(book, html):
    soup = BeautifulSoup((html / "book/status.html").read_text(), "html.parser")
    rows = [[cell.text for cell in row.select("td")] for row in soup.select("tr")]
    linked = {link["href"] for link in soup.select("article td a")}
    for page in PATHS:
        assert f"{page.removeprefix('book/')}.html" in linked
        assert f"{seconds(book / f'{page}.ipynb'):.0f}" in {row[1] for row in rows if row}
    assert ["torch", version("torch")] in rows
