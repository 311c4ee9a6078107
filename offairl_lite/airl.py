"""`AIRL`: imitate demonstrations of a task, and learn their reward."""

import shutil
import warnings
import weakref
from collections.abc import Sequence
from dataclasses import asdict, fields
from difflib import get_close_matches
from os import PathLike
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import torch

from offairl_lite import demonstrations as data
from offairl_lite import envs
from offairl_lite.config import flat_settings
from offairl_lite.config.settings import EARLIER, Count, Natural, checked
from offairl_lite.core.results import Run
from offairl_lite.core.rollouts import action as act
from offairl_lite.experiments import find
from offairl_lite.runs import checkpoints, folders, inputs, preflight, records
from offairl_lite.runs.export import InUnits
from offairl_lite.runs.launch import CHECKPOINT_EVERY, RunInputs

Path_ = str | PathLike


class AIRL:
    """Off-policy AIRL with the recipe's settings: a policy and a reward for each seed.

    It is a run folder, as on the command line, so it can be stopped at any moment and goes on
    exactly. The folder is a temporary one, unless `folder` names a new one.

    Args:
        env: the task: a Gymnasium id, an environment, which is copied, or a function that makes
            one. The ids of `envs.TASKS` are stepped fastest.
        demonstrations: episodes, flat arrays, a Minari name, a policy: see `demonstrations.of`.
            None: those of the shipped experts, if a reward is learned.
        seeds: how many policies to train, or their seeds.
        folder: where the run is kept.
        options: those of `offairl run`, such as `absorbing="bootstrap"` where episodes can end
            early, `hidden=(256, 256)`, `trajectories=4` or `device="cuda"`.

    Raises:
        TypeError: there is no such option; it names the nearest.
        ValueError: an argument is not valid, or does not fit the task.
    """

    def __init__(
        self,
        env: envs.AnyTask,
        demonstrations: Any = None,
        *,
        seeds: int | Sequence[int] = 3,
        folder: Path_ | None = None,
        **options: Any,
    ) -> None:
        many = seeds if np.ndim(seeds) else range(checked("seeds", seeds, Count))
        self.seeds: tuple[int, ...] = checked("seeds", [*many], tuple[Natural, ...])  # type: ignore
        if not self.seeds:
            raise ValueError("seeds are (); expected at least one")
        known = {field.name for field in fields(RunInputs)}
        chosen = {name: options.pop(name) for name in known & options.keys()}
        for name in inputs.CURES.keys() & chosen:
            several = isinstance(chosen[name], list | tuple)
            chosen[name] = tuple(chosen[name]) if several else (chosen[name],)
        recipe = find("imitate").configs["demo"].change(train_every=1_000, eval_every=10_000)
        for name in {"total_steps", "total_timesteps"} & options.keys():
            raise TypeError(f"{name} are for `learn`: AIRL(...).learn({options[name]})")
        names = known | flat_settings().keys() | EARLIER.keys() | {"seeds", "folder"}
        for name in options.keys() & EARLIER.keys():
            warnings.warn(f"{name} is called {EARLIER[name]}", FutureWarning, stacklevel=2)
        for name in options.keys() - names:
            near = get_close_matches(name, names, 1) or ["one of `offairl run imitate --help`"]
            raise TypeError(f"AIRL has no option {name!r}; did you mean {near[0]}?")
        reward = {name: options[name] for name in ("reward", "learner") if name in options}
        config = recipe.change(**reward).change(total_steps=10**9, **options)
        self.config = config.change(env_id=envs.register(env))
        notes = preflight.try_out(self.config.env_id, self.seeds[0])
        self.run_inputs, episodes = RunInputs(**chosen), demonstrations
        self.run_inputs.require_use([config], RunInputs())
        self.run_inputs.execution(config)  # It says what this machine cannot do.
        few = chosen.get("trajectories"), self.run_inputs.subsample, self.run_inputs.experts
        if config.imitates:
            episodes = self.run_inputs.dataset if episodes is None else episodes
            episodes = data.of(episodes, self.config.env_id, *few)
        elif episodes is not None:
            raise ValueError(f"reward={config.reward!r} has no use for demonstrations: give none")
        self.demonstrations: data.Demonstrations | None = episodes
        self.inherited = inputs.load(config, self.seeds, **self.run_inputs.files)
        for note in notes + preflight.check(self.config, self.seeds, episodes, self.inherited):
            folders.log.warning(note)
        self._place(folder)

    def __fspath__(self) -> str:
        """Return the run's folder, so that a model can be a frozen or a pretrained reward."""
        return str(self.folder)

    def _place(self, folder: Path_ | None) -> None:
        """Choose where the run is kept; a temporary folder goes with the object."""
        if folder is not None and (Path(folder) / "config.json").is_file():
            cure = "go on with a copy, AIRL.load(PATH).learn(10_000), or choose another folder"
            raise FileExistsError(f"{folder} has a run already: {cure}")
        self.folder = Path(folder or mkdtemp(prefix="airl-"))
        if folder is None:
            weakref.finalize(self, shutil.rmtree, self.folder, ignore_errors=True)
        self._run: Run | None = None

    @property
    def run(self) -> Run:
        """The evaluations so far, and the policies and rewards of the last one."""
        if self._run is None:
            if not (self.folder / "config.json").is_file():
                raise ValueError("nothing is learned yet: call learn(100_000) first")
            self._run = records.read(self.folder)
            if self._run.policy is None and self._run.rows:  # It was stopped.
                self._run = records.read(self.folder, self._run.rows[-1].step)
        return self._run

    def learn(self, total_timesteps: int, progress: bool = True) -> "AIRL":
        """Take so many more steps of the task with each seed, and return the object itself.

        1,000 steps and then 1,000 more are the same as 2,000 at once. The first 1,000 are random.
        """
        steps = checked("total_timesteps", total_timesteps, Count)
        if (self.folder / "config.json").is_file():
            folders.extend(self.folder, records.read_state(self.folder)["step"] + steps)
        else:
            config = self.config.change(total_steps=steps)
            shown = inputs.describe(self.demonstrations)
            execution = self.run_inputs.execution(config)
            began = inputs.inherited(self.inherited, self.run_inputs.files, None)
            spec = records.RunSpec(
                config, self.seeds, asdict(execution), shown, CHECKPOINT_EVERY, inherited=began
            )
            folders.create(self.folder, spec, self.inherited, self.demonstrations)
        self._run = None
        before = records.read_state(self.folder)["step"]
        folders.work(self.folder, demonstrations=self.demonstrations, progress=progress)
        every, now = self.config.schedule.train_every, before + steps
        if every and now // every == before // every:
            folders.log.warning(
                f"nothing was learned in these {steps} steps: networks are trained after every "
                f"{every:,}, next at step {(now // every + 1) * every:,} (train_every)"
            )
        return self

    def predict(
        self,
        obs: Any,
        state: None = None,
        episode_start: Any = None,
        deterministic: bool = True,
        *,
        seed: int | None = None,
    ) -> tuple[np.ndarray, None]:
        """Return actions in the task's own units, and None, as Stable-Baselines3 does.

        Args:
            obs: (O,) or (B, O), or a dictionary where the task's is.
            state: not used, as is `episode_start`.
            deterministic: whether actions have no noise: the default here, unlike there.
            seed: whose policy acts; by default that of the first that has not diverged.

        Raises:
            ValueError: nothing is learned yet, there is no such seed, or `obs` does not fit.
        """
        policy, space = self.run.policy, envs.spaces(self.config.env_id)[1]
        if policy is None:
            raise ValueError("there is no policy before the first evaluation: learn for longer")
        noise, obs = None, envs.flatten(self.config.env_id, obs)
        if not deterministic:
            noise = np.random.default_rng().standard_normal((*np.shape(obs)[:-1], *space.shape))
        return act(policy.member(self._member(seed)), obs, space, noise), None

    def reward(self, obs: Any, action: np.ndarray | None = None, *, seed: int | None = None) -> Any:
        """Return the learned reward of (O,), a float, or of each row of (B, O), an array (B,).

        Args:
            obs: in the task's own units, or a dictionary where the task's is.
            action: what is done there, if the reward sees actions, in the task's own units.
            seed: whose reward, as in `predict`.

        Raises:
            ValueError: no reward is learned, there is no such seed, or shapes do not fit.
        """
        if self.run.reward is None:
            why = inputs.why_no_reward(self.config) or "none is learned yet"
            raise ValueError(f"there is no reward: {why}")
        one = self.run.reward.member(self._member(seed))
        in_units = InUnits(one, envs.spaces(self.config.env_id)[1])
        obs = envs.flatten(self.config.env_id, obs)
        rows = [np.asarray(x, np.float32) for x in (obs, action)[: 1 + (action is not None)]]
        if any(x.ndim not in (1, 2) for x in rows):
            raise ValueError(f"shapes are {[x.shape for x in rows]}; expected (O,) or (B, O)")
        values = in_units(*(torch.from_numpy(np.atleast_2d(x)) for x in rows))
        return values.numpy() if rows[0].ndim == 2 else values.item()

    def _member(self, seed: int | None) -> int:
        """Return the number of the member with a seed."""
        left = [s for s in self.seeds if s not in self.run.diverged]
        if seed not in (None, *left) or not left:
            raise ValueError(f"seed is {seed}; there are {left} (diverged: {self.run.diverged})")
        return self.seeds.index(left[0] if seed is None else seed)

    def save(self, path: Path_) -> None:
        """Copy the run, and all that it takes to go on, to a folder; a run there is replaced."""
        if self.run.seeds:  # It says so if nothing is learned yet.
            checkpoints.copy(self.folder, Path(path))

    @classmethod
    def load(
        cls, path: Path_, env: envs.AnyTask | None = None, *, folder: Path_ | None = None
    ) -> "AIRL":
        """Return a copy of what was saved, or of any other run folder.

        Args:
            path: the folder.
            env: the task again, if it is one of your own: an object, or an id with a module.
                Models of the same run that are open go on with it, too.
            folder: where the copy goes on, as for a new model.

        Raises:
            ValueError: the task is needed and not given, or is another one.
        """
        spec = records.RunSpec.read(path)
        own = (name := spec.config.env_id).startswith("airl/")
        if (env is None and (own or ":" in name)) or (isinstance(env, str) and env != name):
            whose = "a task that was given as an object or a function" if own else name
            raise ValueError(f"{path} was trained on {whose}: give that, AIRL.load(path, env)")
        self = cls.__new__(cls)
        self.seeds, self.config, self.folder, self._run = spec.seeds, spec.config, Path(path), None
        task = name if env is None else env
        if (policy := self.run.policy) is not None:
            absorbs = self.config.schedule.absorbing != "none"
            sees = policy.actor.obs_dim - absorbs, policy.actor.action_dim
            has = tuple(space.shape[0] for space in envs.spaces(envs.register(task)))
            if has != sees:
                raise ValueError(f"observations and actions have {has} numbers; {path}'s, {sees}")
        envs.register(task, name)
        self.run_inputs, self.inherited = RunInputs(), {}
        self._place(folder)
        checkpoints.copy(Path(path), self.folder)
        self.demonstrations = None  # Whoever only acts, or asks for rewards, needs none.
        return self
