"""The form of a chapter: its length, its cells, its captions, and the program that it writes."""

import ast
import builtins
import re
import symtable
from pathlib import Path

import nbformat
import pytest

ROOT = Path(__file__).parents[2]
CHAPTERS = sorted((ROOT / "book").glob("[0-9]*.ipynb"))
NOTES = sorted((ROOT / "book/notes").glob("*.ipynb"))
PLAIN = (ROOT / "offairl_lite/plain.py").read_text("utf-8")
FOLDED = {"hide-input", "remove-input", "hide-cell", "remove-cell"}
SOLUTION = re.compile(r"^(:::+|```+)\{solution\}.*?^\1\s*$", re.DOTALL | re.MULTILINE)
INSIDE = re.compile(r"\{solution-start\}")


def cells(path):
    """The cells outside the solutions, each with its visible code, or None."""
    inside = False
    for cell in nbformat.read(path, as_version=4).cells:
        inside = inside or bool(INSIDE.search(cell.source))
        if not inside:
            folded = FOLDED & set(cell.metadata.get("tags", []))
            visible = cell.cell_type == "code" and not folded
            yield cell, cell.source if visible else None
        inside = inside and "{solution-end}" not in cell.source


def definitions(source):
    """The text of every function and class at the top of a program, with its decorators."""
    lines = source.splitlines()
    for node in ast.parse(re.sub(r"(?m)^[%!].*$", "", source)).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            first = min([node.lineno, *(d.lineno for d in node.decorator_list)])
            yield node.name, "\n".join(lines[first - 1 : node.end_lineno])


WRITTEN = dict(definitions(PLAIN))


def chapter_of(name):
    """The chapter whose comment is the last above a definition in `plain.py`."""
    above = PLAIN[: PLAIN.index(WRITTEN[name])]
    return int(re.findall(r"^# Chapter (\d)", above, re.MULTILINE)[-1])


def test_definitions_are_found_with_their_decorators():
    source = "%config x\n@d\ndef f(x):\n    return x\n\n\nclass A:\n    y = 1\n"
    assert dict(definitions(source)) == {
        "f": "@d\ndef f(x):\n    return x",
        "A": "class A:\n    y = 1",
    }


@pytest.mark.parametrize("name", WRITTEN)
def test_the_plain_program_is_written_by_the_chapters(name):
    """Each function and class is defined in a visible cell of its chapter, in the same words."""
    (path,) = (ROOT / "book").glob(f"{chapter_of(name):02}_*.ipynb")
    found = [
        text
        for _, source in cells(path)
        if source
        for other, text in definitions(source)
        if other == name
    ]
    assert found == [WRITTEN[name]]


def names(source):
    """The names that a cell makes, and those that it uses, in its functions as well."""
    top = symtable.symtable(re.sub(r"(?m)^[%!].*$", "", source), "cell", "exec")
    made = {
        symbol.get_name()
        for symbol in top.get_symbols()
        if symbol.is_assigned() or symbol.is_imported() or symbol.is_namespace()
    }
    used, scopes = set(), [top]
    for scope in scopes:
        scopes += scope.get_children()
        used |= {
            symbol.get_name()
            for symbol in scope.get_symbols()
            if symbol.is_referenced() and (scope is top or symbol.is_global())
        }
    return made, used


def test_names_are_found_in_functions_too():
    made, used = names(
        "%config x\nimport a.b\nc = d\n\n\ndef f(g, h=i):\n    j = k(g)\n    return j\n"
    )
    assert made == {"a", "c", "f"}
    assert used == {"d", "i", "k"}


@pytest.mark.parametrize("path", CHAPTERS, ids=lambda path: path.stem)
def test_a_reader_sees_where_every_name_comes_from(path):
    """No cell that is shown, folded or not, uses a name that only a removed cell makes."""
    known, unknown = set(dir(builtins)), {}
    for number, cell in enumerate(nbformat.read(path, as_version=4).cells):
        removed = (FOLDED - {"hide-input"}) & set(cell.metadata.get("tags", []))
        if cell.cell_type == "code" and not removed:
            made, used = names(cell.source)
            known |= made
            if used - known:
                unknown[number] = sorted(used - known)
    assert unknown == {}


@pytest.mark.parametrize("path", CHAPTERS, ids=lambda path: path.stem)
def test_a_chapter_can_be_read_in_half_an_hour(path):
    """At most 2,500 words, with formulas and tables, 220 lines of visible code, 20 lines a cell.

    Solutions do not count, nor what a reader is to fill in.
    """
    words = lines = 0
    for cell, source in cells(path):
        if "exercise" in cell.metadata.get("tags", []):
            continue
        if cell.cell_type == "markdown":
            words += len(SOLUTION.sub("", cell.source).split())
        elif source is not None:
            count = len(source.splitlines())
            lines += count
            assert count <= 20, cell.id
    assert words <= 2500
    assert lines <= 220


@pytest.mark.parametrize("path", CHAPTERS, ids=lambda path: path.stem)
def test_a_chapter_begins_with_a_sentence_and_hides_little(path):
    """In Jupyter, where nothing is hidden, a chapter is the same page.

    Its first cell is prose, and no folded or removed cell has more than ten
    lines: pictures and tables are drawn in `book/figures/`.
    """
    chapter = nbformat.read(path, as_version=4).cells
    assert chapter[0].cell_type == "markdown"
    hidden = [c for c in chapter if FOLDED & set(c.metadata.get("tags", []))]
    assert hidden
    assert [c.id for c in hidden if len(c.source.splitlines()) > 10] == []


@pytest.mark.parametrize("path", CHAPTERS + NOTES, ids=lambda path: path.stem)
def test_a_cell_with_a_toy_only_shows_it(path):
    """`portable.py` takes no notice of such cells."""
    for cell in nbformat.read(path, as_version=4).cells:
        if "toy" in cell.metadata.get("tags", []):
            assert re.fullmatch(r"from figures import toys\n\ntoys\.show\(\"\w+\"\)", cell.source)
            assert "remove-input" in cell.metadata["tags"]


@pytest.mark.parametrize("path", CHAPTERS[:10], ids=lambda path: path.stem)
def test_a_reader_predicts_before_scrolling(path):
    """A short question stands before a figure or an output, with its answer folded below it."""
    text = "\n".join(cell.source for cell, _ in cells(path) if cell.cell_type == "markdown")
    asked = re.findall(
        r":::\{admonition\} Predict before you scroll: (.+\?)\n:class: dropdown.*\n\n(.+)\n:::",
        text,
    )
    assert asked
    for question, answer in asked:
        assert len(question.split()) + len(answer.split()) <= 45


@pytest.mark.parametrize("path", CHAPTERS, ids=lambda path: path.stem)
def test_a_chapter_says_where_it_breaks_in_few_words(path):
    text = "\n".join(cell.source for cell, _ in cells(path) if cell.cell_type == "markdown")
    sections = re.split(r"(?m)^## ", text)[1:]
    titles = [section.partition("\n")[0] for section in sections]
    assert titles[-1] == "Summary"
    (breaks,) = (section for section in sections if section.startswith("Where it breaks"))
    assert len(breaks.split()) <= 320


@pytest.mark.parametrize("path", CHAPTERS + NOTES, ids=lambda path: path.stem)
def test_a_caption_begins_with_its_message(path):
    for cell, _ in cells(path):
        figure = cell.metadata.get("mystnb", {}).get("figure")
        assert not figure or re.match(r"\*\*[^*]+[.?!]\*\*", figure["caption"]), cell.id


@pytest.mark.parametrize("path", CHAPTERS, ids=lambda path: path.stem)
def test_the_first_screen_shows_what_the_chapter_achieves(path):
    """A film or a figure comes before the first section."""
    for cell, _ in cells(path):
        shown = re.search(r"films\.show\(|rollouts\.film\(|plt\.show\(", cell.source)
        if cell.cell_type == "code" and (shown or "figure" in cell.metadata.get("mystnb", {})):
            return
        assert not re.search(r"(?m)^## ", cell.source), "the first section comes before a picture"
