"""A chapter in JupyterLab is the page: no raw directive, and it runs."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from test_browser import browser  # noqa: F401

ROOT = Path(__file__).parents[2]
CHAPTER = "01_maxent_irl.ipynb"
CELLS = json.loads((ROOT / "book" / CHAPTER).read_text())["cells"]
WHOLE = {"windowingMode": "none"}  # All cells are there, also those out of sight.
RAW = """() => [...document.querySelectorAll('.jp-MarkdownCell')]
  .map(e => e.innerText).filter(text => /:::|```|\\{(cite|eq|ref|doc|prf)[:}]/.test(text))"""
PROMPTS = (
    "() => [...document.querySelectorAll('.jp-CodeCell .jp-InputPrompt')].map(e => e.innerText)"
)


@pytest.fixture
def lab(tmp_path):
    """The address of a server on a copy of the book's sources."""
    pytest.importorskip(
        "jupyterlab_myst", reason="JupyterLab is not installed: pip install -e '.[book]'"
    )
    sources = subprocess.run(["git", "ls-files", "book"], cwd=ROOT, capture_output=True, text=True)
    for name in sources.stdout.split():
        if name == f"book/{CHAPTER}" or not name.endswith(".ipynb"):
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / f"book/{CHAPTER}").unlink()
    (tmp_path / f"book/{CHAPTER}").write_bytes((ROOT / f"book/{CHAPTER}").read_bytes())
    settings = tmp_path / "settings/@jupyterlab/notebook-extension"
    settings.mkdir(parents=True)
    (settings / "tracker.jupyterlab-settings").write_text(json.dumps(WHOLE))
    env = os.environ | {
        "JUPYTERLAB_SETTINGS_DIR": str(tmp_path / "settings"),
        "JUPYTERLAB_WORKSPACES_DIR": str(tmp_path / "workspaces"),
        "JUPYTER_RUNTIME_DIR": str(tmp_path / "runtime"),
    }
    server = subprocess.Popen(
        [
            *(sys.executable, "-m", "jupyterlab", "--no-browser", "--allow-root"),
            *("--ip=127.0.0.1", "--port=0", "--IdentityProvider.token="),
        ],
        cwd=tmp_path / "book",
        env=env,
        stderr=subprocess.PIPE,
        text=True,
    )
    address = next(filter(None, (re.search(r"http://127\S+?:\d+/lab", x) for x in server.stderr)))
    yield address[0]
    server.terminate()
    server.communicate(timeout=30)


def test_a_chapter_opens_as_the_page_and_runs(browser, lab):  # noqa: F811
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.goto(f"{lab}/tree/{CHAPTER}?reset")
    page.wait_for_selector(".jp-MarkdownCell h1", timeout=120_000)
    count = sum(cell["cell_type"] == "markdown" for cell in CELLS)
    cells = "document.querySelectorAll('.jp-MarkdownCell')"
    page.wait_for_function(f"() => {cells}.length === {count}", timeout=120_000)
    assert page.evaluate(RAW) == []
    page.get_by_role("menuitem", name="Run", exact=True).click()
    page.get_by_role("menuitem", name="Run All Cells", exact=True).click()
    done = f"() => ({PROMPTS})().every(text => /\\[\\d+\\]/.test(text))"
    page.wait_for_function(done, timeout=300_000)
    assert page.locator(".jp-RenderedText[data-mime-type*=stderr]").count() == 0
    assert page.get_by_text(re.compile(r"statements of this page hold")).count() == 1
    page.close()
