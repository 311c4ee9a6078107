"""The records: complete, of the experiments they name, and the only source of the results."""

import ast
import re
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import nbformat
import numpy as np
import pytest
import torch

import other_bounds
from offairl_lite.config import CORRECTED, differences, flat_settings
from offairl_lite.core import discriminator
from offairl_lite.core.discriminator import Discriminator, Transitions
from offairl_lite.core.loop import Trainer
from offairl_lite.core.networks import Normaliser, load_weights
from offairl_lite.core.policies import Policy, make_actor
from offairl_lite.core.rng import Rng
from offairl_lite.core.shapes import Layout
from offairl_lite.experiments import EXPERIMENTS, configure
from offairl_lite.runs import inputs, records
from offairl_lite.runs.records import PACKAGES, PICTURE, RunSpec, read_json, run_folders
from paper_figures import FIGURES, record

ROOT = Path(__file__).parents[2]
HOME = ROOT / "book/records"
RESULTS = ("11_results", "notes/the_papers_figures")
PARTS = sorted(path.parent.relative_to(HOME).as_posix() for path in HOME.rglob("config.json"))
# The seeds of some runs were trained by several processes.
FOLDERS = sorted({part.partition("/seeds-")[0] for part in PARTS})
RUNS = sorted({r for panels in FIGURES.values() for c in panels.values() for r in c.values()})

# A record may be shorter or longer than its experiment is. What else may differ is what it is
# about, and is named here.
LENGTH = {"total_steps"}
VARIED = {
    "sqil-learned-demo/HalfCheetah-sqil": {"temperature"},
    **{
        f"iq-learn-cold-demo/{robot}-iq-learn": {"temperature"}
        for robot in ("Hopper", "Walker2d", "HalfCheetah", "CustomAnt", "Ant")
    },
    "maze-airl-ppo-demo/gan-gcl": {"reward"},
    "maze-imitation-2-demo": {"reward"},
    "maze-retraining-cool-full/8-gate-helped": {"eval_every", "temperature"},
    "maze-imitation-fresh-demo": {"random_hold"},
    "maze-imitation-raw-demo": {"normalise"},
    "maze-imitation-released-loss-demo": {"loss"},
    "maze-imitation-right-demo": {"env_id"},
    "marsh-airl-memory-demo/all": {"env_id"},
    "marsh-airl-ppo-demo/state": {"env_id"},
    "decides-marsh-demo/released/implementation-4": {"loss"},
    "decides-marsh-demo/mixture/implementation-4": {"loss"},
    "decides-marsh-demo/released-16/implementation-4": {"loss"},
    "decides-marsh-demo/light-16/implementation-4": {"gradient_penalty", "loss"},
    "decides-marsh-demo/released-50/implementation-4": {"loss"},
    "locomotion-first-released-loss-demo/HalfCheetah-airl": {"loss"},
    "locomotion-first-wide-demo/HalfCheetah-airl": {"log_std_range"},
    "hopper-none-demo/Hopper-released-fixed-short": {"absorbing", "eval_every"},
    **{
        f"decides-1.2-demo/{robot}-exact-fixed-short": {"temperature"}
        for robot in ("Hopper", "Walker2d", "HalfCheetah", "CustomAnt")
    },
    **{
        f"decides-steeper-demo/{robot}-released-one-short": {"gradient_penalty"}
        for robot in ("Walker2d", "HalfCheetah")
    },
    **{
        f"decides-penalty-{weight}-demo/{robot}-released-fixed-short": {"gradient_penalty"}
        for robot in ("Hopper", "Walker2d", "HalfCheetah", "CustomAnt")
        for weight in ("0.1", "1")
    },
    **{
        f"decides-wide-demo/{robot}-released-fixed-short": {
            "hidden",
            "reward_hidden",
            "shaping_hidden",
        }
        for robot in ("Hopper", "Walker2d", "HalfCheetah", "CustomAnt")
    },
    **{
        f"decides-blocks-demo/{robot}-released-fixed-short": {"train_every"}
        for robot in ("Hopper", "Walker2d", "HalfCheetah", "CustomAnt")
    },
    **{
        f"decides-forget-demo/{run}": {"replay_size"}
        for run in (
            "Hopper-released-fixed-short",
            "Hopper-released-fixed-long",
            "Walker2d-released-fixed-short",
            "Walker2d-released-fixed-long",
        )
    },
    "decides-both-demo/Walker2d-released-fixed-long": {"replay_size"},
    # Five more seeds of the warm-up's experiment.
    **{
        f"decides-{cure}-more-demo/Walker2d-released-fixed-{length}": {"replay_size"}
        for cure, length in (("forget", "short"), ("forget", "long"), ("both", "long"))
    },
    # Minutes of a GPU.
    **{
        f"locomotion-{place}-{method}": {"eval_every", "eval_episodes"}
        for place in (
            "ten-full/Hopper",
            "ten-full/HalfCheetah",
            "ten-full/Walker2d",
            "ten-again-full/Walker2d",
        )
        for method in ("airl", "dac")
    },
    "hopper-absorbing-centred-demo/dac-analytic": {"centre_reward"},
    "hopper-absorbing-centred-demo/implementation-4-analytic": {"centre_reward"},
    "locomotion-first-centred-demo/HalfCheetah-airl": {"centre_reward"},
    "locomotion-first-centred-demo/HalfCheetah-airl-mixture": {"centre_reward"},
    "ant-rewards-centred-demo/implementation-4-mixture": {"centre_reward"},
    "ant-rewards-centred-demo/implementation-4-velocity": {"centre_reward"},
    "ant-transfer-demo/true/scratch": {"reward"},
    "decides-velocity-demo/CustomAnt-released-fixed-short": {"reward_sees"},
    **{
        f"decides-ant-rewards-demo/{n}/CustomAnt-released-fixed-short": {"reward"}
        for n in (1, 2, 3)
    },
    "decides-ant-rewards-demo/3/CustomAnt-exact-one-short": {"reward"},
    "decides-upright-demo/3/CustomAnt-exact-one-short": {"reward"},
    "decides-transfer-demo/velocity/scratch": {"centre_reward"},
    "decides-transfer-demo/state/scratch": {"centre_reward"},
    "decides-transfer-demo/whole/scratch": {"centre_reward"},
    "decides-transfer-demo/velocity/policy": {"centre_reward"},
    "decides-transfer-demo/dac/scratch": {"centre_reward"},
    "decides-transfer-demo/true/scratch": {"reward"},
    "decides-transfer-demo/velocity-short/scratch": {"centre_reward", "learning_starts"},
    "decides-transfer-demo/velocity-cool/scratch": {"centre_reward", "temperature"},
    "decides-transfer-demo/velocity-recipe/scratch": {
        "centre_reward",
        "temperature",
        "learning_starts",
    },
    **{
        f"decides-transfer-demo/{reward}/scratch": {"temperature", "learning_starts"}
        for reward in ("velocity-recipe-raw", "state-recipe", "dac-recipe")
    },
    "decides-transfer-demo/velocity-recipe/policy": {"centre_reward", "temperature"},
    # On the mazes learners are soon where they go.
    **{
        f"experts/PointMaze{side}-{learner}": {"eval_every"}
        for side in ("Left", "Right")
        for learner in ("td3", "sac-fixed", "sac-learned")
    },
    **{
        folder: {"eval_every"}
        for folder in FOLDERS
        if re.match(r"maze-(imitation|mcp|retraining)-full\b", folder)
    },
    **{
        f"ant-transfer-demo/{reward}-centred/{arm}": {"centre_reward"}
        for reward in ("state", "velocity")
        for arm in (
            "scratch",
            "scratch-released-order",
            "policy",
            "policy-released-order",
            "policy-own-starts",
            "policy-expert-starts",
            "4-both",
            "4-gate",
            "8-both",
            "8-gate",
        )
    },
    # Whose primitives are carried over to the other ant.
    **{
        f"ant-rewards-mcp-{k}-demo/implementation-4-mixture": {
            "centre_reward",
            "primitives",
            "trunk_hidden",
            "primitive_hidden",
            "gate_hidden",
        }
        for k in (4, 8)
    },
    **{
        f"locomotion-first-mcp-{k}-demo/HalfCheetah-airl-mixture": {"eval_every", "primitives"}
        for k in (4, 8)
    },
    # Recorded when the demo's primitives, of which these have none, were not yet small.
    **{
        folder: {"trunk_hidden", "primitive_hidden", "gate_hidden"}
        for folder in FOLDERS
        if re.match(r"locomotion-(long-)?demo/(?!Ant-|.*-mcp-|.*-td3)", folder)
    },
    # On-policy methods take longer.
    **{
        f"hopper-gail-demo/{name}": {"eval_every"}
        for name in ("survival", "termination", "log-odds")
    },
    # Ten times as long.
    **{
        f"locomotion-first-demo/{task}-{name}": {"eval_every"}
        for task in ("HalfCheetah", "Hopper", "Walker2d")
        for name in ("airl", "airl-mixture", "airl-soft", "dac")
    },
    "locomotion-first-demo/HalfCheetah-dac-td3": {"eval_every"},
    **{
        f"locomotion-first-light-demo/{run}": {"eval_every", "gradient_penalty"}
        for run in ("HalfCheetah-airl-mixture", "HalfCheetah-airl-soft", "Hopper-airl-soft")
    },
    "locomotion-first-alpha-1-demo/Hopper-airl": {"eval_every", "temperature"},
    "locomotion-first-alpha-02-demo/Hopper-airl-mixture": {"eval_every", "temperature"},
    "locomotion-first-alpha-02-demo/Hopper-dac": {"eval_every", "temperature"},
    "locomotion-first-alpha-1-demo/Hopper-dac": {"eval_every", "temperature"},
    "locomotion-first-logit-demo/HalfCheetah-airl-mixture": {"eval_every", "reward"},
    "locomotion-first-logit-demo/Hopper-airl-mixture": {"eval_every", "reward"},
    "experts-long/Ant-sac-learned": {"learning_starts"},
    "experts-long/Hopper-sac-fixed": {"learning_starts"},
    **{
        f"experts-small/{run}": {"eval_every", "hidden", "learning_starts"}
        for run in ("Ant-sac-learned", "Hopper-sac-fixed", "Walker2d-sac-fixed")
    },
    # The shipped experts are trained for longer, and evaluated less often.
    "maze-expert-left-demo": {"eval_every"},
    "maze-expert-right-demo": {"env_id", "eval_every"},
}
# The first ones were made before a run said where, of what commit, and by what demonstrations.
EARLY = {
    "maze-expert-left-demo",
    "maze-expert-right-demo",
    "maze-imitation-2-demo",
    "maze-imitation-demo",
    "maze-imitation-fresh-demo",
    "maze-imitation-raw-demo",
    "maze-imitation-released-loss-demo",
    "maze-transfer-demo",
}
# These were made before a run said what it has of which other runs.
NAMELESS = {"maze-transfer-demo"} | {
    folder
    for folder in FOLDERS
    if re.match(r"ant-transfer-demo/(?!true|.*\b[48]-)|maze-retraining-demo/[48]-", folder)
}
FILES = {"config.json", "curve.csv", "run.json", "policy.safetensors", "reward.safetensors"}
FILES |= {f"{name}.safetensors" for name in inputs.CURES}
FILES |= {PICTURE}  # Git ignores it.


def cells(folder, chapter):
    return nbformat.read(folder / f"{chapter}.ipynb", as_version=4).cells


# The package's experiments, and one that is the book's.
BOUNDS = replace(EXPERIMENTS["maze-imitation"], variants=other_bounds.VARIANTS)
KNOWN = {**EXPERIMENTS, "maze-penalties": BOUNDS}


def run_of(folder, spec):
    """The name of the run that a record is of."""
    variant = folder.split("/")[-1] if KNOWN[spec.experiment].variants else ""
    return f"{spec.experiment}/{variant}".rstrip("/")


def test_what_is_named_is_recorded():
    assert set(VARIED) | EARLY <= set(FOLDERS)


def test_what_primitives_offer_is_recorded_of_those_that_were_carried_over():
    pushes, about = load_weights(HOME / "maze-mcp-full/pushes.safetensors", "pushes")
    for k in (4, 8):
        assert len(pushes[f"{k}-softmax"]) == 10
        for arm in ("gate", "gate-own-starts", "gate-expert-starts"):
            spec = RunSpec.read(HOME / f"maze-retraining-full/{k}-{arm}")
            assert spec.inherited["pretrained_policy"]["digest"] == about["digests"][f"{k}-softmax"]


def test_the_recipe_of_what_primitives_offer_gives_what_is_recorded(tmp_path, monkeypatch):
    """With other policies: those that were carried over are not kept here."""
    cell = next(c for c in cells(ROOT / "book/notes", "old_policies") if c.id == "c9gate1")
    (recipe,) = re.findall(r"```python\n(.*?)```", cell.source, re.DOTALL)
    actor = make_actor(configure("maze-mcp/8-softmax", "demo").learner, 3, 2)
    policy = Policy("", actor, actor.init(Rng((0, 1))), Normaliser.identity(2, 3))
    path = tmp_path / "runs/maze-mcp-full/8-softmax/policy.safetensors"
    path.parent.mkdir(parents=True)
    policy.save(path)
    monkeypatch.chdir(tmp_path)
    names = {"np": np, "torch": torch, "Policy": Policy}
    exec(recipe, names)
    furthest = names["leftmost"](names["policy"], names["below"])
    recorded, _ = load_weights(HOME / "maze-mcp-full/pushes.safetensors", "pushes")
    assert furthest.shape[1:] == recorded["8-softmax"].shape[1:]
    with torch.no_grad():
        means, *_ = actor.parts(policy.params, names["below"].expand(2, -1, -1))
    assert torch.equal(furthest, torch.tanh(means)[..., 0].min(2).values)


def test_the_script_of_the_long_warm_up_makes_no_updates_for_it(monkeypatch):
    cell = next(c for c in cells(ROOT / "book/notes", "long_warmup") if "skip.py" in c.source)
    (script,) = re.findall(r"```python\n(.*?)```", cell.source, re.DOTALL)
    sizes = {"learning_starts": 4, "train_every": 2, "total_steps": 8, "eval_every": 8}
    task = {"env_id": "offairl/PointMazeLeft-v0", "reward": "environment", "absorbing": "none"}
    config = CORRECTED.change(**sizes, **task, eval_episodes=1)
    fitted = []
    monkeypatch.setattr(
        Trainer, "train_on_block", lambda trainer, steps: fitted.append(trainer.steps)
    )
    for _ in Trainer(config, (0,)).run():
        pass
    assert fitted == [4, 4, 6, 8]
    fitted.clear()
    monkeypatch.setattr(Trainer, "start", Trainer.start)
    monkeypatch.setattr("offairl_lite.runs.cli.main", lambda: None)
    exec(script, {})
    for _ in Trainer(config, (0,)).run():
        pass
    assert fitted == [6, 8]


def test_the_consistent_logit_divides_f_by_the_temperature(monkeypatch):
    cell = next(c for c in cells(ROOT / "book/notes", "around_the_recipe") if "f / 0.2" in c.source)
    (script,) = re.findall(r"```python\n(.*?)```", cell.source, re.DOTALL)
    monkeypatch.setattr(discriminator, "log_odds", discriminator.log_odds)
    monkeypatch.setattr("offairl_lite.runs.cli.main", lambda: None)
    exec(script, {})
    spec = spec_of("decides-scaled-demo/Hopper-exact-fixed-short")
    assert spec.config.learner.temperature == 0.2
    d = Discriminator(spec.config.discriminator, Layout(1, 3, 2))
    monkeypatch.setattr(d, "f", lambda both: torch.tensor([[1.0, -2.0]]))
    zero = torch.zeros(1, 1, 3)
    sides = [Transitions(zero, zero[..., :2], zero, torch.tensor([[x]])) for x in (0.5, 3.0)]
    assert [logit.item() for logit in d.logits(*sides)] == pytest.approx([4.5, -13.0])


def spec_of(folder):
    return RunSpec.read(run_folders(HOME / folder)[0])


@pytest.mark.parametrize("folder", PARTS)
def test_a_record_says_what_produced_it(folder):
    names = {path.name for path in (HOME / folder).iterdir() if path.is_file()}
    assert {"config.json", "curve.csv", "run.json"} <= names <= FILES
    about = read_json(HOME / folder / "run.json")
    assert datetime.fromisoformat(about["started"]).tzinfo is not None
    assert set(about["versions"]) == set(PACKAGES)
    assert all(re.match(r"\d+\.\d+", version) for version in about["versions"].values())
    assert about["wall_s"] > 0
    assert about["machine"]
    assert about["cores"] >= about["threads"] >= 1
    if folder not in EARLY:
        assert about["processor"]
        assert re.fullmatch(r"[0-9a-f]{40}(-dirty)?", about["commit"])
    assert about["step"] > 0
    assert about["state"]


@pytest.mark.parametrize("folder", FOLDERS)
def test_a_record_is_of_the_experiment_that_it_names(folder):
    spec = spec_of(folder)
    assert spec.scale in ("demo", "full")
    # GAN-GCL was a run of its experiment once.
    name, _, variant = run_of(folder, spec).replace("gan-gcl", "state").partition("/")
    expected = KNOWN[name].configs[spec.scale].change(**KNOWN[name].variants.get(variant, {}))
    changed = set(differences(expected, spec.config)) - LENGTH
    assert changed == VARIED.get(folder, set()), "name in VARIED what a record is about"
    seeds = records.read(HOME / folder).seeds
    assert len(set(seeds)) == len(seeds)
    shown = spec.demonstrations
    assert (shown is not None) == spec.config.imitates
    if shown is not None:
        assert shown["trajectories"] > 0
        if shown.get("dataset") is None:  # A data set of one's own is not made by experts.
            assert shown.get("experts") == KNOWN[spec.experiment].experts[spec.scale]
        assert folder in EARLY or re.fullmatch(r"[0-9a-f]{64}", shown["digest"])


@pytest.mark.parametrize("folder", FOLDERS)
def test_a_record_names_what_it_has_of_other_runs(folder, monkeypatch):
    monkeypatch.chdir(ROOT)
    spec = spec_of(folder)
    needed = set(inputs.needed(spec.config))
    if folder in NAMELESS:
        assert needed
        assert not spec.inherited
        return
    assert set(spec.inherited) == needed
    kept = [
        Path(f)
        for name, about in spec.inherited.items()
        if not (HOME / folder / f"{name}.safetensors").is_file()
        for f in about["files"]
    ]
    assert all(about["files"] for about in spec.inherited.values())
    # Policies of large networks are megabytes, and not here.
    assert all(path.exists() for path in kept if path.parts[0] != "runs")  # or its folder
    if all(path.exists() for path in kept):
        inputs.recorded(HOME / folder, spec)  # It refuses what is something else.


@pytest.mark.parametrize("folder", FOLDERS)
def test_a_curve_has_all_that_its_run_has_evaluated(folder):
    run = records.read(HOME / folder)
    states = {read_json(path / "run.json")["state"] for path in run_folders(HOME / folder)}
    config = run.config
    assert run.rows
    for row in run.rows:
        assert row.seed in run.seeds
        assert row.step <= config.total_steps
        assert len(row.returns) == config.schedule.eval_episodes
        assert row.mean_return == pytest.approx(np.mean(row.returns))
    assert len({(row.seed, row.step) for row in run.rows}) == len(run.rows)
    if states == {"finished"}:
        kept = [seed not in run.diverged for seed in run.seeds]
        assert run.steps[-1] == config.total_steps
        assert not np.isnan(run.returns[kept]).any()


@pytest.mark.parametrize("scale", ["demo", "full"])
@pytest.mark.parametrize("run", RUNS)
def test_what_a_figure_would_draw_is_a_record_of_that_run(run, scale):
    folder = record(run, scale)
    if folder not in FOLDERS:
        assert not [*(HOME / folder).rglob("curve.csv")]
        return
    spec = spec_of(folder)
    assert spec.scale == scale
    # Recorded under another name it is the same at full scale, but for what it is about.
    own = configure(run_of(folder, spec), "full")
    about = VARIED.get(folder, set()) - {"eval_every"}
    own = own.change(**{name: spec.config.flat()[name] for name in about})
    assert differences(own, configure(run, "full")) == {}


def test_every_curve_of_the_paper_s_figures_is_recorded():
    missing = [run for run in RUNS if not {record(run, s) for s in ("full", "demo")} & {*FOLDERS}]
    assert not missing


def test_a_note_names_every_run_with_its_record(book):
    judged = cells(book / "book/notes", "how_claims_are_judged")
    (cell,) = (cell for cell in judged if cell.id == "r10status")
    table = cell.outputs[0].data["text/html"]
    said = dict(re.findall(r"<tr><td>(.*?)</td><td[^>]*>(.*?)</td></tr>", table))
    assert set(RUNS) <= set(said)
    for run in RUNS:
        scale = next(s for s in ("full", "demo") if record(run, s) in FOLDERS)
        size = RunSpec.read(run_folders(HOME / record(run, scale))[0]).config.learner.hidden
        kind = "paper-size" if size == CORRECTED.learner.hidden else "small"
        assert said[run].startswith(f"{kind} networks, "), run


NUMBER = re.compile(r"(?<![\w.])[-−]?\d+(?:,\d{3})*(?:\.\d+)?")
UNSPOKEN = re.compile(r"\$[^$]*\$|`[^`]*`|\{[\w:]+\}|```.*?```", re.DOTALL)


def typed(markdown):
    """Numbers in the prose that look like measurements: with decimals, below 0, or large."""
    text = UNSPOKEN.sub(" ", markdown)
    numbers = NUMBER.findall(text)
    return [n for n in numbers if re.search(r"[-−.]", n) or float(n.replace(",", "")) >= 100]


def literals(code):
    """Numbers in code that look like measurements."""
    tree = ast.parse(re.sub(r"(?m)^[%!].*$", "", code))
    values = {
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and type(node.value) in (int, float)
    }
    below = {
        -node.operand.value
        for node in ast.walk(tree)
        if isinstance(node, ast.UnaryOp) and isinstance(node.operand, ast.Constant)
    }
    return {x for x in values if x > 100} | {x for x in below if x <= -5}


def test_the_search_for_typed_numbers_detects():
    assert typed("It returns −26.5, or 0.3, or 1,377, or 8.") == ["−26.5", "0.3", "1,377"]
    assert typed("of 5 seeds, $x = -3$, `run 300`, {doc}`09_transfer`, 95 %, 10 of 10") == []
    assert literals("x = 8596; y[-1]; z = -26.5; figsize=(8.2, 3)") == {8596, -26.5}


# Settings and definitions: the bar on the maze, the paper's temperature and one above it, the level
# of a p-value, random steps of a warm-up, the temperature above which one has run away; thousands
# of steps.
DEFINED_IN_PROSE = {"−14", "0.2", "1.2", "0.05", "1,000", "10,000"}
# After how many steps seeds are counted.
COUNTED_AFTER = {"30,000", "40,000", "100,000"}
DEFINED_IN_CODE = {-14, 1000}


def test_seeds_are_counted_after_steps_that_are_recorded():
    runs = [records.read(HOME / f"maze-retraining-full/{run}") for run in ("policy", "4-both")]
    evaluated = set().union(*(run.steps for run in runs))
    assert {int(steps.replace(",", "")) for steps in COUNTED_AFTER} <= evaluated


@pytest.mark.parametrize("page", RESULTS)
def test_no_number_that_the_records_have_is_typed_into_the_results(page):
    for name in ("claims", "verdicts", "words"):
        source = (ROOT / f"book/paper_{name}.py").read_text("utf-8")
        assert literals(source) <= DEFINED_IN_CODE | {3600}  # seconds of an hour
    solution = False
    for cell in cells(ROOT / "book", page):
        if cell.cell_type == "code":
            if not solution:
                assert literals(cell.source) <= DEFINED_IN_CODE, cell.id
        else:
            solution = solution or "{solution-start}" in cell.source
            solution = solution and "{solution-end}" not in cell.source
            exercise = "{exercise}" in cell.source
            if not solution and not exercise:
                assert set(typed(cell.source)) <= DEFINED_IN_PROSE | COUNTED_AFTER, cell.id


def test_every_field_of_a_record_is_one_of_the_configuration():
    assert set().union(*VARIED.values()) | LENGTH <= set(flat_settings())


def test_after_8000_steps_a_fall_costs_22_to_25():
    """Chapter 7 says so of the five hoppers without an absorbing state."""
    run = records.read(HOME / "hopper-none-demo/Hopper-released-fixed-short")
    paid = [row.learned_return for row in run.rows if row.step == 8_000]
    assert (len(paid), round(max(paid)), round(min(paid))) == (5, -22, -25)
