"""The rendered book, for the tests that read it."""

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def book(request):
    """The folder of executed chapters; it is there under `make test` only."""
    folder = request.config.getoption("--book")
    if folder is None:
        pytest.skip("needs the executed chapters: run `make test`")
    return folder


@pytest.fixture(scope="session")
def rendering(book):
    strict = os.environ | {"OFFAIRL_STRICT": "1"}  # A warning is an error.
    return subprocess.run(["make", "html"], cwd=ROOT, capture_output=True, text=True, env=strict)


@pytest.fixture(scope="session")
def html(rendering):
    """The folder of rendered pages, even if rendering has complained: its own test says so."""
    return ROOT / "_build/html"
