"""Arguments in the package, options on the command line, and nobody sees the other's."""

import ast
import inspect
import logging
import re
import warnings
from dataclasses import fields
from pathlib import Path

import pytest

import offairl_lite
from offairl_lite.config import flat_settings
from offairl_lite.runs import bench, cli, launch, messages

ROOT = Path(offairl_lite.__file__).parent
COMMANDS = (
    cli.list_experiments, cli.demos, cli.clone, cli.watch, cli.tensorboard, cli.export, cli.verify,
    cli.bench, launch.resume, launch.run_command("imitate", "demo"),
)  # fmt: skip


@pytest.mark.parametrize(
    ("said", "here"),
    [
        ("total_steps is -1; expected a number", "--total-steps is -1; expected a number"),
        ("hidden is 3; expected a tuple", "--hidden is 3; expected a tuple"),
        ("loss has no use with learner='sac'", "--loss has no use with --learner sac"),
        ("set guide_steps=0.", "set --guide-steps 0."),
        ("seeds=(0, 1), or seeds=(0,)", "--seeds 0 1, or --seeds 0"),
        ("log_prob_in_reward=False and normalise=True", "--no-log-prob-in-reward and --normalise"),
        ("grid=temperature=0.1,0.2: expected", "--grid temperature=0.1,0.2: expected"),
        ("give env_id= and dataset=", "give --env-id and --dataset"),
        ("nothing was trained; raise total_steps", "nothing was trained; raise --total-steps"),
        ("its hidden layers, the seeds and a reward", None),
        ("gymnasium.register(..., max_episode_steps=1000)", None),
        ("runs/x/temperature=0.1,reward=dac is gone", None),
        ("runs/x/frozen_reward.safetensors, frozen_reward.safetensors", None),
        ("`offairl resume x --env-id my:Arm-v0` goes on", None),
    ],
)
def test_arguments_become_options_and_words_stay(said, here):
    assert messages.in_options(said) == (here or said)


def test_the_names_are_those_of_all_options():
    names = {name for command in COMMANDS for name in inspect.signature(command).parameters}
    names |= {field.name for kind in (launch.RunInputs, bench.Options) for field in fields(kind)}
    groups = {"run_inputs", "options", "schedule", "learner", "discriminator"}
    positional = {"experiment", "name", "source", "folder", "run", "record"}
    settings = names & flat_settings().keys()
    assert names - groups - positional == {*messages.OTHERS} | settings - groups


def test_warnings_and_the_log_are_translated_on_the_command_line_alone(capsys, monkeypatch):
    log, show = logging.getLogger("alone"), warnings.formatwarning
    log.propagate = False  # As without pytest, which has handlers of its own.
    with messages.one_line():
        log.warning("set %s=1000", "train_every")
        assert "raise --total-steps" in warnings.formatwarning(
            "raise total_steps", UserWarning, "f", 1
        )
    log.warning("set train_every=1000")
    assert capsys.readouterr().err.splitlines() == [
        "set --train-every 1000",
        "set train_every=1000",
    ]
    assert warnings.formatwarning is show
    error = ValueError("hidden is 3")
    error.add_note("raise total_steps")
    match = "offairl: --hidden is 3; raise --total-steps"
    with pytest.raises(SystemExit, match=match), messages.one_line():
        raise error


def texts(tree):
    """The strings of a module that are no docstrings, those of one f-string put together."""
    seen = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if id(node) in seen:
            continue
        if isinstance(node, ast.JoinedStr):
            seen |= {id(part) for part in ast.walk(node)}
            yield "".join(
                part.value if isinstance(part, ast.Constant) else "X" for part in node.values
            )
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


@pytest.mark.parametrize("path", sorted(ROOT.rglob("*.py")), ids=lambda path: path.stem)
def test_no_message_names_an_option_but_in_a_whole_command(path):
    if path.name == "cli.py":
        return
    options = {*messages.OTHERS, *flat_settings()}
    for text in texts(ast.parse(path.read_text("utf-8"))):
        rest = re.sub(r"`offairl [^`]*(`|$)", "", text)
        named = {name.replace("-", "_") for name in re.findall(r"--([a-z][a-z-]*)", rest)}
        assert not named & options, text
