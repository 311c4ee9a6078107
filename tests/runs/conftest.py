"""Runs of tests are not drawn, which would take as long as they do; `test_pictures.py` draws."""

import pytest

from offairl_lite.runs import pictures


@pytest.fixture(autouse=True)
def drawn(monkeypatch):
    """The real function, and in its place one that does nothing."""
    draw = pictures.draw
    monkeypatch.setattr(pictures, "draw", lambda folder: None)
    return draw
