"""The pinned environment, as a reader's machine sees it."""

from importlib.metadata import distributions

from packaging.specifiers import SpecifierSet

OLDEST = "3.11.0"
"""What `requires-python` promises; Debian 12 has 3.11.2."""


def test_every_package_takes_the_oldest_python_that_is_promised():
    wants = {d.name: d.metadata["Requires-Python"] for d in distributions()}
    refused = {n: w for n, w in wants.items() if w and not SpecifierSet(w).contains(OLDEST)}
    assert refused == {}
    assert "offairl-lite" in wants
