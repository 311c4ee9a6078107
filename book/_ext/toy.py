"""An interactive figure in a Markdown page: `{toy} NAME`."""

import sys
from pathlib import Path

from docutils import nodes
from sphinx.util.docutils import SphinxDirective

BOOK = Path(__file__).resolve().parents[1]


class Toy(SphinxDirective):
    """What `figures.toys.show` displays in a notebook."""

    required_arguments = 1

    def run(self):
        """Return the toy's HTML; the page is read again if that changes."""
        from figures import toys

        for path in toys.FOLDER.iterdir():
            self.env.note_dependency(str(path))
        try:
            page = toys.page(self.arguments[0])
        except ValueError as error:
            raise self.error(str(error)) from None
        return [nodes.raw("", page, format="html")]


def setup(app):
    """Register with Sphinx."""
    sys.path.append(str(BOOK))
    app.add_directive("toy", Toy)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
