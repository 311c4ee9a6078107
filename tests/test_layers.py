"""Imports go one way, and nothing draws from a global random state."""

import ast
from pathlib import Path

import pytest

import offairl_lite

ROOT = Path(offairl_lite.__file__).parent
ORDER = """
config scale core.shapes core.rng core.acceleration envs tabular core.networks core.replay
core.absorbing core.policies core.rollouts minari_storage recordings demonstrations cloning plain
core.rewards
core.discriminator core.experience core.sac core.iq_learn core.td3 core.ppo core.learner
core.results core.collector core.requirements core.loop worlds ablations experiments
analysis.statistics analysis.epic analysis.plots analysis.films runs.records runs.tensorboard
runs.inputs runs.preflight learned_reward runs.export runs.pictures runs.checkpoints runs.jobs
runs.messages runs.folders runs.grid runs.launch runs.bench airl runs.cli
""".split()  # noqa: SIM905
FILES = sorted(
    path for path in ROOT.rglob("*.py") if path.parent != ROOT or path.stem != "__init__"
)
IDS = [path.relative_to(ROOT).with_suffix("").as_posix() for path in FILES]
PACKAGES = {"core.__init__", "analysis.__init__", "runs.__init__"}
WHOLE = ("config", "envs", "tabular", "ablations", "experiments")


def layer(name):
    """The place in the line that a module has; each of the packages in `WHOLE` is one place."""
    parts = name.split(".")
    return ".".join(parts[:2]) if parts[0] in ("core", "analysis", "runs") else parts[0]


def imported(tree):
    """Names of the package's modules that are imported anywhere in a file."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        yield from (layer(n.partition(".")[2]) for n in names if n.startswith("offairl_lite."))


def dotted(node):
    """`np.random.rand` for the expression of that name, and nothing for others."""
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def test_every_module_has_its_place_in_the_line():
    assert {layer(name.replace("/", ".")) for name in IDS} - PACKAGES == set(ORDER)


@pytest.mark.parametrize("path", FILES, ids=IDS)
def test_a_module_imports_only_from_those_above_it(path):
    here = layer(path.relative_to(ROOT).with_suffix("").as_posix().replace("/", "."))
    if here in PACKAGES:
        return
    above = ORDER[: ORDER.index(here)] + [here] * (here in WHOLE)
    assert set(imported(ast.parse(path.read_text("utf-8")))) <= set(above)


@pytest.mark.parametrize("path", FILES, ids=IDS)
def test_only_scale_reads_the_environment(path):
    nodes = list(ast.walk(ast.parse(path.read_text("utf-8"))))
    # What is set for another program, as in `os.environ["X"] = "0"`, is not read.
    stores = [node for node in nodes if isinstance(node, ast.Subscript | ast.Attribute)]
    stores = {id(node.value) for node in stores if isinstance(node.ctx, ast.Store)}
    names = {dotted(node) for node in nodes if id(node) not in stores}
    reads = bool(names & {"os.environ", "os.getenv", "environ", "getenv"})
    assert reads == (path == ROOT / "scale.py")


@pytest.mark.parametrize("path", FILES, ids=IDS)
def test_no_module_uses_global_random_state(path):
    owned = {"default_rng", "SeedSequence", "Generator", "PCG64"}
    draws = {"rand", "randn", "randint", "randperm", "normal", "multinomial", "bernoulli"}
    in_place = {"normal_", "uniform_", "random_", "bernoulli_", "exponential_"}
    tree = ast.parse(path.read_text("utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            assert "random" not in {alias.name for alias in node.names}
            continue
        name = dotted(node) if isinstance(node, ast.Attribute) else ""
        if name.startswith(("np.random.", "numpy.random.")):
            assert name.split(".")[2] in owned, name
        assert name not in ("torch.manual_seed", "torch.seed", "torch.random"), name
        if isinstance(node, ast.Call):
            called = dotted(node.func)
            from_torch = called.startswith("torch.") and called.split(".")[-1] in draws
            if from_torch or called.split(".")[-1] in in_place:
                assert "generator" in {keyword.arg for keyword in node.keywords}, called
