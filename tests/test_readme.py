"""What the README and the front page tell readers to type."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from offairl_lite import experiments
from offairl_lite.runs import cli, records

ROOT = Path(__file__).parents[1]
PAGES = [
    "README.md",
    "book/recipe_example.md",
    "book/index.md",
    "book/running_at_scale.md",
    "CONTRIBUTING.md",
]


def steps(text):
    """Every Python block and every `offairl` line of a page, in order, with the text before it."""
    command = r"^ {4}(?P<command>offairl (?:[^\n]*\\\n)*[^\n]*)$"  # lines that end in \ go on
    pattern = rf"```python\n(?P<python>.*?)```|{command}"
    end = 0
    for match in re.finditer(pattern, text, re.DOTALL | re.MULTILINE):
        before, end = text[end : match.start()], match.end()
        code = match[match.lastgroup].replace("\\\n", " ")
        yield match.lastgroup, re.sub(r"\s+#.*", "", code), before


def test_steps_are_found_in_order():
    text = "Do `this`:\n```python\nx = 1\n```\n\n    offairl list  # all\n    offairl \\\n  bench\n"
    assert [(kind, code) for kind, code, _ in steps(text)] == [
        ("python", "x = 1\n"),
        ("command", "offairl list"),
        ("command", "offairl    bench"),
    ]


def follow(text, folder):
    """Do everything that a page says to type, in order; what each step has printed."""
    bin_ = Path(sys.executable).parent
    env = {
        **os.environ,
        "PATH": f"{bin_}{os.pathsep}{os.environ['PATH']}",
        "MINARI_DATASETS_PATH": str(folder / "minari"),
        "OMP_NUM_THREADS": "1",
    }
    printed = {}
    for kind, code, before in steps(text):
        saved = re.search(r"[Ss]ave (?:it|this)[^`]* as `(\S+)`[^`]*:\s*$", before)
        if saved:
            (folder / saved[1]).write_text(code)
            continue
        command = [sys.executable, "-c", code] if kind == "python" else shlex.split(code)
        done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True)
        assert done.returncode == 0, f"{code}\n{done.stderr}"
        printed[code] = done.stdout
    return printed


def test_the_readme_s_lines_run(tmp_path):
    """With fewer steps."""
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 120
    ((code, printed),) = follow(text.replace("100_000", "1_100"), tmp_path).items()
    assert len(code.strip().splitlines()) <= 7
    assert len(printed.splitlines()) == 2
    assert len(records.read(tmp_path / "hopper").seeds) == 3


def test_the_example_from_an_empty_folder(tmp_path):
    """Literally, and the returns that it promises, as nearly as another processor gives them."""
    page = (ROOT / "book/recipe_example.md").read_text()
    printed = follow(page, tmp_path)
    number = r"(?m)^ +\d +5,000 +(-[\d.]+)$|, *\n?return (-[\d.]+)"
    promised, found = (
        [float(a or b) for a, b in re.findall(number, text)]
        for text in (page, "".join(printed.values()))
    )
    assert len(promised) == 11
    for said, done in zip(promised, found, strict=True):
        assert abs(said - done) < max(3, 0.1 * abs(said))
    (old,) = (text for code, text in printed.items() if code.startswith("offairl demos my_robot:S"))
    assert float(re.search(r"return ([-−.\d]+)", old)[1]) < -120
    final = records.read(tmp_path / "runs/swapped").returns[:, -1]
    assert ((final > -9) & (final < -4)).all()


def test_the_mazes_of_chapter_9_in_numbers(tmp_path, monkeypatch, capsys):
    """Its two commands print what is shown, as nearly as another processor gives it."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    monkeypatch.chdir(ROOT)
    cells = json.loads((ROOT / "book/09_transfer.ipynb").read_text("utf-8"))["cells"]
    (text,) = ("".join(c["source"]) for c in cells if "{admonition} Try it" in "".join(c["source"]))
    lines = text.replace("\\\n", " ").splitlines()
    for command in (line for line in lines if line.startswith("offairl demos")):
        cli.main(shlex.split(command)[1:])
    returns = r"return (-[\d.]+)"
    said, found = (re.findall(returns, each) for each in (text, capsys.readouterr().out))
    assert len(said) == len(found) == 2
    for one, other in zip(said, found, strict=True):
        assert abs(float(one) - float(other)) < 3


def test_the_front_page_has_the_readme_s_lines():
    (ours,), (theirs,) = (
        [code for kind, code, _ in steps((ROOT / page).read_text()) if kind == "python"]
        for page in ("book/index.md", "README.md")
    )
    assert ours == theirs


@pytest.mark.parametrize("page", PAGES)
def test_commands_and_their_options_exist(page, capsys):
    text = (ROOT / page).read_text()
    found = re.findall(r"(?m)^ {4}(?:\.venv/bin/)?offairl (.*)$", text)
    found += re.findall(r"`(?:\.venv/bin/)?offairl ([a-z][^`\n]*)`", text)
    assert found or page == "book/index.md"
    for line in found:
        command, *options = re.sub(r"\s+#.*", "", line).split()
        name = [option for option in options[:1] if option in experiments.EXPERIMENTS]
        with pytest.raises(SystemExit) as stop:
            cli.main([command, *name, "--help"])
        assert stop.value.code in (0, None), line
        shown = capsys.readouterr().out
        for option in options:
            assert not option.startswith("--") or option in shown, line


def test_a_clone_of_the_maze_and_its_moved_wall(tmp_path, monkeypatch, capsys):
    """The recipe's two commands print what is shown, as nearly as another processor gives it."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "book/recipe.md").read_text()
    text = page[page.index("{admonition} Try it") :].split("\n:::")[0].replace("\\\n", " ")
    for command in re.findall(r"(?m)^offairl (.*)$", text):
        cli.main(shlex.split(command))
    returns = r"return (-[\d.]+)|seed \d: (-[\d.]+)"
    said, found = (
        [float(a or b) for a, b in re.findall(returns, each)]
        for each in (text, capsys.readouterr().out)
    )
    assert len(said) == len(found) == 5
    assert all(abs(one - other) < 3 for one, other in zip(said, found, strict=True))
