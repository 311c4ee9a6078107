"""The book's style of figures, and its colours, which everybody can tell (Okabe and Ito 2008)."""

from functools import partial
from typing import Any

import matplotlib.pyplot as plt

BLUE, ORANGE, GREEN, RED, PURPLE = "#0072B2", "#E69F00", "#009E73", "#CC3311", "#AA3399"
GREY = "#7f7f7f"

STYLE: Any = {
    "figure.figsize": (6.4, 3.4),
    "figure.dpi": 110,
    # A white background is legible on a light and on a dark page.
    "figure.facecolor": "white",
    "figure.constrained_layout.use": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.titlesize": "medium",
    "grid.alpha": 0.3,
    "legend.frameon": False,
    "legend.fontsize": "small",
    "lines.linewidth": 1.8,
}

style = partial(plt.rc_context, STYLE)  #: A context whose figures have the book's style.
