"""Film the toy of the front page for the README, in Chromium.

It learns, its agents walk, the wall moves, and they walk again.

.venv/bin/python book/_static/walls.py
"""

import io
import shutil
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

sys.path.append(str(Path(__file__).parents[1]))
from figures import toys

BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
WIDTH, FRAME, STEPS = 440, 80, 9
"""The page's pixels, a frame's milliseconds, the wall's squares."""
STYLE = """
body { margin: 0 }
.toy { margin: 0 }
.toy.toy-live { border-radius: 0; padding-bottom: 0; font-size: 18px }
.toy canvas { outline: none !important }
.toy-pane:nth-child(2), .toy-bar { display: none !important }
"""


def film(view: Page) -> list[Image.Image]:
    """Return the frames."""
    frames, toy = [], view.locator(".toy")

    def shoot(count: int) -> None:
        for _ in range(count):
            view.clock.run_for(FRAME)
            picture = Image.open(io.BytesIO(toy.screenshot()))
            frames.append(picture.convert("RGB"))

    view.evaluate("document.querySelector('.toy button').click()")
    shoot(60)
    view.locator("canvas").first.focus()
    for _ in range(STEPS):
        view.keyboard.press("ArrowRight")
        shoot(1)
    shoot(78)
    return frames


with (
    sync_playwright() as playwright,
    tempfile.TemporaryDirectory() as place,
):
    browser = playwright.chromium.launch(
        executable_path=BROWSER, args=["--no-sandbox", "--disable-gpu"]
    )
    path = Path(place) / "toy.html"
    path.write_text(
        "<!doctype html><meta charset=utf-8><html data-theme=light>"
        f'<body style="width: {WIDTH}px">{toys.page("walls")}'
        f"<style>{STYLE}</style>"
    )
    view = browser.new_page(viewport={"width": WIDTH, "height": 600})
    view.clock.install()
    view.goto(path.as_uri())
    frames = film(view)
    browser.close()
frames = [f.quantize(64, dither=Image.Dither.NONE) for f in frames]
kept = Path(__file__).with_suffix(".gif")
frames[0].save(
    kept, save_all=True, append_images=frames[1:], duration=FRAME, loop=0
)
print(f"{kept.name}: {kept.stat().st_size / 1000:.0f} kB")
