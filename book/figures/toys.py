"""The interactive figures: how a page shows one, and what was drawn in it.

A toy is a short program in `_static/toys/`, in plain JavaScript. All that
it needs is written into the page, so that it works without a network in
the rendered book and in Jupyter.
"""

import base64
import html
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from IPython.display import HTML

from offairl_lite.tabular import MDP, MOVES, Trajectories

FOLDER = Path(__file__).parents[1] / "_static/toys"


class Toy(NamedTuple):
    """What a page says of a toy, and what it needs."""

    needs: list[str]
    """Other programs, which come before its own."""
    lead: str
    """The sentence above it."""
    still: str
    """What its still shows, for those who do not see it."""


TOYS = {
    "walls": Toy(
        ["mazes"],
        "Drag the wall. The blue agent copied the expert's moves; the "
        "yellow one learned what the expert wanted.",
        "A maze with a wall across it. Two agents start at the bottom: one "
        "copied the expert's moves and stands before the wall, the other "
        "plans with the learned reward and goes round it to the star.",
    ),
    "rewards": Toy(
        ["mazes"],
        "Pull the steps past 100, where the orange curve falls: moves "
        "into the old gap turn green. (In maps green is a high reward.) "
        "Then add a shaping: the map becomes noise, and the arrows on "
        "the left stay.",
        "Two mazes coloured by a reward of the move. In the first its "
        "policy goes round the wall; when the wall has moved, into it. "
        "Below, its score falls from near 100 % to 0 after about a hundred "
        "steps of the optimiser; that of a reward of the place does not.",
    ),
    "corridor": Toy(
        [],
        "Guess first: which of the three rewards imitates both "
        "experts? Then play. You can also turn the expert's arrows. "
        "(Moving dots: agents. Bars: their share of time in a room. Half a "
        "room is green if a step to that side pays, red if it costs. An "
        "arrow shows the likelier move; a dot in its place: both are "
        "equally likely.)",
        "Seven rooms and a door on the right. Above, the expert walks out. "
        "Below, its imitator is paid for every step, and stays in front of "
        "the door.",
    ),
    "game": Toy(
        ["mazes"],
        "Guess: which steps settle, and which swing for ever? Play the "
        "game. Then give label 1 to the policy: it flees from the "
        "expert, although it begins next to it. (Left, in violet: where "
        "the policy goes. Right: violet where it goes too seldom and its "
        "reward is too high, orange where it is the other way round.)",
        "A maze with the visits and the arrows of a policy, the same maze "
        "with the error of the reward, and below both errors as they fall "
        "from round to round.",
    ),
    "squash": Toy(
        [],
        "Make the Gaussian wide: the actions gather at the ends, and only "
        "the density with the Jacobian follows them.",
        "Bars of sampled actions between -1 and 1, a green line that "
        "follows them to the ends, and a dashed one that falls to 0 there.",
    ),
    "products": Toy(
        [],
        "Bring the star, the product's mean, to the middle: drag the two "
        "policies, their widths or the gate's weights. What does the sum "
        "do meanwhile?",
        "Two Gaussian policies over two actions, drawn as ellipses, one "
        "narrow and high, one flat and wide. Multiplied, they leave a "
        "round spot where the ellipses cross; added, a cross.",
    ),
    "life": Toy(
        ["mazes"],
        "Drag the point over the map, and see what becomes of the "
        "agent. Then let the end pay the constant too.",
        "An agent between a cliff and a goal, and below it a map over the "
        "discount and a constant. Where the constant is high the best "
        "policy never ends, where it is low it falls, and in between it "
        "walks to the goal.",
    ),
    "drawn_maze": Toy(
        ["mazes", "tables"],
        "Rewards of five recorded seeds, at the paper's size. Drag "
        "the wall or the start: the agent plans again, here on "
        "squares instead of with physics.",
        "The maze after the wall has moved, coloured by a reward learned "
        "before, which is highest at the star. The planned way leads "
        "through the new gap to the star.",
    ),
    "pendulum": Toy(
        ["networks"],
        "Pull at the pendulum, with the same weak motor, and let the "
        "actor take over. Or press on the map: it starts in that state.",
        "A pendulum that stands upright, and a map of its angle and speed, "
        "coloured by the critics' value. Its way leads from hanging still "
        "in growing swings to the dashed line of just enough energy, and "
        "along it to the top.",
    ),
    "loop": Toy(
        [],
        "Play: paid for being improbable, the policy overshoots, more in "
        "each round. Draw another policy, take smaller steps, or change "
        "what is paid: with f alone, α = 1 leads to the expert.",
        "Bars of a policy that has left the expert's bell curve for one "
        "side, a reward that is highest on the other side, and below its "
        "spread, which grows fivefold in each round.",
    ),
    "worlds": Toy(
        ["mazes"],
        "Change the second film: drag its wall, wet its floor, turn its "
        "controls. Then ask for other rewards that fit both films (the "
        "greens of the new maze): do they still lead through the door to "
        "the star, wherever you drag it?",
        "Three mazes: two films of an expert that goes round a wall, the "
        "second on a wet floor, and a new maze, coloured by the reward "
        "learned from both. The way planned on it leads through the door "
        "to the star.",
    ),
}


def page(name: str) -> str:
    """Return the HTML of a toy, with its programs, style and still.

    The still is there without JavaScript, and on paper.

    Raises:
        ValueError: there is no toy of this name.
    """
    if name not in TOYS:
        raise ValueError(
            f"there is no toy {name!r}; choose one of {', '.join(TOYS)}"
        )
    toy = TOYS[name]
    script = "\n".join(
        (FOLDER / f"{part}.js").read_text("utf-8")
        for part in ("toys", *toy.needs, name)
    )
    style = (FOLDER / "toys.css").read_text("utf-8")
    still = base64.b64encode((FOLDER / f"{name}.png").read_bytes()).decode()
    return (
        f"<style>\n{style}</style>\n"
        f'<div class="toy" data-toy="{name}">'
        f'<img class="toy-still" alt="{html.escape(toy.still)}" '
        f'src="data:image/png;base64,{still}"></div>\n'
        f"<script>\n{script}\nwindow.toys.start();\n</script>"
    )


def show(name: str) -> HTML:
    """Display a toy, such as `"walls"`, below what to do with it."""
    content = page(name)
    return HTML(f"<p>{html.escape(TOYS[name].lead)}</p>\n{content}")


def drawn(path: str | Path, length: int = 400) -> Trajectories:
    """Return demonstrations that were drawn in the toy of the front page.

    Each stays at its last square until it has `length` actions, since the
    tabular functions take demonstrations of equal length. With 400, what
    would come later counts nothing, if the discount is 0.97.

    Returns:
        Indices of squares, (N, T + 1), and of actions, (N, T).

    Raises:
        ValueError: a demonstration is longer than `length`.
    """
    demonstrations = json.loads(Path(path).read_text("utf-8"))[
        "demonstrations"
    ]
    longest = max(len(one["actions"]) for one in demonstrations)
    if longest > length:
        raise ValueError(
            f"a demonstration has {longest} actions; choose a length of at "
            f"least that, not {length}"
        )
    states = [one["states"] for one in demonstrations]
    actions = [one["actions"] for one in demonstrations]
    return Trajectories(
        np.array(
            [way + way[-1:] * (length + 1 - len(way)) for way in states]
        ),
        np.array(
            [moves + [0] * (length - len(moves)) for moves in actions]
        ),
    )


def maze(path: str | Path, discount: float = 0.97) -> MDP:
    """Return the maze in which the demonstrations of a file were drawn.

    Its first square is that of one of the demonstrations, each as likely.
    """
    content = json.loads(Path(path).read_text("utf-8"))
    cells, wall = content["cells"], content["wall"]
    row, column = np.divmod(np.arange(cells**2), cells)
    to_row = np.clip(row[:, None] + MOVES[:, 1], 0, cells - 1)
    to_column = np.clip(column[:, None] + MOVES[:, 0], 0, cells - 1)
    under = (wall["from"] <= column) & (column < wall["to"])
    crosses = (to_row != row[:, None]) & under[:, None]
    crosses &= np.maximum(to_row, row[:, None]) == wall["row"]
    arrival = np.where(
        crosses, np.arange(cells**2)[:, None], to_row * cells + to_column
    )
    starts = [one["states"][0] for one in content["demonstrations"]]
    initial = np.bincount(starts, minlength=cells**2) / len(starts)
    return MDP(np.eye(cells**2)[arrival], initial, discount)
