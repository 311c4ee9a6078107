"""Statements are measured under perturbations, and none of the book's fails."""

import importlib
import json
from pathlib import Path

import gymnasium
import nbformat
import numpy as np
import pytest
import torch
from gymnasium.wrappers import OrderEnforcing

import perturbation
import portable
from offairl_lite import envs, plain
from offairl_lite.core import networks
from offairl_lite.core.rng import Rng
from offairl_lite.envs import BatchedEnv

BOOK = Path(portable.__file__).parent
CELLS = (
    """
import numpy as np, torch
from checks import hold
from offairl_lite.core.networks import StackedMLP
from offairl_lite.core.rng import Rng
weights = StackedMLP((2, 3)).init(Rng([0]))[0]
x = np.random.default_rng(0).normal(size=(50, 50))
logarithm, product = np.log(abs(x)).sum(), (x @ x).sum()
""",
    "hold('toy', globals())",
)
CHECKS = """
from checks import exact, live

@exact
def nearly(weights):
    '''Changes are small.'''
    assert (weights - {weights}).abs().max() < 1e-5

@live
def exactly(weights):
    '''It names too many digits.'''
    assert weights.tolist() == {weights}.tolist()
"""


@pytest.fixture
def undone(monkeypatch):
    """Perturbations of this process end with the test."""
    for place, name in (
        (networks.StackedMLP, "init"),
        (torch.nn.init, "xavier_uniform_"),
        (networks.Adam, "__init__"),
        (torch.optim.Adam, "__init__"),
        (BatchedEnv, "step"),
        (OrderEnforcing, "step"),
    ):
        monkeypatch.setattr(place, name, getattr(place, name))


def of_the_package():
    """The weights of two members after a few steps."""
    net, x = networks.StackedMLP((3, 8, 1)), Rng([2, 3]).normal(4, 3)
    optimizer = networks.Adam(net.init(Rng([0, 1])), 1e-2)
    for _ in range(3):
        networks.descend(net(optimizer.params, x).square().mean(), optimizer)
    return optimizer.params.detach()


def of_the_chapters():
    rng = torch.Generator().manual_seed(0)
    net, x = plain.mlp([3, 8, 1], torch.nn.Tanh, rng), torch.randn(4, 3, generator=rng)
    optimizer = plain.adam(net.parameters())
    for _ in range(3):
        plain.descend(net(x).square().mean(), optimizer)
    return torch.cat([part.detach().flatten() for part in net.parameters()])


def of_the_batch():
    """Observations after a step."""
    env = envs.make("offairl/PointMazeLeft-v0", 2, 0)
    env.reset()
    return torch.as_tensor(env.step(np.full((2, 2), 0.7, np.float32))[0])


def of_gymnasium():
    env = gymnasium.make("Pendulum-v1")
    env.reset(seed=0)
    return torch.as_tensor(env.step(np.float32([0.7]))[0], dtype=torch.float64)


@pytest.mark.parametrize(
    ("change", "compute"),
    [
        (lambda: perturbation.perturb_weights(1e-6, 1), of_the_package),
        (lambda: perturbation.perturb_weights(1e-6, 1), of_the_chapters),
        (lambda: perturbation.perturb_rates(1 + 1e-5), of_the_package),
        (lambda: perturbation.perturb_rates(1 + 1e-5), of_the_chapters),
        (lambda: perturbation.perturb_actions(1 - 1e-6), of_the_batch),
        (lambda: perturbation.perturb_actions(1 - 1e-6), of_gymnasium),
    ],
)
def test_each_perturbation_changes_a_little_and_always_the_same(undone, change, compute):
    before = compute()
    assert torch.equal(compute(), before)
    change()
    after = compute()
    assert torch.equal(compute(), after)
    assert 0 < (after - before).abs().max() < 1e-5


def test_members_are_perturbed_alike_alone_and_together(undone):
    perturbation.perturb_weights(1e-6, 1)
    net = networks.StackedMLP((3, 8, 1))
    assert torch.equal(net.init(Rng([0, 1]))[1:], net.init(Rng([1])))


def test_numbers_choose_kernels_and_none_chooses_none(monkeypatch):
    monkeypatch.setattr("platform.machine", lambda: "x86_64")
    chosen = [perturbation.kernels(number) for number in range(1, portable.RUNS + 1)]
    assert perturbation.kernels(0) == {}
    assert len({json.dumps(each) for each in chosen}) == portable.RUNS
    for name, values in perturbation.KERNELS.items():
        assert {each.get(name, "") for each in chosen} == set(values)
    monkeypatch.setattr("platform.machine", lambda: "arm64")
    assert perturbation.kernels(1) == {}


@pytest.fixture
def toy(tmp_path, monkeypatch):
    """A book with one page, of which one statement is too exact."""
    book = tmp_path / "book"
    (book / "checks").mkdir(parents=True)
    (book / "perturbation.py").symlink_to(BOOK / "perturbation.py")
    (book / "checks" / "__init__.py").symlink_to(BOOK / "checks" / "__init__.py")
    weights = networks.StackedMLP((2, 3)).init(Rng([0]))[0]
    exact = f"torch.tensor({weights.tolist()})"
    checks = "import torch\n" + CHECKS.format(weights=exact)
    (book / "checks" / "toy.py").write_text(checks, "utf-8")
    cells = [nbformat.v4.new_code_cell(cell) for cell in CELLS]
    nbformat.write(nbformat.v4.new_notebook(cells=cells), book / "toy.ipynb")
    monkeypatch.setattr(portable, "BOOK", book)
    monkeypatch.setattr(portable, "LEDGER", book / "portable.json")
    return book / "toy.ipynb"


def test_failures_are_counted(toy, tmp_path, capsys, monkeypatch):
    assert portable.computing() == ["toy"]
    outcomes = perturbation.run(toy, 0, tmp_path, toy.parent)
    assert [(each["name"], each["evidence"]) for each in outcomes] == [
        ("nearly", ""),
        ("exactly", ""),
    ]
    assert portable.measure([], more=2, changed=False) == 1
    entry = portable.ledger()["toy"]
    assert entry["failed"] == {"exactly": 2}
    assert (entry["statements"], portable.runs(entry)) == (2, 2)
    said = capsys.readouterr().out
    assert said.count("toy: 1 of 2 fail\n  exactly: not weights.tolist() ==") == 2
    assert "2 statements, 2 runs ('exactly', 2)" in said

    # The page is as it was measured, and often enough.
    monkeypatch.setattr(portable, "RUNS", 2)
    assert portable.measure([], more=None, changed=True) == 0
    # A page that stops is a failure, and only of the page as it is now.
    toy.write_text(toy.read_text("utf-8").replace("import numpy", "import nothing"), "utf-8")
    assert portable.measure([], more=None, changed=True) == 1
    assert "No module named 'nothing'" in capsys.readouterr().out
    assert portable.ledger() == {"toy": entry}
    assert portable.entry_of("toy", toy)["runs"] == {}


@pytest.mark.parametrize("tag", ["toy", "exercise"])
def test_a_cell_for_the_reader_alone_is_no_change(toy, tag):
    before, page = portable.digest(toy), nbformat.read(toy, as_version=4)
    page.cells.insert(0, nbformat.v4.new_code_cell("toys.show('walls')"))
    nbformat.write(page, toy)
    assert portable.digest(toy) != before
    page.cells[0].metadata["tags"] = [tag, "remove-input"]
    nbformat.write(page, toy)
    assert portable.digest(toy) == before


def test_only_the_lines_of_code_count_not_their_cells(toy):
    before, page = portable.digest(toy), nbformat.read(toy, as_version=4)
    code = "\n\n".join(c.source for c in page.cells if c.cell_type == "code")
    page.cells = [nbformat.v4.new_code_cell(code)]
    nbformat.write(page, toy)
    assert portable.digest(toy) == before
    page.cells[0].source += "\n1"
    nbformat.write(page, toy)
    assert portable.digest(toy) != before


def test_no_statement_of_the_book_has_failed_elsewhere():
    """Of a page that was run less often than needed `make test` makes one run more."""
    entries = [portable.entry_of(name, page) for name, page in portable.pages().items()]
    assert [entry["failed"] for entry in entries if entry["failed"]] == []
    assert sum(portable.runs(entry) for entry in entries) > 0


def test_pages_that_compute_are_found_by_what_their_statements_say():
    for name in portable.pages():
        module = importlib.import_module("checks")
        kinds = {each.kind for each in module.statements(name)}
        assert bool(kinds & {"live", "exact"}) == (name in portable.computing())
