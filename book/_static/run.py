"""Draw the picture of a run as the run itself does, for `recipe_out.md`.

The run is the recipe's on Hopper.

.venv/bin/python book/_static/run.py
"""

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from offairl_lite.runs import pictures, records

BOOK = Path(__file__).parents[1]
RUN = BOOK / "records/what-decides-demo/Hopper-released-fixed-short"

with TemporaryDirectory() as folder:
    copy = Path(folder) / "hopper"
    shutil.copytree(RUN, copy)
    pictures.draw(copy)
    shutil.copy(copy / records.PICTURE, BOOK / "_static/run.png")
