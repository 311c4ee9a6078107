"""The appendices: what they name exists, and the API reference has all of the package."""

import importlib.util
import inspect
import pkgutil
import re
from importlib import import_module
from pathlib import Path
from typing import get_args

import pytest
from bs4 import BeautifulSoup
from sphinx_external_toc.parsing import parse_toc_yaml

import offairl_lite
import rollouts
from offairl_lite.ablations.released import RELEASE
from offairl_lite.config import CORRECTED, RewardName, differences

ROOT = Path(__file__).parents[2]
EMPTY = {f"offairl_lite.{package}" for package in ("core", "ablations", "analysis", "runs")}
MODULES = [
    module.name
    for module in pkgutil.walk_packages(offairl_lite.__path__, "offairl_lite.")
    if not module.name.rpartition(".")[2].startswith("_") and module.name not in EMPTY
]
TABLES = {
    page: (ROOT / f"book/{page}.md").read_text() for page in ("notation", "from_paper_to_code")
}
NAME = r"\{py:\w+\}`(?:[^`<]+<|~?)([\w.]+)>?`"
NAMED = {page: set(re.findall(NAME, text)) for page, text in TABLES.items()}


def found(name):
    """What has this name within the package; AttributeError if nothing has."""
    parts, thing = name.split("."), offairl_lite
    for i, part in enumerate(parts):
        path = ".".join(["offairl_lite", *parts[: i + 1]])
        thing = import_module(path) if path in MODULES else getattr(thing, part)
    return thing


def test_lookup_detects():
    assert found("config.groups.Schedule.batch_size") == CORRECTED.schedule.batch_size
    for wrong in ("config.groups.Schedule.penalty", "sac.loss", "mcp.MCP"):
        with pytest.raises(AttributeError):
            found(wrong)


@pytest.mark.parametrize("name", sorted(NAMED["notation"] | NAMED["from_paper_to_code"]))
def test_what_is_named_exists(name):
    found(name)


def test_rewards_that_are_named_exist():
    named = set(re.findall(r'`reward="([\w-]+)"`', TABLES["from_paper_to_code"]))
    assert named
    assert named <= set(get_args(RewardName))


def test_the_lines_to_find_are_those_of_the_package():
    code, *_ = re.findall(r"```python\n(.*?)```", TABLES["from_paper_to_code"], re.DOTALL)
    owners = ("core.rewards.dac", "core.rewards.log_odds", "core.discriminator.shaped_reward")
    for line, name in zip(code.splitlines(), owners, strict=True):
        assert inspect.getsource(found(name)).rstrip().endswith(f"    {line}")


def test_the_ledger_has_all_that_the_release_preset_switches():
    ledger = TABLES["from_paper_to_code"].partition("(sec-ledger)=")[2]
    rows = [line for line in ledger.splitlines() if line.startswith("|") and "RELEASE" in line]
    paths = [path for row in rows for path in re.findall(r"\{py:obj\}`~([\w.]+)`", row)]
    named, groups = set(), set()
    for path in paths:
        group, _, name = path.rpartition(".")
        if inspect.isclass(found(path)):
            groups.add(found(path))
        else:
            groups.add(found(group))
            named.add(found(group).renamed.get(name, name))
    # A learner and an ablation are chosen by the types of their settings.
    assert set(differences(CORRECTED, RELEASE)) - {"learner", "ablation"} <= named
    assert len(differences(CORRECTED, RELEASE)) == 12
    assert "In twelve." in TABLES["from_paper_to_code"]
    assert {type(RELEASE.learner), type(RELEASE.discriminator)} <= groups


def test_the_reference_has_every_module():
    pages = [page for page in parse_toc_yaml(ROOT / "_toc.yml") if page.startswith("book/api/")]
    texts = [(ROOT / f"{page}.md").read_text() for page in pages]
    shown = [name for text in texts for name in re.findall(r"automodule:: (\S+)", text)]
    assert sorted(shown) == sorted(MODULES), "give each module a section in book/api/"


def test_the_reference_has_every_function_and_class(html):
    pages = (
        BeautifulSoup(path.read_text(), "html.parser") for path in html.glob("book/api/*.html")
    )
    shown = {element["id"] for page in pages for element in page.select("dt[id]")}
    public = {
        f"{module}.{name}"
        for module in MODULES
        for name, thing in vars(import_module(module)).items()
        if (inspect.isfunction(thing) or inspect.isclass(thing))
        and thing.__module__ == module
        and not name.startswith("_")
    }
    assert public <= shown


@pytest.mark.parametrize("page", TABLES)
def test_names_are_links_to_the_reference(html, page):
    soup = BeautifulSoup((html / f"book/{page}.html").read_text(), "html.parser")
    links = {code.text: code.find_parent("a") for code in soup.select("code.xref")}
    assert len(links) > 20
    assert all(link and link["href"].startswith("api/") for link in links.values())


@pytest.fixture(scope="module")
def docstrings():
    path = ROOT / "book/_ext/docstrings.py"
    spec = importlib.util.spec_from_file_location("docstrings", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("written", "read"),
    [
        (r"so $D = \sigma(\ell)$ is", r"so :math:`D = \sigma(\ell)` is"),
        ("Is:\n\n$$a\nb,$$\n\nwith c", "Is:\n\n.. math::\n\n    a\n    b,\n\n\nwith c"),
        ("as `find` and `sac.SAC` do", "as :py:obj:`find` and :py:obj:`.sac.SAC` do"),
        ("a matrix `(S, *shape)`", "a matrix ``(S, *shape)``"),
        ("- *Memory*: 2 * (|u| + V_)", r"- *Memory*: 2 \* (\|u\| + V\_)"),
        ("obs_dim: O.", r"obs_dim: O\."),
        ("p(a | s) of r_ψ, that is 0.5.", r"p(a \| s) of r_ψ, that is 0.5."),
        ("Is.\n\nReturns:\n    a: b", "Is.\n\nReturns:\n    \\\n    a: b"),
        ("T.\n\nAttributes:\n    x: y", "T\\.\n\nArgs:\n    x: y"),
    ],
)
def test_docstrings_are_converted(docstrings, written, read):
    assert docstrings.converted(written) == read


def test_a_killed_run_comes_out_as_the_one_that_was_left_alone():
    """Five kills, six lives, each from a checkpoint before the kill, and every file is equal."""
    kept, page = rollouts.read("killed"), (ROOT / "book/running_at_scale.md").read_text("utf-8")
    assert kept["files"] == 17
    assert kept["different"].size == 0
    assert (kept["alone"] == kept["killed"]).all()
    begins, ends = kept["lives"].T
    assert len(ends) == 6
    assert (begins[1:] < ends[:-1]).all()
    assert ends[-1] == kept["steps"][-1]
    assert "five times with `kill -9`" in page
    assert "this run needed six" in page
