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
from functools import partial

import torch
from tqdm.auto import tqdm

from offairl_lite.config import Config
from offairl_lite.core.acceleration import Execution
from offairl_lite.core.discriminator import Discriminator, Mixing, Transitions
from offairl_lite.core.loop import Trainer
from offairl_lite.core.networks import Normaliser, states_of
from offairl_lite.core.results import Run
from offairl_lite.core.rewards import IMPLEMENTATIONS
from offairl_lite.core.shapes import Metrics
from offairl_lite.demonstrations import Demonstrations
from offairl_lite.envs import spaces

_CURE = "set train_every to a number of steps that divides learning_starts"


class World(Trainer):
    """One of several worlds: a `Trainer` that leaves its training to `Worlds`."""

    together: "Worlds"
    steps_due = 0  # Length of the block of steps that is to be trained on now.

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
                world = World(there, seeds, shown, execution=execution)
                assert world.discriminator is not None  # `require_worlds` has seen to it.
                self.worlds.append(world)
                self.discriminators.append(world.discriminator)
                share(*self.discriminators)
                world.together, world.members.weights = self, world.weights()
        except ValueError:
            self.close()
            raise
        hidden = config.flat()["reward_hidden"]
        self.update = execution.accelerate(partial(update, self.discriminators), hidden)

    def start(self) -> None:
        """End the warm-up of all worlds, and scale observations alike: by what all have seen."""
        if len({world.steps for world in self.worlds}) > 1:
            raise ValueError(f"the worlds' warm-ups end at different times: {_CURE}")
        for world in self.worlds:
            Trainer.start(world)
        common = mixture([world.normaliser for world in self.worlds])
        for world in self.worlds:
            for part, fixed in zip(world.normaliser, common, strict=True):
                part.copy_(fixed)

    def run(self, progress: bool = False) -> list[Run]:
        """Take all worlds to their end; return the results of each."""
        runs, first = [Run(w.config, w.seeds) for w in self.worlds], self.worlds[0]
        with tqdm(total=first.config.total_steps, unit="step", disable=not progress) as bar:
            for rows in zip(*(world.run() for world in self.worlds), strict=True):
                if len(due := {world.steps_due for world in self.worlds}) > 1:
                    raise ValueError(f"the worlds' blocks end at different times: {_CURE}")
                if steps := due.pop():
                    self.train_on_block(steps)
                for run, new in zip(runs, rows, strict=True):
                    run.rows += new
                bar.update(first.trained - bar.n)
        for run, world in zip(runs, self.worlds, strict=True):
            run.policy, run.reward = world.policy, world.reward
            run.diverged = world.members.diverged
        return runs

    def train_on_block(self, steps: int) -> None:
        """Update all discriminators, and then all learners, once for each step of a block."""
        experiences = [world.experience() for world in self.worlds]
        drawn = zip(*(each.discriminator_minibatches(steps) for each in experiences), strict=True)
        for minibatches in drawn:
            for name, value in self.update(*minibatches).items():
                index, _, metric = name.partition(".")
                self.worlds[int(index)].metrics[metric] = value
        for world, experience in zip(self.worlds, experiences, strict=True):
            for minibatch in world.learner.minibatches(experience, steps, world.trained - steps):
                world.metrics |= world.update_learner(*minibatch)
            world.steps_due = 0
            world.members.give_up_not_finite(world.steps)
        lost = {seed for world in self.worlds for seed in world.members.diverged}
        for world in self.worlds:
            twins = torch.tensor([seed in lost for seed in world.seeds])
            world.members.give_up(twins, world.steps, "twin in another world has diverged")

    def close(self) -> None:
        """Close the environments."""
        for world in self.worlds:
            world.close()


def share(first: Discriminator, *others: Discriminator) -> None:
    """Let all have the reward of the first, and its optimizer's state."""
    for each in others:
        each.reward_params, each.reward_optimizer = first.reward_params, first.reward_optimizer
        each.state = states_of(reward=first.reward_optimizer, value=each.value_optimizer)


def update(
    discriminators: Sequence[Discriminator], *minibatches: tuple[Transitions, Transitions, Mixing]
) -> Metrics:
    """Take one step down the sum of the losses of discriminators that share a reward.

    The reward steps by the mean of its gradients. To Adam their sum is the same, but so twice the
    same world gives the numbers of that world alone.
    """
    gradients = []
    metrics: Metrics = {}
    for i, (own, minibatch) in enumerate(zip(discriminators, minibatches, strict=True)):
        loss, diagnostics = own.loss(*minibatch)
        of_reward, of_value = torch.autograd.grad(loss, (own.reward_params, own.value_params))
        own.value_optimizer.step(of_value)
        gradients.append(of_reward)
        metrics |= {f"{i}.{name}": value for name, value in diagnostics.items()}
    discriminators[0].reward_optimizer.step(torch.stack(gradients).mean(0))
    return metrics


def train(
    config: Config,
    seeds: Sequence[int],
    demonstrations: Sequence[Demonstrations],
    *,
    execution: Execution = Execution(),  # noqa: B008
    progress: bool = True,
) -> list[Run]:
    """Learn one reward from demonstrations of W worlds; return a run for each world.

    All runs have this reward. `runs[0].reward.save(path)` keeps it, and `core.loop.train`, or
    `offairl run imitate --reward frozen`, pays a new policy with it in another world.

    Args:
        config: of every world, but for `env_id`.
        seeds: one for each member, in every world.
        demonstrations: of each world.
        execution: where, and how, it is computed.
        progress: whether a bar is shown.

    Raises:
        ValueError: fewer than two worlds, or their spaces, ends of blocks or `config` do not fit.
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
    if config.reward not in IMPLEMENTATIONS or config.flat()["ablation"]:
        names = ", ".join(IMPLEMENTATIONS)
        raise ValueError(f"reward is {config.reward!r}; worlds share {names}, without an ablation")
    if len(demonstrations) < 2:
        raise ValueError("give demonstrations of two worlds at least; for one use core.loop.train")
    ids = [shown.env_id for shown in demonstrations]
    shapes = {env_id: [box.shape for box in spaces(env_id)] for env_id in ids}
    if any(each != shapes[ids[0]] for each in shapes.values()):
        raise ValueError(f"worlds must have the same observations and actions, not {shapes}")
