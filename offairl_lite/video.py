"""Short MP4 films of policies, drawn without any graphics library and embedded in the page."""

from collections.abc import Sequence
from contextlib import closing

import imageio_ffmpeg
import mediapy
import numpy as np
import torch
from IPython.display import HTML
from jaxtyping import UInt8

from offairl_lite import envs
from offairl_lite.evaluate import seen
from offairl_lite.policies import Policy


def frames(
    policy: Policy, env_id: str, seed: int = 0, max_steps: int = 200, every: int = 1
) -> UInt8[np.ndarray, "T H W 3"]:
    """Return the frames of one episode of a one-member policy's mode.

    Args:
        policy: one member; take it with `policy.member(i)`.
        env_id: one of the package's tasks.
        seed: of the episode.
        max_steps: where to stop at the latest.
        every: steps between frames.

    Raises:
        ValueError: the policy has more than one member, or the task's observations are of another
            size than it sees.
    """
    if len(policy) != 1:
        raise ValueError(f"{len(policy)} members in one film; choose one: policy.member(0)")
    policy = policy.to("cpu")
    with closing(envs.make(env_id, 1, seed, render_mode="rgb_array")) as env:
        obs, _ = env.reset()
        pictures = [env.render()[0]]
        for step in range(1, max_steps + 1):
            x = seen(policy, torch.as_tensor(obs, dtype=torch.float32)).unsqueeze(1)
            obs, _, terminated, truncated, _ = env.step(policy.act(x).squeeze(1).numpy())
            if step % every == 0:
                pictures.append(env.render()[0])
            if terminated[0] or truncated[0]:
                break
    return np.stack(pictures)


def mp4(pictures: UInt8[np.ndarray, "T H W 3"], fps: int = 20) -> bytes:
    """Encode frames as H.264, well under a kilobyte a frame."""
    mediapy.set_ffmpeg(imageio_ffmpeg.get_ffmpeg_exe())
    return mediapy.compress_video(pictures, fps=fps, crf=28)


def show(pictures: UInt8[np.ndarray, "T H W 3"], caption: str, fps: int = 20) -> HTML:
    """Return the film for a notebook: it carries its own bytes, so the page needs no other file."""
    height, width = pictures.shape[1:3]
    player = mediapy.html_from_compressed_video(mp4(pictures, fps), width, height)
    return HTML(f"<figure>{player}<figcaption>{caption}</figcaption></figure>")


def side_by_side(*films: UInt8[np.ndarray, "T H W 3"]) -> UInt8[np.ndarray, "T H W 3"]:
    """Join films of equal height; a shorter one stands still at its end."""
    longest = max(map(len, films))
    return np.concatenate([_held(film, longest) for film in films], axis=2)


def _held(film: Sequence, length: int) -> np.ndarray:
    return np.concatenate([film, np.repeat(film[-1:], length - len(film), axis=0)])
