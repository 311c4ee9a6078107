"""What the chapters draw with: tables, diagrams and films in one style."""

from collections.abc import Callable, Iterable, Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import HTML
from jaxtyping import UInt8
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import plots


def outline(width: float) -> list[patheffects.AbstractPathEffect]:
    """Return what makes a line of this width visible on any map."""
    return [
        patheffects.Stroke(linewidth=width + 2.4, foreground="white"),
        patheffects.Stroke(linewidth=width + 0.6, foreground=plots.INK),
        patheffects.Normal(),
    ]


EDGE = outline(2.5)
"""A line with it, 2.5 points wide, can be seen on any map."""


def bare(axes: Axes | Sequence[Axes]) -> None:
    """Take away what a map does not need: ticks, labels and frame."""
    for ax in np.ravel(axes):
        ax.set(xlabel="", ylabel="", xticks=[], yticks=[])
        for spine in ax.spines.values():
            spine.set_visible(False)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> HTML:
    """Return a table: names of rows first, then columns of numbers.

    A row of one cell is the heading of the rows below it.
    """

    def line(cells: Sequence[str], tag: str) -> str:
        first, *rest = cells
        if not rest:
            group = (
                f'<th colspan="{len(head)}" style="padding-top: 1.2rem">'
            )
            return f"<tr>{group}{first}</th></tr>"
        right = f'<{tag} style="text-align: right">'
        numbers = "".join(f"{right}{cell}</{tag}>" for cell in rest)
        numbers = numbers.replace(" %", "&nbsp;%")  # in one line
        return f"<tr><{tag}>{first}</{tag}>{numbers}</tr>"

    body = line(head, "th") + "".join(line(row, "td") for row in rows)
    return HTML(
        '<div style="overflow-x: auto">'
        f'<table class="table">{body}</table></div>'
    )


def diagram(
    size: tuple[float, float],
    boxes: Mapping[str, tuple],
    arrows: Iterable[tuple],
) -> tuple[Figure, Axes]:
    """Draw boxes with text and labelled arrows between them.

    Args:
        size: width and height in inches; they are the coordinates as well.
        boxes: for each name x, y (of the centre), text and, if not grey, a
            colour. Mathematics is written as in `r"$r_\\psi(s)$"`.
        arrows: tuples (from, to), (from, to, label) or (from, to, label,
            bend), with names of boxes; `bend` is 0 for a straight line.
    """
    with plots.style():
        fig, ax = plt.subplots(figsize=size)
        ax.set(xlim=(0, size[0]), ylim=(0, size[1]), aspect="equal")
        ax.axis("off")
        patches = {}
        for name, (x, y, text, *color) in boxes.items():
            edge = color[0] if color else plots.GREY
            frame = {"boxstyle": "round,pad=0.5", "fc": "white", "lw": 1.8}
            patches[name] = ax.text(
                x,
                y,
                text,
                ha="center",
                va="center",
                bbox={**frame, "ec": edge},
            )
        fig.canvas.draw()  # the frames get their sizes
        for start, end, *more in arrows:
            label, bend, *_ = [*more, *("", 0)[len(more) :]]
            _arrow(ax, patches[start], patches[end], label, bend)
    return fig, ax


def _arrow(ax: Axes, start, end, label: str, bend: float):
    # From frame to frame, with the label beside the middle.
    a, b = (np.array(text.get_position()) for text in (start, end))
    ax.annotate(
        "",
        b,
        a,
        arrowprops={
            "arrowstyle": "-|>",
            "color": "#444444",
            "lw": 1.6,
            "shrinkA": 2,
            "shrinkB": 2,
            "patchA": start.get_bbox_patch(),
            "patchB": end.get_bbox_patch(),
            "connectionstyle": f"arc3,rad={bend}",
        },
    )
    side = np.array([b[1] - a[1], a[0] - b[0]])
    middle = (a + b) / 2 + side * bend / 2
    paper = {"fc": "white", "ec": "none", "pad": 1}
    ax.text(*middle, label, ha="center", va="center", bbox=paper)


def film(
    fig: Figure, draw: Callable[[int], None], num_frames: int
) -> UInt8[np.ndarray, "T H W 3"]:
    """Return what `fig` shows after `draw(0)`, `draw(1)`, and so on.

    `draw` changes artists that are in the figure already. Show the result
    with `films.show(frames, caption)`. Width and height of the figure must
    be even numbers of pixels: 6.4 by 3.2 inches at `fig.dpi = 100` are.
    """
    pictures = []
    for i in range(num_frames):
        draw(i)
        if i == 0:  # The layout settles, and stays for all pictures.
            for _ in range(5):
                fig.canvas.draw()
            fig.set_layout_engine("none")
        fig.canvas.draw()
        pictures.append(
            np.asarray(fig.canvas.buffer_rgba())[..., :3].copy()
        )
    plt.close(fig)
    return np.stack(pictures)


def percent(value: float, low: float = -26.5, high: float = -6.5) -> str:
    """Return a return in percent, from `low`, 0 %, to `high`, 100 %.

    As they come, these are the trap and the demonstrations of the maze.
    """
    return f"{number(100 * (value - low) / (high - low), 0)}\u00a0%"


def number(x: float, digits: int = 1) -> str:
    """Return a number as tables show it, with a true minus sign."""
    return f"{x:z.{digits}f}".replace("-", "−")
