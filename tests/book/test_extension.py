"""What the book asks of Sphinx: figures on dark pages, and numbers that keep their unit."""

import importlib.util
from pathlib import Path
from types import SimpleNamespace

from docutils import nodes

PATH = Path(__file__).parents[2] / "book/_ext/book.py"
spec = importlib.util.spec_from_file_location("book_extension", PATH)
extension = importlib.util.module_from_spec(spec)
spec.loader.exec_module(extension)


def test_figures_get_a_dark_form_once(tmp_path):
    images = tmp_path / "_images"
    images.mkdir()
    head = '<?xml version="1.0"?>\n<svg width="9pt">'
    (images / "curve.svg").write_text(f"{head}<path/></svg>")
    (images / "map.svg").write_text(f"{head}<image/></svg>")
    app = SimpleNamespace(outdir=tmp_path)
    for _ in range(2):
        extension.draw_for_dark_pages(app, None)
    curve, maze = ((images / f"{name}.svg").read_text() for name in ("curve", "map"))
    assert curve.startswith(f"{head}<style>")
    assert curve.count("<style>") == maze.count("<style>") == 1
    turned = "svg { filter: invert"
    assert turned in curve
    assert turned not in maze
    assert "image { filter: brightness" in maze


def test_a_number_keeps_its_percent_sign_but_code_stays_as_it_is():
    words = nodes.paragraph("", "from 7 % to 9 %, ", nodes.literal("", "7 % 3"))
    code = nodes.literal_block("", "7 % 3")
    extension.keep_percentages_together(None, nodes.section("", words, code))
    assert words.astext() == "from 7\u00a0% to 9\u00a0%, 7 % 3"
    assert code.astext() == "7 % 3"
