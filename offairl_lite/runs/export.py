"""Policies and rewards for other programs: as ONNX, and as programs of PyTorch."""

import io
import logging
import warnings
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
from gymnasium.spaces import Box
from jaxtyping import Float
from torch import Tensor

from offairl_lite import envs
from offairl_lite.config import CORRECTED
from offairl_lite.core.policies import Policy
from offairl_lite.core.results import Run
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rollouts import require_actions
from offairl_lite.runs import inputs, records

ABOUT = """\
From {source}, trained on {env_id}.

{each}

Arrays are float32, with any number of rows. Observations are as the task gives them{order}. Actions
are in its own units, from {low} to {high}.
"""
ONNX = """
The {kind}, with ONNX Runtime:

    import numpy as np, onnxruntime
    session = onnxruntime.InferenceSession("{file}.onnx")
    ({gives},) = session.run(None, {{{arrays}}})
"""
TORCH = """
The {kind}, with PyTorch:

    import torch
    program = torch.export.load("{file}.pt2").module()
    {gives} = program({tensors})
"""
ABSORBING = "\nWhere an episode terminates, add {rest:.6g} to reward-{i}, at a discount of 0.99.\n"
GIVES = {"policy": "action", "reward": "reward"}  #: What the output of each is called.


class InUnits(torch.nn.Module):
    """A policy or a reward of one member, with the actions of `space`: a task's own."""

    def __init__(self, thing: Policy | Reward, space: Box) -> None:
        super().__init__()
        self.thing = thing
        self.low, self.high = (torch.tensor(x).float() for x in (space.low, space.high))

    def forward(
        self, obs: Float[Tensor, "B O"], action: Float[Tensor, "B A"] | None = None
    ) -> Float[Tensor, "B *A"]:
        """Return a policy's modes, as `core.rollouts.action` does, or the reward of each row."""
        if isinstance(self.thing, Policy):
            unit = self.thing.act(obs[None])[0]
            return (self.low + (unit + 1) / 2 * (self.high - self.low)).clamp(self.low, self.high)
        if action is not None:
            action = ((action - self.low) / (self.high - self.low) * 2 - 1)[None]
        return self.thing(obs[None], action)[0]


def export(
    source: Path,
    out: Path,
    member: int | None = None,
    step: int | None = None,
    env_id: str | None = None,
) -> list[str]:
    """Write the policy and the reward of each member, or of one, to files of their own.

    They are `policy-0.onnx`, `policy-0.pt2`, `reward-0.onnx` and so on, after the member's number;
    README.txt tells how to load them. Files that have these names are overwritten.

    Args:
        source: a run's folder, or the file of a policy on its task, or on `env_id`.
        out: the folder for the files.
        member: which one; None for all that have not diverged.
        step: of the run's evaluation; None for its end.
        env_id: another task than the one that a policy's file names.

    Returns:
        What was left out, and why.

    Raises:
        FileNotFoundError: the run has not ended.
        ValueError: there is no such member, it has diverged, or it does not fit the task.
    """
    run, without = _read(source, step, env_id)
    records.beginning(out)  # It says that a file is in the way.
    members, notes = _members(run, source, member)
    if run.policy is run.reward is None:
        inputs.load_one(source, Policy)  # It says what to do.
    env_id = run.config.env_id
    box, space = envs.spaces(env_id)
    if run.policy is not None:
        require_actions(run.policy, space)
        run.policy.act(torch.zeros(1, 1, *box.shape))  # It says whether observations fit.
    instructions = ONNX + TORCH
    if find_spec("onnxscript") is None:
        instructions = TORCH
        cure = "pip install onnx onnxscript, and give the command again"
        notes.append(f"ONNX is not installed, so there are programs of PyTorch alone: {cure}")
    ends = {
        r.seed: f": seed {r.seed}, return {r.mean_return:.4g} at step {r.step:,}" for r in run.rows
    }
    lines = "\n".join(f"Member {i}{ends.get(run.seeds[i], '')}" for i in members)
    low, high = space.low.tolist(), space.high.tolist()
    order = f", in the order {', '.join(parts)}" if (parts := envs.parts(env_id)) else ""
    text = ABOUT.format(source=source, env_id=env_id, each=lines, order=order, low=low, high=high)
    out.mkdir(parents=True, exist_ok=True)
    for kind, network in (("policy", run.policy), ("reward", run.reward)):
        if network is None:
            why = (kind == "reward" and without) or "its file is not there"
            notes.append(f"{source} has no {kind} to export: {why}")
            continue
        sizes = {"obs": box.shape[0], "action": space.shape[0]}
        if isinstance(network, Policy) or network.state_only:
            del sizes["action"]
        if isinstance(network, Reward) and network.normaliser.mean.shape[-1] > box.shape[0]:
            absorbing = torch.eye(box.shape[0] + 1)[-1].expand(len(network), 1, -1)
            rest = 99 * network(absorbing, torch.zeros(len(network), 1, space.shape[0]))[:, 0]
            text += "".join(ABSORBING.format(i=i, rest=rest[i].item()) for i in members)
        for i in members:
            _write(network.member(i), space, sizes, GIVES[kind], out / f"{kind}-{i}")
        arrays = ", ".join(f'"{name}": np.zeros((1, {n}), np.float32)' for name, n in sizes.items())
        tensors = ", ".join(f"torch.zeros(1, {n})" for n in sizes.values())
        file = f"{kind}-{members[0]}"
        names = {"kind": kind, "file": file, "gives": GIVES[kind]}
        text += instructions.format(**names, arrays=arrays, tensors=tensors)
    (out / "README.txt").write_text(text, "utf-8")
    return notes


def _read(source: Path, step: int | None, env_id: str | None) -> tuple[Run, str | None]:
    """Return a run, or a policy's file as one, and why it has no reward, if so."""
    if not source.is_file():
        run = records.read(source, step)
        return run, inputs.why_no_reward(run.config)
    policy = inputs.load_one(source, Policy, step)
    config = CORRECTED.change(env_id=env_id or policy.env_id)
    return Run(config, tuple(range(len(policy))), policy=policy), "it is the file of a policy"


def _members(run: Run, source: Path, member: int | None) -> tuple[list[int], list[str]]:
    """Return the members that can be exported, of all or of one, and why others cannot."""
    count = len(run.seeds)
    if member is not None and not 0 <= member < count:
        raise ValueError(f"member is {member}; {source} has members 0 to {count - 1}")
    members = range(count) if member is None else [member]
    failed = {i: run.diverged[run.seeds[i]] for i in members if run.seeds[i] in run.diverged}
    notes = [f"member {i} of {source} cannot be exported: {why}" for i, why in failed.items()]
    if len(failed) == len(members):
        raise ValueError("; ".join(notes))
    return [i for i in members if i not in failed], notes


def _write(
    network: Policy | Reward, space: Box, sizes: dict[str, int], gives: str, path: Path
) -> None:
    """Write one member as a program of PyTorch and, where it is installed, as ONNX."""
    example = tuple(torch.zeros(2, n) for n in sizes.values())
    rows = {name: {0: torch.export.Dim("rows")} for name in sizes}
    logging.disable(logging.WARNING)  # The exporters speak of packages that nobody needs here.
    try:
        with warnings.catch_warnings(action="ignore"):
            module = InUnits(network, space)
            program = torch.export.export(module, example, dynamic_shapes=rows)
            torch.export.save(program, whole := io.BytesIO())  # On a full disk it would crash.
            path.with_suffix(".pt2").write_bytes(whole.getbuffer())
            if find_spec("onnxscript") is not None:
                file, names = path.with_suffix(".onnx"), [*sizes]
                options: Any = {"input_names": names, "output_names": [gives], "verbose": False}
                torch.onnx.export(program, f=file, external_data=False, **options)
    finally:
        logging.disable(logging.NOTSET)
