import gymnasium
import imageio_ffmpeg
import mujoco
import numpy as np
import pytest
import torch

from offairl_lite import envs
from offairl_lite.analysis import films as video
from offairl_lite.core.networks import Normaliser
from offairl_lite.core.policies import Policy, SquashedGaussian
from offairl_lite.core.rng import Rng

MAZE = "offairl/PointMazeLeft-v0"


def policy(seeds=(0,), obs_dim=3, action_dim=2):
    actor = SquashedGaussian(obs_dim, action_dim, (8,))
    normaliser = Normaliser.identity(len(seeds), obs_dim)
    return Policy(MAZE, actor, actor.init(Rng(seeds)), normaliser)


@pytest.mark.parametrize("obs_dim", [3, 4])
def test_frames_show_an_episode_that_moves(obs_dim):
    film = video.frames(policy(obs_dim=obs_dim), MAZE, max_steps=6)
    assert (film.shape[0], film.shape[3], film.dtype) == (7, 3, np.uint8)
    assert (film[0] != film[-1]).any()


def test_frames_may_be_left_out():
    whole = video.frames(policy(), MAZE, max_steps=6)
    third = video.frames(policy(), MAZE, max_steps=6, every=3)
    np.testing.assert_array_equal(third, whole[::3])


def test_a_film_ends_with_its_episode():
    film = video.frames(policy(obs_dim=11, action_dim=3), "Hopper-v5", max_steps=900, every=400)
    assert len(film) == 1


def test_a_policy_of_another_task_is_refused():
    with pytest.raises(ValueError, match=r"PointMazeLeft-v0 sees 3 numbers, .*given 11"):
        video.frames(policy(), "Hopper-v5")
    with pytest.raises(ValueError, match=r"gives 1 numbers, and actions have the shape \(2,\)"):
        video.frames(policy(action_dim=1), MAZE)


class Unseen(gymnasium.Env):
    """A task that knows nothing of rendering."""

    observation_space = gymnasium.spaces.Box(-1, 1, (3,))
    action_space = gymnasium.spaces.Box(-1, 1, (2,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(3, np.float32), {}

    def step(self, action):
        return np.zeros(3, np.float32), 0.0, False, False, {}


class OnScreen(Unseen):
    """As Gymnasium's manual writes a task; this one has a window alone."""

    metadata = {"render_modes": ["human"], "render_fps": 9}  # noqa: RUF012

    def __init__(self, render_mode=None):
        assert render_mode is None or render_mode in self.metadata["render_modes"]


class Unwritten(Unseen):
    """A task without a `render`."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 9}  # noqa: RUF012

    def __init__(self, render_mode=None):
        self.render_mode = render_mode


class Empty(Unwritten):
    """A task that draws nothing."""

    def render(self):
        return None


class Dark(Unwritten):
    """A task that looks for a display, where there is none."""

    def render(self):
        raise mujoco.FatalError("an OpenGL platform library has not been loaded")


class Drawn(Unwritten):
    """A task that renders."""

    def render(self):
        return np.zeros((16, 16, 3), np.uint8)


@pytest.fixture
def register():
    """Register tasks, and forget them afterwards."""
    known = set(gymnasium.registry)
    yield lambda kind: gymnasium.register("Mine-v0", entry_point=kind, max_episode_steps=5)
    for env_id in set(gymnasium.registry) - known:
        gymnasium.registry.pop(env_id)


@pytest.mark.filterwarnings("ignore::UserWarning")  # Gymnasium's, which say less.
@pytest.mark.parametrize(
    ("kind", "why"),
    [
        (Unseen, "TypeError.*takes no arguments"),
        (OnScreen, "AssertionError"),
        (Unwritten, "NotImplementedError"),
        (Empty, "NoneType"),
    ],
)
def test_a_task_that_renders_no_frames_is_named(kind, why, register):
    register(kind)
    message = f"Mine-v0 cannot be filmed: .* render_mode='rgb_array'; found: .*{why}"
    with pytest.raises(ValueError, match=message) as error:
        video.frames(policy(), "Mine-v0")
    assert "\n" not in str(error.value)


def test_a_machine_without_a_display_is_told_what_to_set(register):
    register(Dark)
    message = "Mine-v0 cannot be filmed here: an OpenGL .* loaded; .* set .* MUJOCO_GL=egl"
    with pytest.raises(ValueError, match=message):
        video.frames(policy(), "Mine-v0")


def test_a_task_of_one_s_own_is_filmed(register):
    register(Drawn)
    assert video.frames(policy(), "Mine-v0").shape == (6, 16, 16, 3)


def test_one_film_one_member():
    with pytest.raises(ValueError, match=r"2 members.*policy.member\(0\)"):
        video.frames(policy((0, 1)), MAZE)


def test_an_odd_row_or_column_is_left_out(monkeypatch):
    given = []
    encode = lambda pictures, **_: given.append(pictures.shape)  # noqa: E731
    monkeypatch.setattr(video.mediapy, "compress_video", encode)
    video.mp4(np.zeros((4, 33, 47, 3), np.uint8))
    assert given == [(4, 32, 46, 3)]


def test_mp4_is_an_mp4():
    film = np.zeros((4, 32, 48, 3), np.uint8)
    film[:, :, :24] = 255
    data = video.mp4(film)
    assert data[4:8] == b"ftyp"
    assert len(data) < 10_000


def test_a_film_in_a_page_carries_its_own_bytes():
    html = video.show(np.zeros((2, 32, 48, 3), np.uint8), "The maze.").data
    assert "data:video/mp4;base64," in html
    assert "<figcaption>The maze.</figcaption>" in html
    assert "http" not in html.split("base64,")[0]


def test_a_film_is_of_the_policy_s_own_episode():
    ant, actor = "offairl/CustomAnt-v0", policy(obs_dim=111, action_dim=8)
    env = envs.make(ant, 1, 3, render_mode="rgb_array")
    obs, _ = env.reset()
    expected = [env.render()[0]]
    for _ in range(5):
        seen = torch.as_tensor(obs, dtype=torch.float32)[:, None]
        obs, *_ = env.step(actor.act(seen)[:, 0].numpy())
        expected.append(env.render()[0])
    np.testing.assert_array_equal(video.frames(actor, ant, seed=3, max_steps=5), expected)


@pytest.mark.parametrize("fps", [5, 20])
def test_a_film_is_as_fast_as_it_is_told(fps, tmp_path):
    (tmp_path / "film.mp4").write_bytes(video.mp4(np.zeros((20, 32, 48, 3), np.uint8), fps))
    frames = imageio_ffmpeg.read_frames(tmp_path / "film.mp4")
    assert next(frames)["fps"] == fps
    frames.close()
