"""The page that says how the build went: `{status}` is replaced by tables.

The times are those of the executed notebooks, the versions those of the
environment that renders.
"""

import json
import platform
from datetime import datetime
from importlib.metadata import version
from pathlib import Path

from sphinx.util.docutils import SphinxDirective

from offairl_lite import scale

PACKAGES = [
    "torch",
    "mujoco",
    "gymnasium",
    "minari",
    "numpy",
    "scipy",
    "matplotlib",
    "safetensors",
    "jupyter-book",
]


def executed(path):
    """Return when a notebook's first cell began and its last one ended.

    None if it has not been executed.
    """
    times = [
        datetime.fromisoformat(cell["metadata"]["execution"][event])
        for cell in json.loads(path.read_text("utf-8"))["cells"]
        for event in ("iopub.execute_input", "shell.execute_reply")
        if "execution" in cell["metadata"]
    ]
    return (min(times), max(times)) if times else None


def checked(path):
    """Return how many statements of an executed page hold, of how many."""
    outcomes = [
        outcome
        for cell in json.loads(path.read_text("utf-8"))["cells"]
        for output in cell.get("outputs", [])
        for outcome in output.get("metadata", {}).get("checks", [])
    ]
    held = sum(not outcome["evidence"] for outcome in outcomes)
    return f"{held} of {len(outcomes)}"


class Status(SphinxDirective):
    """Two tables: the chapters with their seconds, and the versions."""

    def run(self):
        """Return the tables."""
        lines = [
            f"| page | seconds, {scale.current()} scale "
            "| statements that hold | began (UTC) |",
            "|---|---:|---:|---|",
        ]
        for page in sorted(self.env.found_docs):
            path = Path(self.env.doc2path(page))
            times = path.suffix == ".ipynb" and executed(path)
            if times:
                took = (times[1] - times[0]).total_seconds()
                lines.append(
                    f"| {{doc}}`/{page}` | {took:.0f} | {checked(path)} "
                    f"| {times[0]:%Y-%m-%d %H:%M} |"
                )
        lines += ["", "| | version |", "|---|---|"]
        lines += [f"| Python | {platform.python_version()} |"]
        lines += [f"| {name} | {version(name)} |" for name in PACKAGES]
        lines += [f"| {platform.system()} | {platform.machine()} |"]
        return self.parse_text_to_nodes("\n".join(lines))


def setup(app):
    """Register with Sphinx; the page is read again at every build."""
    app.add_directive("status", Status)
    app.connect("env-get-outdated", lambda *_: ["book/status"])
    return {"parallel_read_safe": True, "parallel_write_safe": True}
