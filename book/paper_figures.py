"""The paper's figures and table (Arnob 2020), and the records behind each.

Beside the exact log π of the paper's logit stands the density of the
replay, without its tail (`DiscriminatorConfig.loss`), and the same with the
temperature of the logit, 1. The paper's random starts are by an expert;
those by the imitator stand beside them. The paper draws SAC beside the gate
as well; SAC has no gate, and stands beside gate and primitives alone.
"""

from collections.abc import Mapping

from offairl_lite.experiments import find
from offairl_lite.scale import Scale

# The appendix's table "Expert Average Performance": the mean return of the
# seeds 0-9 after 10⁶ steps, and the temperature.
PAPER: Mapping[str, tuple[float, str]] = {
    "HalfCheetah": (11083, "0.2"),
    "Ant": (4294, "learned"),
    "Hopper": (3544, "0.2"),
    "Walker2d": (4490, "0.2"),
    "CustomAnt": (2430, "0.2"),
    "DisabledAnt": (1089, "learned"),
    "PointMazeLeft": (-7.37, "learned"),
    "PointMazeRight": (-7.33, "learned"),
}

# Records that are not where the command line would put them. What two
# experiments have in common is recorded once; the maze's experts of demo
# scale are those of `maze-expert`, trained for longer.
_RECORDED: Mapping[tuple[str, Scale], str] = {
    ("maze-rewards/implementation-2", "demo"): "maze-imitation-2-demo",
    ("maze-rewards/implementation-4", "demo"): "maze-imitation-demo",
    ("maze-rewards/dac", "demo"): "maze-dac-demo/sac",
    ("maze-penalties/logit", "demo"): "maze-imitation-demo",
    ("experts/PointMazeLeft-sac-learned", "demo"): "maze-expert-left-demo",
    (
        "experts/PointMazeRight-sac-learned",
        "demo",
    ): "maze-expert-right-demo",
    ("maze-mcp/plain", "full"): "maze-imitation-full",
    **{
        (f"experts/{name}", "full"): f"experts/{name}"
        for name in find("experts").variants
    },
}


def record(run: str, scale: Scale) -> str:
    """Return the folder in `book/records` for the record of a run."""
    name, _, variant = run.partition("/")
    return _RECORDED.get(
        (run, scale), f"{name}-{scale}/{variant}".rstrip("/")
    )


DENSITY = "replay density"
MIXTURE = "locomotion-first/{}-airl-mixture"
_MUJOCO = ("HalfCheetah", "Ant", "Hopper", "Walker2d")

# Figure, panel, curve, and the run that it shows.
FIGURES: Mapping[str, Mapping[str, Mapping[str, str]]] = {
    "reward variants": {
        panel: {
            f"Implementation {n}": f"ant-rewards/implementation-{n}"
            for n in (1, 2, 3, 4)
        }
        | {
            f"Implementation 4, {DENSITY}": (
                "ant-rewards/implementation-4-mixture"
            )
        }
        for panel in ("CustomAnt, true return", "CustomAnt, learned return")
    },
    # By the recipe.
    "off-policy AIRL and DAC": {
        task: {
            "off-policy AIRL": f"locomotion/{task}-airl",
            "DAC": f"locomotion/{task}-dac",
        }
        for task in ("Hopper", "Walker2d", "HalfCheetah", "CustomAnt")
    },
    "off-policy AIRL and DAC, first settings": {
        task: {
            "off-policy AIRL": f"locomotion-first/{task}-airl",
            f"off-policy AIRL, {DENSITY}": MIXTURE.format(task),
            "the same, α = 1": f"locomotion-first/{task}-airl-soft",
            "DAC": f"locomotion-first/{task}-dac",
        }
        for task in _MUJOCO
    },
    "imitation and transfer": {
        "CustomAnt": {
            "off-policy AIRL": "locomotion/CustomAnt-airl",
            "first settings": "locomotion-first/CustomAnt-airl",
            f"first settings, {DENSITY}": MIXTURE.format("CustomAnt"),
        },
        "PointMazeLeft": {"off-policy AIRL": "maze-imitation"},
        "DisabledAnt": {
            "old policy": "ant-transfer/policy",
            "from scratch": "ant-transfer/scratch",
            "old policy, released order": (
                "ant-transfer/policy-released-order"
            ),
        },
        "PointMazeRight": {
            "old policy": "maze-retraining/policy",
            "from scratch": "maze-retraining/scratch",
        },
    },
    "SAC and SAC-MCP": {
        task: {
            "SAC": f"locomotion-first/{task}-airl",
            "SAC-MCP, k = 4": f"locomotion-first/{task}-mcp-4",
            "SAC-MCP, k = 8": f"locomotion-first/{task}-mcp-8",
        }
        for task in _MUJOCO
    },
    "maze transfer with MCP": {
        title: {
            f"SAC-MCP, k = {k}": f"maze-retraining/{k}-{part}"
            for k in (4, 8)
        }
        for title, part in (
            ("gate alone", "gate"),
            ("gate and primitives", "both"),
        )
    },
    "random starts": {
        f"{title}; guide: {guide}": sac
        | {
            f"SAC-MCP, k = {k}": (
                f"maze-retraining/{k}-{part}-{start}-starts"
            )
            for k in (4, 8)
        }
        for start, guide in (
            ("expert", "an expert"),
            ("own", "the imitator"),
        )
        for title, part, sac in (
            ("gate alone", "gate", {}),
            (
                "gate and primitives",
                "both",
                {"SAC": f"maze-retraining/policy-{start}-starts"},
            ),
        )
    },
    "expert selection": {
        task: {
            "TD3": f"experts/{task}-td3",
            "SAC, α = 0.2": f"experts/{task}-sac-fixed",
            "SAC, α learned": f"experts/{task}-sac-learned",
        }
        for task in (
            *_MUJOCO,
            "CustomAnt",
            "DisabledAnt",
            "PointMazeLeft",
            "PointMazeRight",
        )
    },
    "DAC with TD3 and SAC": {
        task: {
            "DAC with TD3": f"locomotion/{task}-dac-td3",
            "DAC with SAC": f"locomotion/{task}-dac",
        }
        for task in ("Hopper", "Walker2d", "HalfCheetah", "CustomAnt")
    },
}
