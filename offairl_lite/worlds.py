r"""Off-policy AIRL in several worlds at once, with one reward for all of them.

The worlds have the same observations and actions, but other dynamics. An expert that wants the same
in all of them demonstrates each. World i has a value V_i, a policy, a replay and demonstrations of
its own, and all share r: with a minibatch of each world, a step goes down the sum of the losses

$$\sum_i \mathcal{L}(r_\psi + \gamma V_i(s') - V_i(s) - \log \pi_i)$$

in r and in all V_i. If the worlds took turns instead, r would lean to the one that came last.

A reward of one world may hide a shaping of that world. In two worlds that differ enough it cannot
(Cao, Cohen and Szpruch 2021; `tabular.identification`). Here f sees one next state, not the mean
over all, so it fits deterministic worlds.
"""

from collections.abc import Sequence
from contextlib import ExitStack

import torch
from tqdm.auto import tqdm

from offairl_lite.config import Config
from offairl_lite.core.acceleration import Execution
from offairl_lite.core.discriminator import Discriminator, Mixing, Transitions
from offairl_lite.core.experience import Experience
from offairl_lite.core.learner import log_density
from offairl_lite.core.loop import Trainer
from offairl_lite.core.networks import Normaliser, optimizer_states
from offairl_lite.core.results import Run
from offairl_lite.core.rewards import IMPLEMENTATIONS
from offairl_lite.core.shapes import Metrics
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.envs import spaces


class World(Trainer):
    """One of several worlds: a `Trainer` that leaves its training to `Worlds`."""

    together: "Worlds"
    steps_due = 0
    """Length of the block of steps that is to be trained on now."""

    def start(self) -> None:
        """End the warm-up of all worlds."""
        self.together.start()

    def train_on_block(self, steps: int) -> None:
        """Wait for the other worlds."""
        self.steps_due = steps


class Worlds:
    """W worlds with one reward for each seed. For arguments and errors see `train`."""

    def __init__(
        self,
        config: Config,
        seeds: Sequence[int],
        demonstrations: Sequence[Demonstrations],
        execution: Execution = Execution(),  # noqa: B008
    ) -> None:
        require_worlds(config, demonstrations)
        self.worlds: list[World] = []
        self.discriminators: list[Discriminator] = []
        try:
            for shown in demonstrations:
                there = config.change(env_id=shown.env_id)
                self.worlds.append(World(there, seeds, shown, execution=execution))
                self._share(self.worlds[-1])
        except ValueError:
            self.close()
            raise
        settings = self.discriminators[0].config
        hidden = settings.reward_hidden + settings.shaping_hidden
        self.update = execution.accelerate(self._update, hidden)

    def _share(self, world: World) -> None:
        """Give a world the reward of the first."""
        own = world.discriminator
        assert own is not None  # `require_worlds` has seen to it.
        self.discriminators.append(own)
        first = self.discriminators[0]
        own.reward_params, own.reward_optimizer = first.reward_params, first.reward_optimizer
        own.state = optimizer_states(reward=own.reward_optimizer, value=own.value_optimizer)
        world.together, world.members.weights = self, world.weights()

    def start(self) -> None:
        """End the warm-up of all worlds, and scale observations alike: by what all have seen."""
        if len({world.steps for world in self.worlds}) > 1:
            raise ValueError(f"the worlds' warm-ups must end together: {_TOGETHER}")
        for world in self.worlds:
            Trainer.start(world)
        common = mixture([world.normaliser for world in self.worlds])
        for world in self.worlds:
            for part, fixed in zip(world.normaliser, common, strict=True):
                part.copy_(fixed)

    def run(self, progress: bool = False) -> list[Run]:
        """Take all worlds to their end; return the results of each."""
        runs = [Run(w.config, w.seeds, diverged=w.members.diverged) for w in self.worlds]
        first = self.worlds[0]
        with tqdm(total=first.config.total_steps, unit="step", disable=not progress) as bar:
            for rows in zip(*(world.run() for world in self.worlds), strict=True):
                due = {world.steps_due for world in self.worlds}
                if len(due) > 1:
                    raise ValueError(f"the worlds' blocks of steps must end together: {_TOGETHER}")
                if steps := due.pop():
                    self.train_on_block(steps)
                for run, new in zip(runs, rows, strict=True):
                    run.rows += new
                bar.update(first.trained - bar.n)
        for run, world in zip(runs, self.worlds, strict=True):
            run.policy, run.reward = world.policy, world.reward
        return runs

    def train_on_block(self, steps: int) -> None:
        """Update all discriminators, and then all learners, once for each step of a block."""
        experiences = [
            Experience(
                world.config,
                world.collector.replay,
                world.demonstrations,
                world.normaliser,
                world.rng,
                world.discriminator,
                log_density(world.config, world.learner, world.steps),
            )
            for world in self.worlds
        ]
        drawn = (experience.discriminator_minibatches(steps) for experience in experiences)
        for minibatches in zip(*drawn, strict=True):
            for name, value in self.update(*minibatches).items():
                world_index, _, metric = name.partition(".")
                self.worlds[int(world_index)].metrics[metric] = value
        for world, experience in zip(self.worlds, experiences, strict=True):
            for update in world.learner.minibatches(experience, steps, world.trained - steps):
                world.metrics |= world.update_learner(*update)
            world.steps_due = 0
            world.members.give_up_not_finite(world.steps)
        lost = {seed for world in self.worlds for seed in world.members.diverged}
        for world in self.worlds:
            twins = torch.tensor([seed in lost for seed in world.seeds])
            world.members.give_up(twins, world.steps, "twin in another world has diverged")

    def _update(self, *minibatches: tuple[Transitions, Transitions, Mixing]) -> Metrics:
        """Take one step down the sum of all worlds' losses.

        The reward steps by the mean of its gradients. To Adam their sum is the same, but so twice
        the same world gives the numbers of that world alone.
        """
        reward, gradients = self.discriminators[0].reward_optimizer, []
        metrics: Metrics = {}
        for i, (own, minibatch) in enumerate(zip(self.discriminators, minibatches, strict=True)):
            loss, diagnostics = own.loss(*minibatch)
            weights = own.reward_params, own.value_params
            of_reward, of_value = torch.autograd.grad(loss, weights)
            own.value_optimizer.step(of_value)
            gradients.append(of_reward)
            metrics |= {f"{i}.{name}": value for name, value in diagnostics.items()}
        reward.step(torch.stack(gradients).mean(0))
        return metrics

    def close(self) -> None:
        """Close the environments."""
        for world in self.worlds:
            world.close()


_TOGETHER = "set train_every to a number of steps that divides learning_starts"


def train(
    config: Config,
    seeds: Sequence[int],
    demonstrations: Sequence[Demonstrations],
    *,
    execution: Execution = Execution(),  # noqa: B008
    progress: bool = True,
) -> list[Run]:
    """Learn one reward from demonstrations of W worlds; return a run for each world.

    All runs have this reward: `runs[0].reward.save(path)` keeps it, and `core.loop.train`, or
    `offairl run imitate --reward frozen`, pays a new policy with it in another world.

    Args:
        config: of every world, but for `env_id`; it has an AIRL reward without an ablation.
        seeds: one for each member, in every world.
        demonstrations: of each world, whose task they name.
        execution: see `Trainer`.
        progress: whether a bar is shown.

    Raises:
        ValueError: there are fewer than two worlds, their observations or actions differ, their
            blocks of steps end at different times, or `config` does not fit.
        FloatingPointError: all members have diverged.
    """
    with ExitStack() as afterwards:
        afterwards.callback(torch.set_num_threads, torch.get_num_threads())
        worlds = Worlds(config, seeds, demonstrations, execution)
        afterwards.callback(worlds.close)
        return worlds.run(progress)


def mixture(scalings: Sequence[Normaliser]) -> Normaliser:
    """Return the scaling of an even mixture of what several scalings are of."""
    mean = torch.stack([each.mean for each in scalings]).mean(0)
    squares = [each.std.square() + (each.mean - mean).square() for each in scalings]
    return Normaliser(mean, torch.stack(squares).mean(0).sqrt())


def require_worlds(config: Config, demonstrations: Sequence[Demonstrations]) -> None:
    """Raise ValueError unless one reward can be learned from these worlds."""
    flat = config.flat()
    if config.reward not in IMPLEMENTATIONS or flat["ablation"]:
        names = ", ".join(IMPLEMENTATIONS)
        raise ValueError(f"reward is {config.reward!r}; worlds share {names}, without an ablation")
    if len(demonstrations) < 2:
        raise ValueError("give demonstrations of two worlds at least; for one use core.loop.train")
    first, *others = (
        (shown.env_id, [box.shape for box in spaces(shown.env_id)]) for shown in demonstrations
    )
    for env_id, shapes in others:
        if shapes != first[1]:
            pair = f"{first[0]} has the shapes {first[1]}, and {env_id} {shapes}"
            raise ValueError(f"worlds must have the same observations and actions: {pair}")
