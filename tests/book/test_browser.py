"""The rendered book in a real browser: mathematics, videos, phones, and no network."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from sphinx_external_toc.parsing import parse_toc_yaml

from offairl_lite.analysis import films

sync_api = pytest.importorskip("playwright.sync_api")

ROOT = Path(__file__).parents[2]
PAGES = list(parse_toc_yaml(ROOT / "_toc.yml"))
BROWSERS = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"]
MAC = Path("/Applications/Google Chrome.app/Contents/MacOS/Google Chrome")
FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
LOCAL = re.compile("(file|data|blob):").match

TYPESET = "window.MathJax && MathJax.startup && MathJax.startup.promise.then(() => null)"
UNTYPESET = """() => [...document.querySelectorAll('.math')]
  .filter(e => !e.querySelector('mjx-container')).map(e => 'not typeset: ' + e.textContent)"""
BAD_MATH = """() => [...document.querySelectorAll('mjx-merror, [data-mjx-error]')]
  .map(e => 'mathematics: ' + (e.dataset.mjxError || e.textContent))"""
BAD_IMAGES = """() => Promise.all([...document.images].map(e => {
    e.loading = 'eager';
    return e.decode().then(() => null, () => 'image: ' + e.src.slice(0, 80));
  })).then(found => found.filter(Boolean))"""
BAD_VIDEOS = """() => Promise.all([...document.querySelectorAll('video')].map(async e => {
    e.muted = true;
    e.loop = true;
    const start = Date.now();
    try {
      await Promise.race([e.play(), new Promise((_, late) => setTimeout(late, 5000))]);
      const from = e.currentTime;
      while (e.currentTime === from && Date.now() - start < 5000)
        await new Promise(wait => setTimeout(wait, 50));
      if (e.currentTime !== from && e.readyState >= 2 && !e.error) return null;
    } catch (error) {}
    return 'video: ' + (e.error ? e.error.message : 'does not play');
  })).then(found => found.filter(Boolean))"""
OVERFLOW = """() => document.documentElement.scrollWidth <= innerWidth ? []
  : ['wider than a phone: ' + document.documentElement.scrollWidth + ' px']"""

# What is cut off on a phone, where nobody can scroll to its end.
CUT = """() => [...document.querySelectorAll('.math svg, pre, table')].filter(e => {
    const end = e.getBoundingClientRect().right;
    const out = [];
    for (let up = e.parentElement; up !== document.body; up = up.parentElement)
      if (end > up.getBoundingClientRect().right + 1) out.push(getComputedStyle(up).overflowX);
    const first = out.find(overflow => overflow !== 'visible');
    return first === 'hidden' || first === 'clip';
  }).map(e => 'cut off: ' + e.textContent.trim().slice(0, 60))"""


def problems(browser, path):
    """All that goes wrong when a reader opens this page, on a desktop and then on a phone."""
    found = []
    page = browser.new_page()
    page.on("console", lambda m: m.type == "error" and found.append(f"console: {m.text}"))
    page.on("pageerror", lambda error: found.append(f"script: {error}"))
    page.on("request", lambda r: LOCAL(r.url) or found.append(f"request: {r.url}"))
    page.goto(path.as_uri())
    page.evaluate(TYPESET)
    for check in (UNTYPESET, BAD_MATH, BAD_IMAGES, BAD_VIDEOS):
        found += page.evaluate(check)
    page.set_viewport_size({"width": 390, "height": 844})
    found += page.evaluate(OVERFLOW) + page.evaluate(CUT)
    page.close()
    return found


@pytest.fixture(scope="module")
def browser():
    executable = next(filter(None, map(shutil.which, [*BROWSERS, MAC])), None)
    if executable is None:
        pytest.skip("no Chromium or Chrome found: `make system` installs one on Debian and Ubuntu")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=FLAGS)
        yield browser
        browser.close()


def test_checks_detect(browser, tmp_path):
    mathjax = (ROOT / "book/_static/mathjax/tex-svg-full.js").as_uri()
    page = tmp_path / "page.html"
    page.write_text(f"""<!doctype html><meta name=viewport content="width=device-width">
      <script>MathJax = {{tex: {{packages: {{'[-]': ['noundefined', 'noerrors']}}}}}}</script>
      <script src="{mathjax}"></script>
      <script src="https://example.invalid/x.js"></script><script>undefined_name</script>
      <p class=math>\\(\\undefinedmacro\\)</p><p class=math>x</p>
      <img src="data:image/png;base64,AAAA"><video src="data:video/mp4;base64,AAAA"></video>
      <div style="width: 800px">wide</div>
      <div style="width: 300px; overflow: hidden"><pre style="width: 400px">cut</pre></div>
      <div style="width: 300px; overflow: auto"><pre style="width: 400px">scrolls</pre></div>""")
    kinds = {problem.split(":")[0] for problem in problems(browser, page)}
    assert kinds == {
        "console",
        "script",
        "request",
        "mathematics",
        "not typeset",
        "image",
        "video",
        "wider than a phone",
        "cut off",
    }

    page.write_text(
        f"""<!doctype html><script src="{mathjax}"></script><p class=math>\\(x^2\\)</p>"""
    )
    assert problems(browser, page) == []


def test_on_paper_a_film_is_its_last_picture(browser, tmp_path):
    pictures = np.zeros((8, 32, 48, 3), np.uint8)
    pictures[-1] = 255
    script = (ROOT / "book/_static/films.js").as_uri()
    style = (ROOT / "book/_static/book.css").as_uri()
    page = browser.new_page()
    (tmp_path / "page.html").write_text(
        f"""<!doctype html><link rel=stylesheet href="{style}"><script src="{script}"></script>
        {films.show(pictures, "The maze.").data}"""
    )
    page.goto((tmp_path / "page.html").as_uri())
    still = page.locator(".film-still")
    still.wait_for(state="attached")
    shown = [page.locator("video").is_visible(), still.is_visible()]
    page.emulate_media(media="print")
    assert [*shown, page.locator("video").is_visible(), still.is_visible()] == [1, 0, 0, 1]
    middle = "e => [...e.getContext('2d').getImageData(24, 16, 1, 1).data.slice(0, 3)]"
    assert min(still.evaluate(middle)) > 200
    page.close()


@pytest.mark.skipif(MAC.exists(), reason="Chrome is at its usual place")
def test_without_a_browser_the_checks_are_skipped_and_say_what_to_install():
    command = [sys.executable, "-m", "pytest", "-rs", "-k", "detect", __file__]
    done = subprocess.run(command, env={"PATH": ""}, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    assert "1 skipped" in done.stdout
    assert "`make system` installs one" in done.stdout


@pytest.mark.parametrize("page", PAGES)
def test_page(browser, html, page):
    assert problems(browser, (html / page).with_suffix(".html").resolve()) == []
