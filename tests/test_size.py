"""The package stays small enough to be read."""

import ast
from pathlib import Path

import pytest

import offairl_lite

ROOT = Path(offairl_lite.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))
IDS = [path.relative_to(ROOT).as_posix() for path in FILES]
MODULE, FUNCTION, CLASS = 382, 80, 250
PACKAGE = 11_406


def lengths(source):
    """Lines of each function and class, by kind and name."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield type(node), node.name, node.end_lineno - node.lineno + 1


def test_lengths_are_counted_from_the_name_to_the_last_line():
    source = "class A:\n    def f(self):\n        return 1\n\n\ndef g(): pass\n"
    assert set(lengths(source)) == {
        (ast.ClassDef, "A", 3),
        (ast.FunctionDef, "f", 2),
        (ast.FunctionDef, "g", 1),
    }


def test_the_package_does_not_grow_again():
    assert sum(len(path.read_text("utf-8").splitlines()) for path in FILES) <= PACKAGE


@pytest.mark.parametrize("path", FILES, ids=IDS)
def test_nothing_is_too_long_to_be_taken_in(path):
    source = path.read_text("utf-8")
    assert len(source.splitlines()) <= MODULE
    limits = {ast.FunctionDef: FUNCTION, ast.ClassDef: CLASS}
    assert [name for kind, name, lines in lengths(source) if lines > limits[kind]] == []
