"""What the command line says: in its own words, and in one line.

The messages of the package name arguments, `total_steps=1000`, which are options here,
`--total-steps 1000`. A command in backquotes may be typed by whoever reads it.
"""

import errno
import logging
import os
import re
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import gymnasium
import torch

from offairl_lite.config import flat_settings
from offairl_lite.runs import jobs

OTHERS = """
absorbing_state address against compile dataset device engine env_id eval_episodes experts follow
frozen_reward grid guide hidden json max_steps member only out policy populations prepare
pretrained_policy pretrained_reward processes rounds scale seconds seed seeds step steps subsample
threads times trajectories
""".split()  # noqa: SIM905
"""The options that are no settings of a run."""


def in_options(text: str) -> str:
    """Return a message with options in the place of arguments.

    A name without an underscore may be a word as well: it is an argument before `=`, and as the
    first word of a message that says what it is.
    """
    names = {*OTHERS, *flat_settings()}
    plain, long = ("|".join(n for n in names if ("_" in n) == is_long) for is_long in (False, True))
    value = r"=('[^']*'|\([^)]*\)|[^\s,;:)]*[^\s,;:.)]|)"
    first = rf"\A({plain}|{long})(?= (?:is|are|has no use) )"
    pattern = rf"{first}|(?<![\w./,=-])(?:({plain}|{long}){value}|({long})(?![\w.]*\w))"
    return re.sub(pattern, _option, text)


def _option(match: re.Match) -> str:
    """Return an argument, and its value if it has one, as on the command line."""
    first, name, value, bare = match.groups()
    option = (first or name or bare).replace("_", "-")
    if value in ("True", "False"):
        return f"--{'no-' * (value == 'False')}{option}"
    words = re.sub(r"[(),']", " ", value or "").split()
    return " ".join([f"--{option}", *words])


@contextmanager
def _in_options() -> Iterator[None]:
    """Let warnings and the log name options, too."""
    form, formatter = warnings.formatwarning, logging.Formatter()
    formatter.format = lambda record: in_options(record.getMessage())  # type: ignore[method-assign]
    warnings.formatwarning = lambda *about, **line: in_options(form(*about, **line))
    last = logging.lastResort or logging.NullHandler()
    last.setFormatter(formatter)
    try:
        yield
    finally:
        warnings.formatwarning = form
        last.setFormatter(None)


def note(text: str) -> None:
    """Tell a user what may matter."""
    print(f"note: {in_options(text)}", file=sys.stderr)


@contextmanager
def one_line() -> Iterator[None]:
    """End the process with one line, in the place of a traceback, about what a user can mend."""
    try:
        with jobs.terminable(), _in_options():
            yield
    except KeyboardInterrupt:
        sys.exit("offairl: stopped")
    except BrokenPipeError:  # of `offairl list | head`, which has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except Exception as error:
        known = ValueError, OSError, ImportError, FloatingPointError, gymnasium.error.Error
        why = str(error)
        if _lacks_memory(error):
            cure = "lower batch_size or replay_size; smaller networks, fewer seeds or processes"
            why = f"there is not enough memory: {cure}"
        elif not isinstance(error, known):
            raise
        elif getattr(error, "errno", None) in (errno.ENOSPC, errno.EDQUOT):
            why = "the disk is full: free some of it"
        why = "; ".join([why, *getattr(error, "__notes__", ())])
        sys.exit(f"offairl: {in_options(why)}")


def _lacks_memory(error: Exception) -> bool:
    """Tell whether memory is what is missing; PyTorch has no type of its own for that on a CPU."""
    if isinstance(error, OSError):
        return error.errno == errno.ENOMEM
    known = isinstance(error, MemoryError | torch.OutOfMemoryError)
    return known or (type(error) is RuntimeError and "DefaultCPUAllocator" in str(error))
