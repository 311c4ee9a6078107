"""Short MP4 films of policies, rendered without a graphics library and embedded in the page."""

from collections.abc import Iterator
from contextlib import closing, contextmanager

import imageio_ffmpeg
import mediapy
import mujoco
import numpy as np
import torch
from gymnasium.vector import VectorEnv
from IPython.display import HTML
from jaxtyping import UInt8

from offairl_lite import envs
from offairl_lite.config.settings import Count, checked
from offairl_lite.core.policies import Policy
from offairl_lite.core.rollouts import require_fit


def frames(
    policy: Policy, env_id: str, seed: int = 0, max_steps: int = 200, every: int = 1
) -> UInt8[np.ndarray, "T H W 3"]:
    """Return frames of one episode in which a policy takes its mode.

    Args:
        policy: of one member, such as `policy.member(i)`.
        env_id: the task.
        seed: of the episode.
        max_steps: where to stop at the latest.
        every: so many steps lie between two frames.

    Raises:
        ValueError: an argument is not as above, or the task does not render frames.
    """
    for name, count in (("max_steps", max_steps), ("every", every)):
        checked(name, count, Count)
    if len(policy) != 1:
        raise ValueError(f"the policy has {len(policy)} members; choose one: policy.member(0)")
    policy = policy.to("cpu")
    with _filming(env_id):
        env = envs.make(env_id, 1, seed, render_mode="rgb_array")
    with closing(env):
        require_fit(policy, env)
        obs, _ = env.reset()
        pictures = [_picture(env, env_id)]
        for step in range(1, max_steps + 1):
            x = torch.as_tensor(obs, dtype=torch.float32).unsqueeze(1)
            obs, _, terminated, truncated, _ = env.step(policy.act(x).squeeze(1).numpy())
            if step % every == 0:
                pictures.append(_picture(env, env_id))
            if terminated[0] or truncated[0]:
                break
    return np.stack(pictures)


def _picture(env: VectorEnv, env_id: str) -> UInt8[np.ndarray, "H W 3"]:
    """Return the current frame of an environment's only member."""
    with _filming(env_id):
        (picture,) = env.render() or (None,)
        if not isinstance(picture, np.ndarray) or picture.shape[2:] != (3,):
            raise TypeError(f"render() returned {type(picture).__name__}")
    return picture


@contextmanager
def _filming(env_id: str) -> Iterator[None]:
    """Turn the errors of a task that does not render frames into one that says what it lacks."""
    try:
        yield
    except mujoco.FatalError as error:
        raise ValueError(
            f"{env_id} cannot be filmed here: {error}; without a display set the environment "
            "variable MUJOCO_GL=egl, or osmesa"
        ) from error
    except (TypeError, AssertionError, NotImplementedError, envs.TaskError) as error:
        cause = error.__cause__ or error
        cure = "; let what is registered take **kwargs, and hand them to gymnasium.make"
        cure *= "unexpected keyword argument 'render_mode'" in str(cause)
        raise ValueError(
            f"{env_id} cannot be filmed: its render() must return frames (height, width, 3) with "
            f"render_mode='rgb_array'; found: {cause!r}{cure}"
        ) from error


def mp4(pictures: UInt8[np.ndarray, "T H W 3"], fps: int = 20) -> bytes:
    """Return frames encoded as an MP4 with H.264; ValueError if they are not as annotated."""
    frames, rate = np.asarray(pictures), checked("fps", fps, Count)
    if frames.dtype != np.uint8 or frames.shape[3:] != (3,) or not frames.size:
        problem = f"{frames.dtype} of shape {frames.shape}"
        raise ValueError(f"pictures is {problem}; expected uint8 of shape (T, H, W, 3), not empty")
    mediapy.set_ffmpeg(imageio_ffmpeg.get_ffmpeg_exe())
    frames = frames[:, : frames.shape[1] // 2 * 2, : frames.shape[2] // 2 * 2]  # As players expect.
    return mediapy.compress_video(frames, fps=rate, crf=28, ffmpeg_args="-preset veryfast")


def show(pictures: UInt8[np.ndarray, "T H W 3"], caption: str, fps: int = 20) -> HTML:
    """Return a player for a notebook; it contains the film, so the page needs no other file."""
    film, (_, height, width, _) = mp4(pictures, fps), np.shape(pictures)
    player = mediapy.html_from_compressed_video(film, width, height)
    return HTML(f"<figure>{player}<figcaption>{caption}</figcaption></figure>")
