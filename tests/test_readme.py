"""What the README and the front page tell readers to type, with runs that take a second."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from offairl_lite import experiments
from offairl_lite.runs import cli

ROOT = Path(__file__).parents[1]
PAGES = ["README.md", "book/index.md", "book/running_at_scale.md", "CONTRIBUTING.md"]


def blocks(page):
    """All Python of a page, which is one program: later blocks use names of earlier ones."""
    return "\n".join(re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.DOTALL))


@pytest.mark.parametrize("page", ["README.md", "book/index.md"])
def test_python_runs(page, tiny, write_dataset, shipped_experts, tmp_path, monkeypatch):
    write_dataset("pendulum/mine-v0", episodes=50)
    short = replace(experiments.find("imitate"), configs={"demo": tiny})
    monkeypatch.setattr(experiments, "find", lambda name: short)
    monkeypatch.chdir(tmp_path)
    exec(blocks(page), {})
    assert (tmp_path / "reward.safetensors").exists()


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
