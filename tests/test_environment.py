"""The pinned environment, as a reader's machine sees it."""

import re
import subprocess
import sys
import tomllib
from importlib.metadata import distributions, packages_distributions, requires
from pathlib import Path

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
OLDEST = "3.11.0"
"""What `requires-python` promises; Debian 12 has 3.11.2."""

USE = """
import importlib, pkgutil, sys
hidden = set(sys.argv[1:])

class Hide:
    def find_spec(name, path, target=None):
        if name.partition(".")[0] in hidden:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Hide)
import offairl_lite
for module in pkgutil.walk_packages(offairl_lite.__path__, "offairl_lite."):
    importlib.import_module(module.name)

import gymnasium
for env_id in ("HalfCheetah-v5", "Ant-v5", *(i for i in gymnasium.registry if "offairl/" in i)):
    gymnasium.make(env_id).close()
"""


def wanted(name, extras=(), seen=None):
    """Yield the names of all distributions that come with one, without its extras unless named."""
    seen = set() if seen is None else seen
    if (name := canonicalize_name(name), *extras) in seen:
        return
    seen.add((name, *extras))
    yield name
    for needed in map(Requirement, requires(name) or []):
        at = [{"extra": extra} for extra in ("", *extras)]
        if not needed.marker or any(map(needed.marker.evaluate, at)):
            yield from wanted(needed.name, sorted(needed.extras), seen)


def test_every_package_takes_the_oldest_python_that_is_promised():
    wants = {d.name: d.metadata.get("Requires-Python") for d in distributions()}
    refused = {n: w for n, w in wants.items() if w and not SpecifierSet(w).contains(OLDEST)}
    assert refused == {}
    assert "offairl-lite" in wants


def pinned(file):
    """The versions that a file of constraints names."""
    lines = re.findall(r"^([^#\s]+)==(\S+)$", (ROOT / file).read_text("utf-8"), re.MULTILINE)
    return {canonicalize_name(name): version for name, version in lines}


def test_the_oldest_libraries_that_are_promised_are_those_that_are_tested():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    oldest, newest = pinned("constraints-oldest.txt"), pinned("constraints.txt")
    oldest["mujoco"] = "3.3.0"  # for tasks of other packages; below, without its batches
    for needed in map(Requirement, project["dependencies"]):
        name, allowed = canonicalize_name(needed.name), needed.specifier
        assert f">={oldest[name]}" in map(str, allowed)
        assert allowed.contains(newest[name])


MUJOCO_3 = """
import sys
sys.modules["mujoco.batch"] = None
from offairl_lite import AIRL, envs

env = envs.make("Hopper-v5", 2, seed=0)
assert isinstance(env, envs.SerialEnv)
assert env.reset()[0].shape == (2, 11)
few = dict(trajectories=2, seeds=2, learning_starts=10, train_every=10, hidden=(4,))
assert AIRL("Pendulum-v1", lambda obs: obs[:1], **few).learn(20).run.policy
try:
    envs.make("offairl/PointMazeLeft-v0", 1, seed=0)
except ImportError as error:
    assert "pip install 'mujoco>=4'" in str(error)
else:
    raise AssertionError
"""


def test_tasks_of_other_packages_train_without_the_batches_of_mujoco_4():
    subprocess.run([sys.executable, "-W", "ignore", "-c", MUJOCO_3], check=True)


def test_the_package_does_with_what_it_asks_for():
    """Whatever else is here, for the book or from before, is hidden."""
    there = set(wanted("offairl-lite"))
    modules = packages_distributions()
    hidden = {m for m, names in modules.items() if not there & set(map(canonicalize_name, names))}
    assert {"pytest", "hypothesis"} <= hidden
    subprocess.run([sys.executable, "-W", "ignore", "-c", USE, *hidden], check=True)
