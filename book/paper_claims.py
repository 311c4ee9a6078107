"""The paper's eight claims (Arnob 2020), as data.

A claim is a list of comparisons. Each asks one question of one or two
runs, about the returns of their seeds or about which seeds arrive.
`paper_verdicts` answers them.
"""

from typing import NamedTuple

from paper_figures import PAPER

BAR = -14  # no policy returns more without passing the barrier
HALF = PAPER["DisabledAnt"][0] / 2


class Comparison(NamedTuple):
    """A question about one run, or about a run and another or a bar."""

    what: str
    question: str
    one: str
    other: str | float | None = None


class Claim(NamedTuple):
    """A claim, what decides it, and what is compared beside it.

    What stands beside it need not be recorded.
    """

    text: str
    comparisons: tuple[Comparison, ...]
    instead: tuple[Comparison, ...] = ()


RETURNS = ("better", "comparable", "fails")
SUCCESSES = ("arrives", "varies", "mostly fails", "more arrive")

DAC = (
    ("Hopper", "better", "above"),
    ("Walker2d", "better", "above"),
    ("HalfCheetah", "comparable", "like"),
    ("Ant", "comparable", "like"),
)
ANT, MAZE = "ant-rewards/implementation-", "maze-retraining/"
CLAIMS = {
    1: Claim(
        "Implementation 4 is the best reward.",
        tuple(
            Comparison(
                f"CustomAnt: 4 above {n}", "better", f"{ANT}4", f"{ANT}{n}"
            )
            for n in (1, 2, 3)
        ),
        tuple(
            Comparison(
                f"PointMazeLeft: 4 above {n}",
                "better",
                "maze-rewards/implementation-4",
                f"maze-rewards/implementation-{n}",
            )
            for n in (1, 2, 3)
        ),
    ),
    2: Claim(
        "Off-policy AIRL is better than DAC on Hopper and Walker2d, and "
        "comparable on HalfCheetah and Ant.",
        tuple(
            Comparison(
                f"{task}: AIRL {word} DAC",
                question,
                f"locomotion/{task}-airl",
                f"locomotion/{task}-dac",
            )
            for task, question, word in DAC
        ),
        (
            Comparison(
                "PointMazeLeft: AIRL above DAC",
                "better",
                "maze-imitation",
                "maze-dac/sac",
            ),
            Comparison(
                "CustomAnt: AIRL like DAC",
                "comparable",
                "locomotion/CustomAnt-airl",
                "locomotion/CustomAnt-dac",
            ),
            *(
                Comparison(
                    f"{task}, first settings: AIRL {word} DAC",
                    question,
                    f"locomotion-first/{task}-airl",
                    f"locomotion-first/{task}-dac",
                )
                for task, question, word in DAC
            ),
        ),
    ),
    3: Claim(
        "The transfer to DisabledAnt fails.",
        tuple(
            Comparison(
                f"{kept}: below half of the expert",
                "fails",
                f"ant-transfer/{run}",
                HALF,
            )
            for kept, run in (
                ("SAC", "policy"),
                ("k = 4", "4-both"),
                ("k = 8", "8-both"),
            )
        ),
    ),
    4: Claim(
        "The transfer to PointMazeRight works, with high variance.",
        (
            Comparison(
                "old policy: more arrive than at the first evaluation",
                "arrives",
                f"{MAZE}policy",
            ),
            Comparison(
                "old policy: some arrive, some do not",
                "varies",
                f"{MAZE}policy",
            ),
        ),
        (
            Comparison(
                "more arrive from scratch than from the old policy",
                "more arrive",
                f"{MAZE}scratch",
                f"{MAZE}policy",
            ),
        ),
    ),
    5: Claim(
        "SAC-MCP improves imitation on HalfCheetah and Ant.",
        tuple(
            Comparison(
                f"{task}: k = {k} above SAC",
                "better",
                f"locomotion/{task}-mcp-{k}",
                f"locomotion/{task}-airl",
            )
            for task in ("HalfCheetah", "Ant")
            for k in (4, 8)
        ),
        (
            *(
                Comparison(
                    f"PointMazeLeft: k = {k} above SAC",
                    "better",
                    f"maze-mcp/{k}-softmax",
                    "maze-mcp/plain",
                )
                for k in (4, 8)
            ),
            *(
                Comparison(
                    f"{task}, first settings: k = {k} above SAC",
                    "better",
                    f"locomotion-first/{task}-mcp-{k}",
                    f"locomotion-first/{task}-airl",
                )
                for task in ("HalfCheetah", "Ant")
                for k in (4, 8)
            ),
        ),
    ),
    6: Claim(
        "Retraining the gate alone fails on the maze [here: after a short "
        "warm-up].",
        tuple(
            Comparison(label, "mostly fails", MAZE + run)
            for label, run in (
                # Seeds ran away at a learned temperature.
                ("gate alone, k = 4, fixed temperature", "4-gate-cool"),
                ("gate alone, k = 8, fixed temperature", "8-gate-cool"),
            )
        ),
    ),
    7: Claim(
        "With eight primitives the transfer varies less than with SAC.",
        *(
            (
                Comparison(
                    f"k = 8 against {than}",
                    "more arrive",
                    f"{MAZE}8-both",
                    f"{MAZE}{run}",
                ),
            )
            for than, run in (
                ("the old policy", "policy"),
                ("k = 4", "4-both"),
            )
        ),
    ),
    8: Claim(
        "Random starts improve the transfer, and make it vary less.",
        tuple(
            Comparison(
                f"{kept}: with a guide against without",
                "more arrive",
                f"{MAZE}{run}-expert-starts",
                f"{MAZE}{run}{cool}",
            )
            for kept, run, cool in (
                ("old policy", "policy", ""),
                ("k = 4", "4-both", ""),
                ("k = 8", "8-both", ""),
                # With a guide no gate's temperature runs away.
                ("gate alone, k = 4", "4-gate", "-cool"),
                ("gate alone, k = 8", "8-gate", "-cool"),
            )
        ),
    ),
}
