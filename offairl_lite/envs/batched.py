"""All members of one task, stepped together by MuJoCo on native threads."""

from collections.abc import Sequence

import gymnasium
import mujoco
import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from offairl_lite.config.settings import Count, Natural, checked
from offairl_lite.envs.raycast import render
from offairl_lite.envs.tasks import TASKS, Physics

Step = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict]
"""Observations, rewards, terminated, truncated, each over the members, and a dictionary."""
try:
    from mujoco.batch import Batch
except ImportError:  # MuJoCo 3 has no batches.
    Batch = None
FRAME_SIZE = 240  #: Width and height of a rendered frame, in pixels.


class BatchedEnv(gymnasium.vector.VectorEnv):
    """A vector environment of a key of `TASKS`, whose members share a model and nothing else.

    A member's episodes depend neither on how many others there are nor on the number of threads.
    Observations are float64, `(num_envs, O)`; actions float32, `(num_envs, A)`. As in Gymnasium's
    MuJoCo tasks, MuJoCo clamps an action beyond the bounds, and the reward is charged for it in
    full. A member without an episode is reset by `step` in mode `NEXT_STEP`, and is an error in
    mode `DISABLED`. Without `seeds`, one per member, they are taken from the system.
    """

    # In the base class a property; here the members' generators, as in Gymnasium's SyncVectorEnv.
    np_random: tuple[np.random.Generator, ...]  # type: ignore[assignment]
    single_observation_space: Box
    single_action_space: Box

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        *,
        seeds: Sequence[int | None] | None = None,
        num_threads: int = 1,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
    ):
        if task not in TASKS:
            raise ValueError(f"unknown task {task!r}; known are {', '.join(TASKS)}")
        if Batch is None:
            here = f"by MuJoCo 4, and here is MuJoCo {mujoco.__version__}"
            raise ImportError(f"{task} is stepped in batches, {here}: pip install 'mujoco>=4'")
        for name, count in (("num_envs", num_envs), ("num_threads", num_threads)):
            checked(name, count, Count)
        if autoreset_mode not in (AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED):
            raise ValueError(f"autoreset_mode must be NEXT_STEP or DISABLED, not {autoreset_mode}")
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode must be None or 'rgb_array', not {render_mode!r}")
        self.task, self.num_envs, self.render_mode = TASKS[task], num_envs, render_mode
        limit = checked("max_episode_steps", max_episode_steps, Count | None)
        self.max_episode_steps = limit or self.task.max_episode_steps
        model = self.task.model()
        # Contact forces are computed from a member's whole MjData, which only a persistent batch
        # keeps. Without them the state row is enough, and memory grows only with the threads.
        self._batch = Batch(model, num_envs, num_threads, persistent=self.task.contact_forces)
        self._model = self._batch.model
        self._scratch = mujoco.MjData(model)
        # Live views: MuJoCo reads and writes the simulations through them.
        self._qpos, self._qvel = self._batch.bind("qpos"), self._batch.bind("qvel")
        self._ctrl, self._xpos = self._batch.bind("ctrl"), self._batch.bind("xpos")
        self._seconds = model.opt.timestep * self.task.frame_skip
        self.metadata = {"render_modes": ["rgb_array"], "render_fps": round(1 / self._seconds)}
        self.metadata["autoreset_mode"] = autoreset_mode
        bodies = model.nbody if self.task.contact_forces else 0
        self._observe(np.zeros((num_envs, 2)), np.zeros((num_envs, bodies, 6)))
        self._clock = np.zeros(num_envs, np.int64)
        self._idle = np.ones(num_envs, bool)
        self.np_random = tuple(seeding.np_random(s)[0] for s in member_seeds(seeds, num_envs))
        low, high = model.actuator_ctrlrange.T.astype(np.float32)
        self.single_action_space = Box(low, high, dtype=np.float32)
        # MuJoCo resets a simulation when a position or a velocity exceeds this value.
        bound, shape = mujoco.mjMAXVAL, self._observations.shape[1:]
        self.single_observation_space = Box(-bound, bound, shape, np.float64)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict | None = None
    ) -> tuple[np.ndarray, dict]:
        """Start new episodes; return the observations of all members, and an empty dictionary.

        A number s seeds member i with s + i, a sequence each with its own, or None: its generator
        continues. With the options `{"reset_mask": mask}` the marked members alone are reset.
        """
        mask, generators = reset_mask(options, self.num_envs), list(self.np_random)
        for member, new_seed in enumerate(member_seeds(seed, self.num_envs)):
            if mask[member] and new_seed is not None:
                generators[member] = seeding.np_random(new_seed)[0]
        self.np_random = tuple(generators)
        self._start(np.flatnonzero(mask))
        return self._observations.copy(), {}

    def step(self, actions: np.ndarray) -> Step:
        """Advance every member by one step; in mode NEXT_STEP, reset the finished members instead.

        Their reward is then 0, terminated and truncated are False.

        Raises:
            ValueError: `actions` are not finite.
            RuntimeError: in mode DISABLED, a member is finished.
        """
        actions, idle = checked_actions(actions, self), self._idle
        if self.metadata["autoreset_mode"] == AutoresetMode.DISABLED:
            require_episodes(idle)
        before, running = self._physics, np.flatnonzero(~idle)
        self._ctrl[running] = actions[running]
        self._batch.step(running, nstep=self.task.frame_skip)
        self._measure(running, stepped=True)
        after = self._physics
        self._clock[running] += 1
        rewards = np.where(idle, 0.0, self.task.reward(before, actions, after, self._seconds))
        terminated = self.task.terminated(after) & ~idle
        truncated = (self._clock >= self.max_episode_steps) & ~idle
        if idle.any():
            self._start(np.flatnonzero(idle))
        self._idle = terminated | truncated
        return self._observations.copy(), rewards, terminated, truncated, {}

    def get_state(self) -> dict[str, np.ndarray]:
        """Return everything that later steps depend on, as arrays for `set_state`."""
        return {
            "physics": self._batch.state.copy(),
            "torso": self._physics.torso.copy(),
            "contact": self._physics.contact.copy(),
            "clock": self._clock.copy(),
            "idle": self._idle.copy(),
            "generators": generator_words(self.np_random, self),
        }

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Continue exactly from a state that `get_state` returned, here or in another object."""
        require_layout(state, self.get_state())
        self._batch.state[:] = state["physics"]
        self._observe(state["torso"].copy(), state["contact"].copy())
        self._clock, self._idle = state["clock"].copy(), state["idle"].copy()
        set_generator_words(self.np_random, state["generators"])

    def render(self) -> tuple[np.ndarray, ...]:
        """Return the frames of all members, each (FRAME_SIZE, FRAME_SIZE, 3) uint8."""
        if self.render_mode is None:
            raise RuntimeError("make the environment with render_mode='rgb_array' to render it")
        frames = []
        for member in range(self.num_envs):
            data = self._batch.get_data(member, self._scratch)
            mujoco.mj_kinematics(self._model, data)
            frames.append(render(self._model, data, FRAME_SIZE, FRAME_SIZE, self.task.camera))
        return tuple(frames)

    def _start(self, members: np.ndarray) -> None:
        """Start new episodes of some members, with draws from their own generators."""
        self._batch.reset(members, stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        for member in members:
            position, velocity = self.task.noise(self.np_random[member], self._model)
            self._qpos[member] += position
            self._qvel[member] += velocity
        self._batch.forward(members)
        self._measure(members, stepped=False)
        self._clock[members] = 0
        self._idle[members] = False

    def _measure(self, moved: np.ndarray, stepped: bool) -> None:
        """Update physics and observations of members that moved; by-products of others stay."""
        torso, contact = self._physics.torso.copy(), self._physics.contact.copy()
        torso[moved] = self._xpos[moved, 1, :2]
        contact[moved] = 0.0
        for member in moved if stepped and self.task.contact_forces else ():
            data = self._batch.get_data(member, self._scratch)
            mujoco.mj_rnePostConstraint(self._model, data)
            contact[member] = np.clip(data.cfrc_ext, -1, 1)
        self._observe(torso, contact)

    def _observe(self, torso: np.ndarray, contact: np.ndarray) -> None:
        self._physics = Physics(self._qpos.copy(), self._qvel.copy(), torso, contact)
        self._observations = self.task.observe(self._physics)


def checked_actions(actions: np.ndarray, env: gymnasium.vector.VectorEnv) -> np.ndarray:
    """Return all members' actions; ValueError if they do not fit the space, or are not finite."""
    actions, shape = np.asarray(actions), env.action_space.shape
    if actions.shape != shape or actions.dtype.kind not in "fiu":
        actual = f"{actions.dtype} of shape {actions.shape}"
        raise ValueError(f"actions must be numbers of shape {shape}, not {actual}")
    for member, joint in np.argwhere(~np.isfinite(actions)):
        wrong = f"action[{joint}] is {actions[member, joint]}"
        raise ValueError(f"member {member}: {wrong}; actions must be finite, in {env.action_space}")
    return actions


def member_seeds(seed: int | Sequence[int | None] | None, num_envs: int) -> list[int | None]:
    """Return a seed or None for each member: s + i for a number s, or the sequence itself."""
    if seed is None:
        return [None] * num_envs
    if not isinstance(seed, Sequence | np.ndarray):
        return [checked("seed", seed, Natural) + i for i in range(num_envs)]
    if len(seed) != num_envs:
        raise ValueError(f"expected one seed for each of {num_envs} members, got {seed}")
    return [checked("seed", one, Natural | None) for one in seed]


def reset_mask(options: dict | None, num_envs: int) -> np.ndarray:
    """Return which members to reset, (num_envs,) bool: all unless `options` has a `reset_mask`."""
    if options is None or "reset_mask" not in options:
        return np.ones(num_envs, bool)
    mask = options["reset_mask"]
    valid = isinstance(mask, np.ndarray) and mask.dtype == bool
    if not valid or mask.shape != (num_envs,) or not mask.any():
        wanted = f"a boolean array of shape ({num_envs},) with a member to reset"
        raise ValueError(f"reset_mask must be {wanted}, not {mask!r}")
    return mask


def require_episodes(idle: np.ndarray) -> None:
    """Raise RuntimeError if a member has no episode in progress."""
    if idle.any():
        gone = np.flatnonzero(idle).tolist()
        cure = "reset them with reset(options={'reset_mask': mask}) before the next step"
        raise RuntimeError(f"members {gone} have no episode in progress: {cure}")


def require_layout(state: dict[str, np.ndarray], like: dict[str, np.ndarray]) -> None:
    """Raise ValueError unless two states have the same names, shapes and types."""
    expected = {name: (array.shape, array.dtype) for name, array in like.items()}
    parts = (state or {}).items()
    actual = {name: (np.shape(array), np.asarray(array).dtype) for name, array in parts}
    if actual != expected:
        raise ValueError(f"not a state of this environment: expected {expected}, got {actual}")


def generator_words(generators: Sequence[np.random.Generator], owner) -> np.ndarray:
    """Return states of PCG64 generators, (n, 6) uint64: high and low words, and a spare draw."""
    rows = []
    for rng in generators:
        if not isinstance(getattr(rng, "bit_generator", None), np.random.PCG64):
            wanted = "a numpy.random.Generator with PCG64, as Gymnasium makes it"
            raise ValueError(f"{owner}: expected members whose np_random is {wanted}, got {rng!r}")
        state = rng.bit_generator.state
        words = [word for name in ("state", "inc") for word in divmod(state["state"][name], 2**64)]
        rows.append([*words, state["has_uint32"], state["uinteger"]])
    return np.array(rows, np.uint64)


def set_generator_words(generators: Sequence[np.random.Generator], rows: np.ndarray) -> None:
    """Set generators to states that `generator_words` returned."""
    for rng, row in zip(generators, rows.tolist(), strict=True):
        high, low, inc_high, inc_low, has_uint32, uinteger = row
        rng.bit_generator.state = {
            "bit_generator": "PCG64",
            "state": {"state": high << 64 | low, "inc": inc_high << 64 | inc_low},
            "has_uint32": has_uint32,
            "uinteger": uinteger,
        }
