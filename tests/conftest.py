"""One run for everything: how to ask for the book's checks, and the order of the whole."""

from pathlib import Path


def pytest_addoption(parser):
    parser.addoption(
        "--book",
        type=Path,
        metavar="DIR",
        help="render the executed chapters in DIR and check the result (`make test` does)",
    )


def pytest_collection_modifyitems(items):
    """Cheap first: unit tests, then the chapters, then the book that is rendered from them."""
    items.sort(
        key=lambda item: (
            2 * ("book" in getattr(item, "fixturenames", ())) or item.path.suffix == ".ipynb"
        )
    )
