"""What the pages say, as named statements that a page checks when it runs.

The module with a page's name has a function for each statement of the page.
Its docstring is the sentence that it stands for, its parameters are names
that the page's cells have made:

    @live
    def all_leave(returns):
        '''All five agents leave the trap.'''
        assert (returns[:, -1] > -15).all()

The page's last cell is `hold("05_off_policy_airl", globals())`.
"""

import ast
import importlib
import inspect
import os
import textwrap
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from IPython.display import Markdown, display

KINDS = {
    "exact": "exact mathematics",
    "recorded": "read from recorded runs",
    "live": "computed here",
}


class Outcome(NamedTuple):
    """What became of a statement; `evidence` is empty if it holds.

    A statement about demo scale is not `checked` at full scale.
    """

    name: str
    kind: str
    sentence: str
    evidence: str
    checked: bool = True


class OtherScaleError(Exception):
    """A statement says nothing of the scale at which its page has run."""


def exact(function: Callable) -> Callable:
    """Mark a statement of mathematics: it holds to the digit."""
    return _statement(function, "exact")


def recorded(function: Callable) -> Callable:
    """Mark a statement about records: it holds to the digit."""
    return _statement(function, "recorded")


def live(function: Callable) -> Callable:
    """Mark a statement about what was trained or played here and now.

    Other processors round differently, so it says only what holds on all
    of them, with a margin: `make portable` measures it.
    """
    return _statement(function, "live")


def demo_scale_only(size: str) -> None:
    """Leave a statement that says something of demo scale alone.

    Raises:
        OtherScaleError: the page has run at another scale.
    """
    if size != "demo":
        raise OtherScaleError


def _statement(function: Callable, kind: str) -> Callable:
    function.kind = kind  # type: ignore[attr-defined]
    return function


def statements(page: str) -> list[Callable]:
    """Return the statements of a page, in order."""
    module = importlib.import_module(f"checks.{page}")
    return [part for part in vars(module).values() if hasattr(part, "kind")]


def check(page: str, results: Mapping[str, Any]) -> list[Outcome]:
    """Return what became of each statement of a page."""
    return [_outcome(each, results) for each in statements(page)]


def hold(page: str, results: Mapping[str, Any]) -> None:
    """Check the statements of a page and print how many hold.

    Raises:
        AssertionError: some do not hold, and OFFAIRL_STRICT is 1, as it is
            for `make test`.
    """
    outcomes = check(page, results)
    # `make book` and `make portable` read the metadata.
    text = Markdown(report(page, outcomes))
    display(
        text, metadata={"checks": [each._asdict() for each in outcomes]}
    )
    failed = [each for each in outcomes if each.evidence]
    if failed and os.environ.get("OFFAIRL_STRICT") == "1":
        raise AssertionError("\n".join(map(_line, failed)))


def report(page: str, outcomes: list[Outcome]) -> str:
    """Return what a reader is told, as Markdown."""
    checked = [each for each in outcomes if each.checked]
    counts = {
        words: sum(each.kind == kind for each in checked)
        for kind, words in KINDS.items()
    }
    kinds = ", ".join(f"{n} {words}" for words, n in counts.items() if n)
    about = f"({kinds}; `book/checks/{page}.py`)"
    left = len(outcomes) - len(checked)
    rest = (
        f" {left} more are about demo scale: not checked." if left else ""
    )
    failed = [each for each in outcomes if each.evidence]
    if not failed:
        count = f"All {len(checked)} checked statements"
        return f"{count} of this page hold {about}.{rest}"
    first = (
        f"**{len(failed)} of {len(checked)} statements of this page do "
        f"not hold on this machine** {about}.{rest}"
    )
    return "\n".join([first, "", *(f"- {_line(each)}" for each in failed)])


def _line(outcome: Outcome) -> str:
    sentence, evidence = outcome.sentence, outcome.evidence
    return f"{sentence} *({outcome.name}, {outcome.kind})* `{evidence}`"


def _outcome(statement: Callable, results: Mapping[str, Any]) -> Outcome:
    evidence, checked = "", True
    try:
        needed = inspect.signature(statement).parameters
        statement(**{name: results[name] for name in needed})
    except OtherScaleError:
        checked = False
    except Exception as error:  # A page is shown whatever happens.
        evidence = _evidence(statement, error)
    sentence = " ".join(inspect.getdoc(statement).split())
    return Outcome(
        statement.__name__, statement.kind, sentence, evidence, checked
    )


def _evidence(statement: Callable, error: Exception) -> str:
    """Return what is wrong: of an `assert`, the values of both sides."""
    message = " ".join(str(error).split())
    frame = error.__traceback__
    while frame and frame.tb_frame.f_code is not statement.__code__:
        frame = frame.tb_next
    if message or not isinstance(error, AssertionError) or frame is None:
        return f"{type(error).__name__}: {message}"[:300]
    lines, first = inspect.getsourcelines(statement)
    tree = ast.parse(textwrap.dedent("".join(lines)))
    line = frame.tb_lineno - first + 1
    tests = [
        node.test
        for node in ast.walk(tree)
        if isinstance(node, ast.Assert)
        and node.lineno <= line <= node.end_lineno
    ]
    if len(tests) != 1:  # It is in a function that the statement calls.
        return "AssertionError"
    (test,) = tests
    names = {**frame.tb_frame.f_globals, **frame.tb_frame.f_locals}
    sides = [
        side
        for node in ast.walk(test)
        if isinstance(node, ast.Compare)
        for side in (node.left, *node.comparators)
        if not isinstance(side, ast.Constant | ast.UnaryOp)
    ]
    values = [f"{ast.unparse(s)} is {_value(s, names)}" for s in sides]
    return "; ".join([f"not {ast.unparse(test)}", *values])


def _value(side: ast.expr, names: dict[str, Any]) -> str:
    try:
        value = eval(compile(ast.Expression(side), "", "eval"), names)
    except Exception as error:  # Such as the variable of a comprehension.
        return type(error).__name__
    if isinstance(value, float | np.floating):
        return f"{value:.6g}"
    with np.printoptions(precision=5, threshold=12):
        return " ".join(str(value).split())[:200]
