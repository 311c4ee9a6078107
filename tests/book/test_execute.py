"""A page that does not go well here is marked, and the book is rendered all the same."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

from execute import main, report, run

ROOT = Path(__file__).parents[2]
CHECKS = '''
from checks import live

@live
def learns(number):
    """The agent learns."""
    assert number > 3
'''


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A copy of the book, with one page's checks, in which pages are run from `tmp_path`."""
    stage = tmp_path / "stage"
    (stage / "book").mkdir(parents=True)
    (tmp_path / "book").mkdir()
    shutil.copytree(ROOT / "book/checks", stage / "book/checks")
    (stage / "book/checks/page.py").write_text(CHECKS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("OFFAIRL_STRICT", raising=False)
    return stage


def write(source, name="page"):
    cells = [
        new_markdown_cell("# A page\n\nIts text."),
        new_code_cell(source),
        new_markdown_cell("The end."),
        new_code_cell('from checks import hold\nhold("page", globals())'),
    ]
    page = Path(f"book/{name}.ipynb")
    nbformat.write(new_notebook(cells=cells), page)
    return page


def test_a_page_that_goes_well_has_no_mark(folder):
    assert run(write("number = 4"), folder)
    cells = nbformat.read(folder / "book/page.ipynb", as_version=4).cells
    assert cells[0].source == "# A page\n\nIts text."
    assert "All 1 checked statements" in cells[-1].outputs[0].data["text/markdown"]
    assert report(folder) == ""


@pytest.mark.parametrize(
    ("source", "all_ran", "says"),
    [
        ("number = 2", True, "1 of 1 statements do not hold"),
        ("number = 1 / 0", False, "stopped at an error, ZeroDivisionError: division by zero"),
        ("import os; os._exit(1)", False, "stopped at an error, DeadKernelError: Kernel died"),
    ],
)
def test_a_page_that_does_not_is_marked_and_listed(folder, source, all_ran, says, capsys):
    assert run(write(source), folder) is all_ran
    cells = nbformat.read(folder / "book/page.ipynb", as_version=4).cells
    assert cells[0].source.startswith("# A page\n\n:::{warning}\n")
    assert "Its text." in cells[0].source
    assert cells[2].source == "The end."
    assert f"book/page: {says}" in report(folder)
    assert main(["report", str(folder)]) == 0
    assert says in capsys.readouterr().out


def test_a_kernel_that_dies_before_it_counts_a_cell_has_not_failed_to_run(folder):
    run(write("import os; os._exit(1)"), folder)
    page = folder / "book/page.ipynb"
    notebook = nbformat.read(page, as_version=4)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.execution_count = None
    nbformat.write(notebook, page)
    assert "book/page: stopped at an error, DeadKernelError" in report(folder)


def test_several_pages_run_side_by_side_each_in_a_kernel_of_its_own(folder):
    draws = "import matplotlib.pyplot as plt; plt.plot([1, 2]); plt.show(); number = 4"
    alone = "import sys; number = 4; assert 'checks' not in sys.modules"
    quits = "import os, signal; os.kill(0, signal.SIGKILL)"  # with its group, and no other
    pages = [write(draws, "draws"), write(alone, "alone"), write(quits, "quits"), write(draws)]
    script = [sys.executable, ROOT / "book/execute.py", "run", folder, *pages, "--jobs", "2"]
    done = subprocess.run(script, capture_output=True, text=True, timeout=300)
    assert done.returncode == 1
    assert {*re.findall(r"Running (\S+)", done.stdout)} == {*map(str, pages)}
    ended = {path.name for path in (folder / "book").glob("*.run")}
    assert ended == {"draws.ipynb.run", "alone.ipynb.run", "page.ipynb.run"}
    assert "book/quits: stopped at an error, DeadKernelError" in report(folder)
    shown = nbformat.read(folder / "book/draws.ipynb", as_version=4).cells[1].outputs[0]
    assert "image/png" in shown.data
    # The next time it fails: it is to be run again.
    subprocess.run([*script[:4], write(quits, "draws")], capture_output=True, timeout=300)
    assert not (folder / "book/draws.ipynb.run").exists()


def test_a_marked_page_is_rendered_with_its_mark(folder):
    run(write("print('before')\nnumber = 1 / 0"), folder)
    (folder / "_config.yml").write_text('execute: {execute_notebooks: "off"}\n')
    (folder / "_toc.yml").write_text("format: jb-book\nroot: book/page\n")
    command = shutil.which("jupyter-book", path=Path(sys.executable).parent)
    subprocess.run([command, "build", "-q", folder], check=True, capture_output=True)
    page = (folder / "_build/html/book/page.html").read_text()
    assert "stopped at an error on this machine" in page
    assert "The end." in page
