"""Strips: pictures of episodes at equal times, one episode a row."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import mujoco
import numpy as np
from jaxtyping import Float, UInt8

from offairl_lite.analysis import plots
from offairl_lite.envs.raycast import Camera, render
from offairl_lite.envs.tasks import Task

HERE = Path(__file__).parent
Picture = UInt8[np.ndarray, "H W 3"]


def save(
    name: str,
    rows: Iterable[Iterable[Picture]],
    titles: Sequence[str],
    labels: Sequence[str],
    size: tuple[float, float],
    dpi: int = 110,
) -> None:
    """Draw rows of pictures, with titles above and labels at the left."""
    with plots.style():
        shape = len(labels), len(titles)
        fig, axes = plt.subplots(*shape, figsize=size, layout="constrained")
        for line, row, label in zip(axes, rows, labels, strict=True):
            for ax, picture in zip(line, row, strict=True):
                ax.imshow(picture)
                ax.set(xticks=[], yticks=[])
                ax.spines[:].set_visible(False)
            line[0].set_ylabel(label)
        for ax, title in zip(axes[0], titles, strict=True):
            ax.set_title(title)
        layout = fig.get_layout_engine()
        layout.set(wspace=0.01, hspace=0.01, w_pad=0, h_pad=0)
        fig.savefig(HERE / f"{name}.png", dpi=dpi)


def unobserved(model: mujoco.MjModel) -> int:
    """Return how many coordinates on the plane are not observed."""
    return 2 if model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE else 1


def pictures(
    task: Task,
    obs: Float[np.ndarray, "T O"],
    camera: Camera,
    places: Float[np.ndarray, "T unseen"] | float = 0.0,
    shape: tuple[int, int] = (240, 240),
) -> Iterator[Picture]:
    """Give a frame, of this width and height, of each observation."""
    model = task.model()
    data, n = mujoco.MjData(model), unobserved(model)
    for seen, place in zip(
        obs, np.broadcast_to(places, (len(obs), n)), strict=True
    ):
        data.qpos[:] = [*place, *seen[: model.nq - n]]
        mujoco.mj_kinematics(model, data)
        yield render(model, data, *shape, camera)
