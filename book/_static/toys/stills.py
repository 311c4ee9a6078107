"""Draw the stills of the toys, with the toys themselves, in Chromium.

.venv/bin/python book/_static/toys/stills.py [NAME ...]
"""

import io
import shutil
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

sys.path.append(str(Path(__file__).parents[2]))
from figures import toys

BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
WIDTH = 760

with (
    sync_playwright() as playwright,
    tempfile.TemporaryDirectory() as place,
):
    browser = playwright.chromium.launch(
        executable_path=BROWSER, args=["--no-sandbox", "--disable-gpu"]
    )
    for name in sys.argv[1:] or toys.TOYS:
        still = toys.FOLDER / f"{name}.png"
        still.touch()
        path = Path(place) / "toy.html"
        path.write_text(
            "<!doctype html><meta charset=utf-8>"
            f'<html data-theme=light><body style="width: {WIDTH}px">'
            + toys.page(name)
        )
        view = browser.new_page(
            device_scale_factor=2, reduced_motion="reduce"
        )
        view.goto(path.as_uri())
        view.evaluate("toys.all[0].pose?.(), toys.all[0].redraw()")
        view.wait_for_timeout(500)
        picture = Image.open(
            io.BytesIO(view.locator(".toy-stage").screenshot())
        )
        picture.convert("RGB").quantize(200, dither=0).save(
            still, optimize=True
        )
        view.close()
        print(f"{still.name}: {still.stat().st_size / 1000:.0f} kB")
    browser.close()
