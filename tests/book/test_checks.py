"""Named statements: each page has some, and one that does not hold says so, and by how much."""

import inspect
import sys
from importlib import import_module
from pathlib import Path

import nbformat
import numpy as np
import pytest

import checks
from checks import KINDS, check, hold, statements

ROOT = Path(__file__).parents[2]
PAGES = sorted([*(ROOT / "book").glob("*.ipynb"), *(ROOT / "book/notes").glob("*.ipynb")])
HIDDEN = {"hide-input", "remove-input", "hide-cell", "remove-cell"}


STATEMENTS = '''
from checks import exact, live, recorded

@exact
def adds(left, right):
    """Two and two are four."""
    assert left + right == 4

@live
def learns(returns):
    """The agent
    learns."""
    assert returns[-1] > 10 > returns[0]

@recorded
def grows(rows):
    """All rows grow."""
    assert all(row > 0 for row in rows)
'''


@pytest.fixture
def page(tmp_path, monkeypatch):
    """The checks of a page; pytest does not rewrite their assertions."""
    (tmp_path / "page.py").write_text(STATEMENTS)
    monkeypatch.setattr(checks, "__path__", [*checks.__path__, str(tmp_path)])
    yield
    sys.modules.pop("checks.page", None)


GOOD = {"left": 2, "right": 2, "returns": np.array([1.0, 12.0]), "rows": [1]}


def test_statements_that_hold_are_counted_by_kind(page, capsys):
    assert [outcome.evidence for outcome in check("page", GOOD)] == ["", "", ""]
    hold("page", GOOD)
    assert "Markdown" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "evidence"),
    [
        ({"left": 3}, "not left + right == 4; left + right is 5"),
        (
            {"returns": np.array([1.0, 2.5])},
            "not returns[-1] > 10 > returns[0]; returns[-1] is 2.5; returns[0] is 1",
        ),
        ({"rows": [0]}, "not all((row > 0 for row in rows)); row is NameError"),
        ({"rows": 3}, "TypeError: 'int' object is not iterable"),
    ],
)
def test_a_statement_that_does_not_hold_says_by_how_much(page, change, evidence):
    assert [outcome.evidence for outcome in check("page", GOOD | change) if outcome.evidence] == [
        evidence
    ]


def test_a_statement_whose_result_is_missing_does_not_hold(page):
    without = {name: value for name, value in GOOD.items() if name != "returns"}
    (outcome,) = (outcome for outcome in check("page", without) if outcome.evidence)
    assert outcome[:4] == ("learns", "live", "The agent learns.", "KeyError: 'returns'")


def test_a_statement_about_demo_scale_is_not_counted_at_full_scale(page, tmp_path):
    (tmp_path / "page.py").write_text(
        "from checks import demo_scale_only, exact\n\n"
        "@exact\ndef small(size):\n"
        "    'It is small.'\n    demo_scale_only(size)\n    assert False\n\n"
        "@exact\ndef true():\n    'It is true.'\n"
    )
    (failed, _), (left, _) = (check("page", {"size": size}) for size in ("demo", "full"))
    assert failed.evidence
    assert failed.checked
    assert not left.evidence
    assert not left.checked
    text = checks.report("page", check("page", {"size": "full"}))
    assert text.startswith("All 1 checked statements of this page hold (1 exact mathematics")
    assert text.endswith("1 more are about demo scale: not checked.")


def test_only_the_tests_turn_a_failure_into_an_error(page, monkeypatch):
    monkeypatch.setenv("OFFAIRL_STRICT", "0")
    hold("page", GOOD | {"left": 3})
    monkeypatch.setenv("OFFAIRL_STRICT", "1")
    with pytest.raises(AssertionError, match="Two and two are four"):
        hold("page", GOOD | {"left": 3})


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_a_page_ends_with_its_checks(path):
    code = [c for c in nbformat.read(path, as_version=4).cells if c.cell_type == "code"]
    last = f'hold("{path.stem}", globals())'
    assert code[-1].source.removeprefix("from checks import hold\n\n") == last
    assert code[-1].metadata.tags == ["remove-input"]
    hidden = [cell for cell in code if HIDDEN & set(cell.metadata.get("tags", []))]
    assert [cell.id for cell in hidden if "assert " in cell.source] == []


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_a_statement_is_a_sentence(path):
    assert statements(path.stem)
    for statement in statements(path.stem):
        assert statement.kind in KINDS
        assert statement.__module__ == f"checks.{path.stem}"
        assert inspect.getdoc(statement).rstrip("*").endswith("."), statement.__name__
        assert "assert" in inspect.getsource(statement), statement.__name__


def test_there_are_no_checks_without_a_page():
    modules = {path.stem for path in (ROOT / "book/checks").glob("*.py")} - {"__init__"}
    assert modules == {path.stem for path in PAGES}


@pytest.mark.parametrize(
    "path", sorted((ROOT / "book/rollouts").glob("[!_]*.py")), ids=lambda path: path.stem
)
def test_recorded_rollouts_have_their_record(path):
    assert callable(import_module(f"rollouts.{path.stem}").record)
    assert (ROOT / f"book/records/rollouts/{path.stem}.json").stat().st_size < 300_000
