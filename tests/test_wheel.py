"""What is released can be installed, and works without the clone."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
VERSION = re.search(r'(?m)^version = "(.*)"', (ROOT / "pyproject.toml").read_text())[1]

TRY = """
import sys, importlib.metadata
import offairl_lite
from offairl_lite import AIRL, demonstrations
from offairl_lite.runs import cli
assert offairl_lite.__file__.startswith(sys.argv[1]), offairl_lite.__file__
assert importlib.metadata.version("offairl-lite") == sys.argv[2]
assert len(demonstrations.expert("Hopper-v5")) > 1
cli.main(["list"])
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A folder in which nothing but the wheel is installed."""
    pytest.importorskip("setuptools", minversion="77", reason="pip install 'setuptools>=77'")
    source, wheels, place = (tmp_path_factory.mktemp(name) for name in ("source", "wheel", "place"))
    ignore = shutil.ignore_patterns("__pycache__", "*.egg-info")
    shutil.copytree(ROOT / "offairl_lite", source / "offairl_lite", ignore=ignore)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--no-input"]
    build = ["wheel", "--no-deps", "--no-index", "--no-build-isolation", "-w", wheels, source]
    subprocess.run([*pip, *build], check=True, capture_output=True)
    (wheel,) = wheels.glob("*.whl")
    install = ["install", "--no-deps", "--no-index", "--target", place, wheel]
    subprocess.run([*pip, *install], check=True, capture_output=True)
    return place


def test_the_wheel_works_in_an_empty_folder(installed, tmp_path):
    env = {**os.environ, "PYTHONPATH": str(installed)}
    command = [sys.executable, "-c", TRY, str(installed), VERSION]
    done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "imitate" in done.stdout
    assert "Hopper-v5" in done.stdout


def test_the_wheel_has_the_whole_package_and_nothing_else(installed):
    def files(root):
        found = {path.relative_to(root) for path in root.rglob("*") if path.is_file()}
        return {path for path in found if "__pycache__" not in path.parts}

    assert files(installed / "offairl_lite") == files(ROOT / "offairl_lite")
    there = {path.name for path in installed.iterdir()}
    assert there <= {"offairl_lite", f"offairl_lite-{VERSION}.dist-info", "bin"}


def test_one_version_is_told_everywhere():
    citation = re.search(r"(?m)^version: (.*)$", (ROOT / "CITATION.cff").read_text())[1]
    release = re.search(r"(?m)^## (\S+)", (ROOT / "CHANGELOG.md").read_text())[1]
    assert citation == release == VERSION


def test_a_release_is_told_to_users_in_few_words():
    latest = (ROOT / "CHANGELOG.md").read_text().split("\n## ")[1]
    assert re.findall(r"(?m)^### (\w+)", latest) == ["Added", "Changed", "Fixed", "Removed"]
    assert len(latest.splitlines()) <= 80
