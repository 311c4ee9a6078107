"""The chapters and notes as they are kept: runnable, stripped of outputs, in one form."""

import re
from pathlib import Path

import nbformat
import pytest
from pybtex.database import parse_file
from sphinx_external_toc.parsing import parse_toc_yaml

from offairl_lite.config.settings import EARLIER

ROOT = Path(__file__).parents[2]
CHAPTERS = sorted((ROOT / "book").glob("*.ipynb"))
NOTES = sorted((ROOT / "book/notes").glob("*.ipynb"))
TEXTS = [ROOT / "README.md", *sorted((ROOT / "book").glob("*.md"))]


def test_the_bibliography_can_be_read():
    """Every entry by itself, and none twice: pybtex refuses both."""
    path = ROOT / "book" / "references.bib"
    assert len(parse_file(path).entries) == path.read_text("utf-8").count("\n@") + 1


def test_every_chapter_and_note_is_in_the_table_of_contents():
    listed = {f"{page}.ipynb" for page in parse_toc_yaml(ROOT / "_toc.yml")}
    assert {path.relative_to(ROOT).as_posix() for path in CHAPTERS + NOTES} <= listed


@pytest.mark.parametrize("path", CHAPTERS + NOTES + TEXTS, ids=lambda path: path.stem)
def test_settings_are_called_what_they_are_called_now(path):
    """Earlier names still work, with a warning, but no reader should meet one."""
    words = re.findall(r"[a-z]+(?:[_-][a-z]+)+", path.read_text("utf-8"))
    assert not {*EARLIER} & {word.replace("-", "_") for word in words}


@pytest.mark.parametrize("path", CHAPTERS + NOTES, ids=lambda path: path.stem)
def test_stripped(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            where = f"cell {cell.id}: run `nbstripout --keep-id {path.relative_to(ROOT)}`"
            assert not cell.outputs, where
            assert cell.execution_count is None, where
            assert "execution" not in cell.metadata, where


@pytest.mark.parametrize("path", CHAPTERS, ids=lambda path: path.stem)
def test_form(path):
    """A title, an exercise, and a solution to each exercise."""
    cells = nbformat.read(path, as_version=4).cells
    text = "\n".join(cell.source for cell in cells if cell.cell_type == "markdown")
    assert re.match(r"# \S", cells[0].source)
    exercises = re.findall(r"\{exercise(?:-start)?\}.*\n:label: (\S+)", text)
    assert exercises
    assert set(exercises) == set(re.findall(r"\{solution(?:-start)?\} (\S+)", text))


@pytest.mark.parametrize("path", NOTES, ids=lambda path: path.stem)
def test_form_of_a_note(path):
    """A title, short visible cells, and captions that begin with the message."""
    cells = nbformat.read(path, as_version=4).cells
    assert re.match(r"# \S", cells[0].source)
    code = [cell for cell in cells if cell.cell_type == "code"]
    for cell in code:
        folded = {"hide-input", "remove-input"} & set(cell.metadata.get("tags", []))
        assert folded or cell.source.count("\n") < 20, cell.id
        figure = cell.metadata.get("mystnb", {}).get("figure")
        assert not figure or re.match(r"\*\*[^*]+\.\*\* ", figure["caption"]), cell.id


@pytest.mark.parametrize("path", CHAPTERS + NOTES, ids=lambda path: path.stem)
def test_a_named_figure_is_all_that_its_cell_displays(path):
    """A progress bar would get the figure's name as well: demonstrations are made elsewhere."""
    for cell in nbformat.read(path, as_version=4).cells:
        if "name" in cell.metadata.get("mystnb", {}).get("figure", {}):
            assert not re.search(r"\b(tqdm|train|complete|load)\(", cell.source), cell.id
