"""The recipe: its commands can be given, its Python runs, and its numbers are the records'."""

import ast
import inspect
import itertools
import json
import os
import re
import runpy
import shlex
import sys
from contextlib import nullcontext
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

import gymnasium
import nbformat
import numpy as np
import pytest
from scipy.stats import spearmanr

from offairl_lite import demonstrations
from offairl_lite.analysis.statistics import difference, interquartile_mean
from offairl_lite.config import flat_settings
from offairl_lite.core.loop import train
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rollouts import action
from offairl_lite.experiments import EXPERIMENTS
from offairl_lite.runs import bench, cli, launch, records

ROOT = Path(__file__).parents[2]
SIDE_PAGES = ("data", "settings", "working", "transfer", "out")
RECIPES = ("recipe", *(f"recipe_{name}" for name in SIDE_PAGES))
PAGE = "\n".join((ROOT / f"book/{name}.md").read_text() for name in RECIPES)
RECORDS = ROOT / "book/records"
LARGE = RECORDS / "locomotion-full"
COMMANDS = {
    "list": cli.list_experiments,
    "resume": launch.resume,
    "demos": cli.demos,
    "clone": cli.clone,
    "watch": cli.watch,
    "tensorboard": cli.tensorboard,
    "export": cli.export,
    "verify": cli.verify,
}
SETTINGS = {*flat_settings(), "learner", "ablation"}
PARTS = {"achieved_goal": 3, "desired_goal": 3, "observation": 10}
GIVEN = {field.name for field in fields(launch.RunInputs)}


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def commands():
    """Every `offairl` command of the page, in a block or in a line."""
    lines = "\n".join(blocks("bash")).replace("\\\n", " ").splitlines()
    inline = re.findall(r"`(offairl [^`]+)`", re.sub(r"```.*?```", "", PAGE, flags=re.DOTALL))
    return [line for line in lines if line.startswith("offairl ")] + inline


def parsed(command):
    """Its name, the arguments without an option, and the options with the texts of their values."""
    _, name, *rest = shlex.split(command)
    free, options, last = [], {}, None
    for part in rest:
        if part.startswith("--"):
            last = part[2:].replace("-", "_")
            assert last not in options, f"{part} is given twice"
            options[last] = []
        else:
            (free if last is None else options[last]).append(part)
    return name, free, options


def value(texts):
    """What the texts after an option stand for."""

    def one(text):
        try:
            return ast.literal_eval(text)
        except (ValueError, SyntaxError):
            return text

    return tuple(map(one, texts)) if len(texts) > 1 else one(texts[0]) if texts else True


def configuration(experiment, settings):
    """What a run would be configured as. Raises what the command would."""
    values = {name: value(texts) for name, texts in settings.items()}
    if isinstance(values.get("reward_sees"), int):
        values["reward_sees"] = (values["reward_sees"],)
    return EXPERIMENTS[experiment].configs["demo"].change(**values)


def require_command(command):
    name, free, options = parsed(command)
    if name == "bench":
        known = {"json", *(field.name for field in fields(bench.Options))}
        assert options.keys() <= known, command
    elif name != "run":
        parameters = inspect.signature(COMMANDS[name]).parameters
        assert options.keys() <= parameters.keys(), command
        assert len(free) <= 1, command
    else:
        (experiment,) = free
        own = inspect.signature(launch.run_command("imitate", "demo")).parameters
        about_run = own.keys() - {"given", "config", "experiment"}
        unknown = options.keys() - about_run - GIVEN - SETTINGS
        assert not unknown, f"{command}: no option {unknown}"
        assert options.get("scale", ["demo"])[0] in ("demo", "full"), command
        assert set(options.get("only", ())) <= set(EXPERIMENTS[experiment].variants), command
        config = configuration(experiment, {k: v for k, v in options.items() if k in SETTINGS})
        assert ("frozen_reward" in options) == (config.reward == "frozen"), command
        assert ("pretrained_policy" in options) == (config.pretrained != "nothing"), command
        assert ("guide" in options) == (config.schedule.guide_steps > 0), command
        for about in ("dataset", "trajectories", "subsample"):
            assert about not in options or config.imitates, command


@pytest.mark.parametrize("command", [c for c in commands() if c != "offairl demos"])
def test_commands_and_their_settings_exist(command):
    require_command(command)


def test_the_first_page_is_short():
    text = (ROOT / "book/recipe.md").read_text()
    assert len(re.sub(r"```.*?```", "", text, flags=re.DOTALL).split()) <= 900
    assert text.index("| you have") < text.index("offairl run imitate") < 1_500


def test_its_small_table_is_the_large_one():
    found = r"(?m)^\| (Hopper|Walker2d|HalfCheetah|CustomAnt|Ant) \| (.*\(.*) \|$"
    rows = re.findall(found, PAGE)
    assert len(rows) == 5
    for robot, cells in rows:
        medians = [cell.split()[0] for cell in cells.split(" | ")[:2]]
        assert f"| *{robot}* | {' | '.join(medians)} |" in PAGE


def test_what_is_said_of_cloning_is_the_benchmark_s(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "book"))
    import benchmark_runs

    cells, text = benchmark_runs.read(), " ".join(PAGE.split())
    twenty, ten = (
        np.mean([benchmark_runs.summary(e).mean for e in benchmark_runs.clones_beside(n).values()])
        for n in ("20", "10")
    )
    fifty, four = (benchmark_runs.average(cells, count, "clone") for count in ("50", "4"))
    others = f"with fifty {fifty:.0f}, with ten {ten:.0f}, with four {four:.0f}"
    assert f"came to {twenty:.0f} % of the expert on average** ({others})." in text
    readme = " ".join((ROOT / "README.md").read_text().split())
    assert "on average over five robots?" in readme
    recipe, dac = (benchmark_runs.average(cells, "50", method) for method in ("airl", "dac"))
    assert f"| ten | {ten:.0f} | – | – | cloning |" in readme
    assert f"| fifty | {fifty:.0f} | {recipe:.0f} | {dac:.0f} | cloning |" in readme
    assert "The recipe trains for 100,000 steps." in readme
    assert "| | clone, 256-256 | clone, 64-64 | the run from it | recipe alone |" in PAGE
    small = benchmark_runs.clones_beside("4-small")
    for robot in benchmark_runs.ROBOTS:
        large, run, alone = (
            cells["4", robot, method].ends for method in ("clone", "airl-warm", "airl")
        )
        columns = large, small[robot], run, alone
        means = [f"{benchmark_runs.summary(ends).mean:.0f}" for ends in columns]
        assert f"| {robot} | {' | '.join(means)} |" in PAGE
        assert [len(ends) for ends in columns] == [10, 10, 5, 5]
        assert (int(means[2]) > int(means[1])) == ("Ant" not in robot)
        returns = records.read_json(demonstrations.EXPERTS / f"{robot}.json")["returns"]
        assert max(returns) > returns[0]
        # How the run compares with the larger clone, and with the one that it began from.
        signs = {
            "Hopper": (1, 1),
            "Walker2d": (1, 0),
            "HalfCheetah": (0, 0),
            "CustomAnt": (-1, -1),
            "Ant": (-1, -1),
        }
        leads = [difference(run, clone)[1:] for clone in columns[:2]]
        assert signs[robot] == tuple((low > 0) - (high < 0) for low, high in leads)
    of_one = benchmark_runs.average(cells, "1", "clone")
    clones = " | ".join(f"{mean:.0f}" for mean in (of_one, four, ten, twenty, fifty))
    assert f"| a clone | {clones} |" in PAGE
    own = [f"{benchmark_runs.average(cells, n, 'airl'):.0f}" for n in ("1", "4", "50")]
    assert f"| the recipe | {own[0]} | {own[1]} | – | – | {own[2]} |" in PAGE
    order = ("Hopper", "CustomAnt", "HalfCheetah", "Ant", "Walker2d")
    ends = [benchmark_runs.summary(cells["4", robot, "airl"].ends).mean for robot in order]
    said = "Hopper to {:.0f} %, CustomAnt to {:.0f}, HalfCheetah to {:.0f}, Ant to {:.0f}"
    assert f"{said} and Walker2d to {{:.0f}}.".format(*ends) in text
    worst = cells["4", "HalfCheetah", "airl-warm"].ends.min()
    assert f"One of HalfCheetah's five runs ended at {worst:.0f} %" in text


def test_the_readme_has_the_benchmark_as_it_is(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "book"))
    import benchmark_runs

    cells, text = benchmark_runs.read(), " ".join((ROOT / "README.md").read_text().split())
    assert benchmark_runs.short(cells) in (ROOT / "README.md").read_text()
    compared = benchmark_runs.clear(cells, "4", "airl", "clone")
    assert compared == (["Hopper"], ["HalfCheetah", "CustomAnt"])
    ahead = "clearly ahead of cloning on Hopper, and clearly behind on HalfCheetah and CustomAnt"
    assert f"{ahead}; on Walker2d and Ant the difference is not clear" in text

    def averages(block, *methods):
        return [f"{benchmark_runs.average(cells, block, method):.0f}" for method in methods]

    warm, clone, recipe, dac = averages("4", "airl-warm", "clone", "airl", "dac")
    take = f"cloning; if that is not good enough, the recipe begun from the clone: {warm} |"
    assert f"| four | {clone} | {recipe} | {dac} | {take}" in text
    one = " | ".join(averages("1", "clone", "airl", "dac"))
    assert f"| one | {one} | the recipe or DAC |" in text
    (states,) = averages("4", "state-dac")
    assert f"It comes to {states} % on average, and is clearly ahead of the recipe on" in text
    cold = [benchmark_runs.summary(ends).mean for ends in benchmark_runs.iq_learn_cold().values()]
    (warmer,) = averages("4", "iq-learn")
    said = f"*IQ-Learn at 0.01* comes to {np.mean(cold):.0f} % on average"
    assert f"{said}, IQ-Learn at 0.2 to {warmer}." in text
    thinned = [
        [
            benchmark_runs.number(
                benchmark_runs.summary(cells["4-thinned", robot, method].ends).mean
            )
            for robot in ("Hopper", "Walker2d", "HalfCheetah")
        ]
        for method in ("clone", "airl")
    ]
    cloned, learned = (f"{one}, {two} and {three}" for one, two, three in thinned)
    robots = "Hopper, Walker2d and HalfCheetah"
    assert f"it comes to {cloned} % on {robots}, and the recipe to {learned}." in text
    long = [
        f"{benchmark_runs.summary(cells['4-long', robot, 'airl'].ends).mean:.0f}"
        for robot in ("Hopper", "HalfCheetah")
    ]
    assert "the recipe comes to {} % on Hopper and {} on HalfCheetah".format(*long) in text


def test_who_is_ahead_with_some_of_the_cells(monkeypatch):
    """With none of them, some, or all."""
    monkeypatch.syspath_prepend(str(ROOT / "book"))
    import benchmark_runs as bench

    def cell(mean):
        return bench.Cell(mean + np.arange(5.0), 100_000, 1.0)

    assert bench.duels({}) == []
    some = {("4", "Hopper", "airl"): cell(80.0), ("4", "Hopper", "clone"): cell(50.0)}
    assert bench.duels(some) == [bench.Duel("4", "airl", "clone", {"Hopper": 1}, None)]
    shown = bench.show_duels(bench.duels(some)).data
    assert (shown.count("▲"), shown.count("▼"), shown.count("–")) == (1, 0, 5)
    table = bench.block_table(some, "4")
    assert table.count("–") == 8
    assert "Not run yet: DAC, state-only DAC, SQIL, IQ-Learn, the recipe from a clone" in table
    full = {key: cell(60.0 + 20 * (key[2] == "clone")) for key in bench.planned()}
    found = {duel[:3]: duel for duel in bench.duels(full)}
    assert set(found) == set(bench.DUELS)
    assert set(found["4", "dac", "airl"].signs.values()) == {0}
    behind = found["50", "airl", "clone"]
    assert set(behind.signs.values()) == {-1}
    assert behind.lead[0] == -20
    shown = bench.show_duels(bench.duels(full)).data
    assert shown.count("▼") == 5 * sum(other == "clone" for *_, other in bench.DUELS)
    assert "<b>−20</b>" in shown
    assert "Not run yet" not in bench.block_table(full, "4")


@pytest.mark.parametrize(
    "wrong",
    [
        "offairl run imitates",
        "offairl run imitate --replay-density mixture",
        "offairl run imitate --loss exactly",
        "offairl run imitate --reward frozen",
        "offairl run imitate --learner td3",
        "offairl watch runs/arm --members 0",
        "offairl train imitate",
    ],
)
def test_what_cannot_be_given_is_found(wrong):
    with pytest.raises((AssertionError, KeyError, ValueError)):
        require_command(wrong)


def test_options_in_the_text_exist_and_can_be_added_to_the_first_command():
    inline = re.findall(r"`(--[^`]+)`", PAGE)
    assert len(inline) > 10
    (first,) = [command for command in commands() if command.endswith("--out runs/arm")]
    for options in inline:
        added = parsed(f"offairl run {options}")[2]
        known = SETTINGS | GIVEN | {"scale", "step", "absorbing_state"}
        assert added.keys() <= known, options
        if all(added.values()) and added.keys() <= SETTINGS - {"pretrained"}:
            _, (experiment,), there = parsed(first)
            before = {name: texts for name, texts in there.items() if name in SETTINGS}
            configuration(experiment, before | added)


def test_the_table_of_settings_is_what_the_experiment_has():
    """As defaults at both scales, but for two rows, which are to be given."""
    section = PAGE.split("## What does each setting do?")[1].split("\n## ")[0]
    rows = set(re.findall(r"(?m)^\| `(--[^`]+)` \|", section))
    to_give = {"--absorbing bootstrap", "--train-every 1000"}
    assert to_give < rows
    for row in sorted(rows - to_give):
        ((name, texts),) = parsed(f"offairl run {row}")[2].items()
        for config in EXPERIMENTS["imitate"].configs.values():
            assert config.flat()[name] == value(texts), row


def test_recordings_become_a_data_set(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    monkeypatch.chdir(tmp_path)
    for i in range(20):
        obs, action = np.tile([-1.0, 0, 0], (6, 1)), np.zeros((5, 1))
        np.savez(f"episode-{i}.npz", obs=obs, action=action, terminated=i == 0)
    exec(block("episode-{i}.npz"), {})
    data = demonstrations.load("Pendulum-v1", 20, "own/recorded-v0")
    assert data.lengths == (5,) * 20
    assert data.transitions.terminated.sum() == 1


def block(word):
    """The only Python block with a word, on a task that is here."""
    (found,) = [block for block in blocks("python") if word in block]
    return found.replace("my_robot:Arm-v0", "Pendulum-v1")


@pytest.fixture
def minari_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))


@pytest.fixture
def sb3():
    reason = "stable-baselines3 is not installed: pip install -e '.[sb3]'"
    return pytest.importorskip("stable_baselines3", reason=reason)


def test_a_controller_demonstrates(minari_folder):
    exec(block("def controller"), {})
    assert demonstrations.load("Pendulum-v1", 50, "own/scripted-v0").lengths == (200,) * 50


def test_a_model_demonstrates(minari_folder, sb3, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sb3.SAC("MlpPolicy", "Pendulum-v1", device="cpu").save("expert.zip")
    exec(block('SAC.load("expert.zip")\ndem').replace("50", "2"), {})
    assert demonstrations.load("Pendulum-v1", 2, "own/model-v0").lengths == (200, 200)


def test_a_model_with_scaled_observations_demonstrates(minari_folder, sb3, tmp_path, monkeypatch):
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import VecNormalize

    monkeypatch.chdir(tmp_path)
    sb3.SAC("MlpPolicy", "Pendulum-v1", device="cpu").save("expert.zip")
    VecNormalize(make_vec_env("Pendulum-v1")).save("vecnormalize.pkl")
    code = block("vecnormalize.pkl").replace("50", "2")
    with pytest.raises(ValueError, match="VecNormalize"):  # Nobody has trained it.
        exec(code, {})
    exec(code.replace("at_least=-300", "at_least=-4000"), {})
    assert demonstrations.load("Pendulum-v1", 2, "own/scaled-v0").lengths == (200, 200)


def test_a_reward_is_compared_on_two_recordings(tmp_path, monkeypatch, capsys):
    """On the maze it pays the expert more than whoever stays at the start."""
    obs = demonstrations.load("offairl/PointMazeLeft-v0", 1).transitions.obs
    monkeypatch.chdir(tmp_path)
    np.save("well.npy", obs.numpy())
    np.save("badly.npy", np.tile(obs[0], (100, 1)))
    code = block('np.load(f"{episode}.npy")')
    code = code.replace("runs/arm", str(RECORDS / "maze-imitation-demo"))
    exec(code.replace("Pendulum-v1", "offairl/PointMazeLeft-v0"), {})
    well, badly = (float(line.split()[1]) for line in capsys.readouterr().out.splitlines())
    assert well > badly


def test_two_variants_teach_one_reward(minari_folder, own, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    actions = gymnasium.spaces.Box(-1, 1, (2,))
    for name, mass in (("Light-v0", 1.0), ("Heavy-v0", 4.0)):
        env_id = own(f"mine/{name}", actions=actions, mass=mass)
        demonstrations.generate(lambda obs: -obs.clip(-1, 1), env_id, 10, f"own/{name}")
    compare, learn = (
        block(word).replace("my_robot:", "mine/") for word in ("tabular.apart", "worlds.train")
    )
    exec(compare, known := {})
    small = {
        "100_000": "20",
        "=1_000": "=10",
        "=10)": "=10, batch_size=4, hidden=(8,), learning_starts=10)",
    }
    for number, smaller in small.items():
        assert number in learn
        learn = learn.replace(number, smaller)
    exec(learn, known)
    reward = Reward.load("runs/both/reward.safetensors")
    assert reward.net.sizes[0] == 2
    assert len(reward) == 3


def test_distances_of_variants_are_those_of_the_record():
    record = json.loads((RECORDS / "rollouts/two_mazes.json").read_text("utf-8"))
    times = {
        name: [round(worlds / halves, 1) for worlds, halves in pairs]
        for name, pairs in record["distances"].items()
    }
    names = ("Turned", "Weak", "Right", "Left")
    ends = [f(times[f"PointMaze{name}"]) for name in names for f in (min, max)]
    text = PAGE[PAGE.index("turned controls came to") :].split("\n\n")[0]
    stated = re.findall(r"([\d.]+) to ([\d.]+[\d])", text)
    pairs = [tuple(map(float, pair)) for pair in stated]
    assert [x for pair in pairs for x in pair] == ends


def test_flat_arrays_demonstrate(minari_folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    starts = np.arange(20) % 10 == 0
    obs, actions = np.tile([-1.0, 0, 0], (20, 1)), np.zeros((20, 1))
    np.savez("expert_arm.npz", obs=obs, actions=actions, episode_starts=starts)
    exec(block("expert_arm.npz"), {})
    assert demonstrations.load("Pendulum-v1", 2, "own/flat-v0").lengths == (9, 9)


def test_discrete_actions():
    try:
        exec(block("OneHotActions"), names := {})
        assert names["recorded"].shape == (4, 2)
        assert gymnasium.make("BoxCartPole-v0").action_space.shape == (2,)
        assert gymnasium.make("BoxCartPole-v0", render_mode="rgb_array").render_mode == "rgb_array"
    finally:
        gymnasium.registry.pop("BoxCartPole-v0", None)


def test_dictionaries_are_flattened_as_the_task_s_are(monkeypatch):
    class Reach(gymnasium.Env):
        observation_space = gymnasium.spaces.Dict(
            {name: gymnasium.spaces.Box(-1, 1, (size,)) for name, size in PARTS.items()}
        )
        action_space = gymnasium.spaces.Box(-1, 1, (4,))

        def reset(self, **_):
            return self.observation_space.sample(), {}

    exec(block("achieved_goal"), names := {})
    assert [len(each.action) for each in names["recordings"]] == [49] * 20
    spec = gymnasium.envs.registration.EnvSpec("Reach-v0", Reach, max_episode_steps=50)
    monkeypatch.setitem(gymnasium.registry, "Reach-v0", spec)
    shown = demonstrations.of(names["recordings"], "Reach-v0")
    assert shown.transitions.obs.shape == (20 * 49, 16)


def test_trajectories_of_imitation_become_recordings():
    exec(block("from_imitation"), names := {})
    whole, cut = (
        SimpleNamespace(obs=np.zeros((n + 1, 3)), acts=np.zeros((n, 1)), terminal=True)
        for n in (7, 50)
    )
    found = names["from_imitation"]([whole, cut], 50)
    assert [r.terminated for r in found] == [True, False]
    assert [len(r.obs) for r in found] == [8, 51]


def test_the_class_does_all_of_it(tmp_path, monkeypatch, capsys):
    """Its lines, with fewer steps; actions out of bounds are refused, so the controller clips."""
    from offairl_lite import AIRL

    monkeypatch.chdir(tmp_path)
    small = "hidden=(8,), reward_hidden=(8,), eval_episodes=1, trajectories=2, learning_starts=200"
    code = block("def push").replace("100_000", "400").replace("50_000", "200")
    code = code.replace("seeds=3", f"seeds=1, train_every=200, {small}")
    exec(code, names := {})
    assert names["action"].shape == (1,)
    assert AIRL.load("arm").run.steps.max() == 400
    assert float(capsys.readouterr().out.split()[0]) == names["model"].reward([0.0, 1.0, 0.0])


def test_a_task_with_other_arguments_is_registered(write_dataset):
    arguments = {"include_cfrc_ext_in_observation": False}
    write_dataset("mujoco/ant/own-v0", "Ant-v5", 1, **arguments)
    try:
        exec(block("BlindAnt"), {})
        assert (
            demonstrations.load("BlindAnt-v0", 1, "mujoco/ant/own-v0").transitions.obs.shape[1]
            == 27
        )
    finally:
        gymnasium.registry.pop("BlindAnt-v0", None)


def test_another_trainer_is_paid_by_a_learned_reward(sb3, monkeypatch):
    """With SB3_TRAINS=1 these are the page's lines, 40 seconds of one core: the new way is found.

    Otherwise they take fewer steps.
    """
    monkeypatch.chdir(ROOT)
    code, whole = block("LearnedReward"), "SB3_TRAINS" in os.environ
    names = {}
    exec(code if whole else code.replace("000", "00"), names)
    env, model = names["env"], names["model"]
    assert model.num_timesteps == (8000 if whole else 800)
    env.training, own, done = False, 0.0, [False]
    obs = env.reset()
    while not done[0]:
        obs, _, done, (info,) = env.step(model.predict(obs, deterministic=True)[0])
        own += info["task_reward"]
    assert (own > -14) or not whole
    env.close()


def test_what_another_trainer_has_learned_is_recorded():
    import rollouts
    from rollouts import another_trainer

    kept, text = rollouts.read("another_trainer"), " ".join(PAGE.split())
    assert {len(ends) for ends in kept.values()} == {5}
    whole, *without = (int((kept[left_out] > -14).sum()) for left_out in another_trainer.LINES)
    assert whole == 5
    noise, updates, scaled = (("none", "one", "two", "three", "four", "all")[n] for n in without)
    said = f"Without the noise {noise} of five, without `train` {updates}, without `VecNormalize`"
    assert f"{said} {scaled}." in text
    ends = [f"{end:.1f}".replace("-", "−") for end in sorted(kept["nothing"])]
    assert f"return between {ends[0]} and {ends[-1]} on the task's own reward" in text
    assert all(another_trainer.program(left_out, 3) for left_out in another_trainer.LINES)


def test_the_diagnostics_can_be_read(capsys):
    (block,) = [block for block in blocks("python") if "lengths" in block]
    run = RECORDS / "hopper-absorbing-demo/dac-bootstrap"
    block = block.replace("my_robot:Arm-v0", records.read(run).config.env_id)
    exec(block.replace("runs/arm", str(run)), {})
    assert capsys.readouterr().out.count("\n") >= len(records.read(run).seeds) + 1


def test_a_good_run_and_a_failed_one_print_what_the_page_shows(monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    shown = [b for b in blocks("python") if "for name in (" in b or "for run in (" in b]
    assert len(shown) == 2
    for code in shown:
        exec(code, {})
        assert f"```text\n{capsys.readouterr().out}```" in PAGE


def test_the_policy_acts(tmp_path, monkeypatch):
    from offairl_lite import AIRL

    monkeypatch.chdir(tmp_path)
    task, small = "offairl/PointMazeLeft-v0", {"hidden": (8,), "eval_episodes": 1}
    AIRL(task, seeds=1, train_every=100, learning_starts=100, folder="runs/arm", **small).learn(200)
    code = block("model.predict(obs, seed=0)").replace("Pendulum-v1", task)
    exec(code, known := {})
    assert known["env"].observation_space.contains(known["obs"])


def test_the_reward_is_used_again_in_python(tmp_path, monkeypatch):
    from offairl_lite import AIRL

    monkeypatch.chdir(tmp_path)
    small = {"hidden": (8,), "reward_hidden": (8,), "eval_episodes": 1, "train_every": 100}
    first = AIRL("offairl/PointMazeLeft-v0", folder="runs/arm", learning_starts=100, **small)
    reward = first.learn(200, progress=False).reward(np.zeros((1, 3)))
    code = block("frozen_reward=").replace("my_robot:HeavyArm-v0", "offairl/PointMazeRight-v0")
    code = code.replace("3_000", "100").replace("seeds=3", "seeds=3, train_every=100")
    exec(code.replace("100_000", "200"), names := {})
    assert names["model"].run.steps.max() == 200
    assert names["model"].reward(np.zeros((1, 3))) == pytest.approx(reward)


def test_weights_and_biases_gets_every_number(monkeypatch):
    logged, projects = [], []
    fake = SimpleNamespace(
        log=lambda numbers, step: logged.append((step, numbers)),
        init=lambda project: projects.append(project) or nullcontext(),
    )
    monkeypatch.setitem(sys.modules, "wandb", fake)
    callback, record = (block for block in blocks("python") if "wandb" in block)
    known, folder = {}, RECORDS / RECIPE["Hopper"]
    exec(callback, known)
    exec(record.replace("runs/arm", str(folder)), known)
    rows = records.read(folder).rows
    assert projects == ["arm"]
    assert [step for step, _ in logged] == [row.step for row in rows]
    for (_, numbers), row in zip(logged, rows, strict=True):
        assert numbers.pop(f"return/seed-{row.seed}") == row.mean_return
        assert numbers == {f"{name}/seed-{row.seed}": x for name, x in row.metrics.items()}
    seen = []
    known["wandb"] = SimpleNamespace(log=lambda numbers, step: seen.append(step))
    config = EXPERIMENTS["maze-expert"].configs["demo"]
    config = config.change(total_steps=200, learning_starts=100, eval_every=100, hidden=(8,))
    train(config, (0, 1), progress=False, on_evaluation=known["to_wandb"])
    assert seen == [100, 100, 200, 200]


def test_results_become_tables_and_intervals(capsys):
    pytest.importorskip("pandas", reason="pandas is not installed: pip install -e '.[frames]'")
    table, intervals = (b for b in blocks("python") if "pandas" in b or "rliable" in b)
    known = {}
    for runs, ours in ((RECIPE, "arm"), (OTHER, "arm-dac")):
        folders = ", ".join(f'"{RECORDS / name}"' for name in runs.values())
        table = table.replace(f'["runs/{ours}"]', f"[{folders}]")
    exec(table, known)
    assert "airl" in (out := capsys.readouterr().out)
    assert "Walker2d-v5" in out
    # With pandas 3 it is there, and fails with a TypeError.
    why = "rliable is not installed, or not with its pandas: pip install rliable 'pandas<3'"
    pytest.importorskip("rliable.library", reason=why, exc_type=Exception)
    exec(intervals, known)
    for method, names in (("airl", RECIPE), ("dac", OTHER)):
        columns = [records.read(RECORDS / names[robot]).returns[:, -1] for robot in RECIPE]
        assert known["scores"][method].tolist() == np.stack(columns, 1).tolist()
        (low,), (high,) = known["intervals"][method]
        assert low < known["means"][method][0] < high


def test_the_policy_acts_without_the_package(tmp_path, monkeypatch):
    pytest.importorskip("onnxruntime", reason="ONNX is not installed: pip install -e '.[export]'")
    monkeypatch.chdir(tmp_path)
    (line,) = [command for command in commands() if command.startswith("offairl export runs/arm")]
    run = RECORDS / "maze-imitation-demo"
    line = line.replace("my_robot:Arm-v0", "offairl/PointMazeLeft-v0")
    cli.main(shlex.split(line.replace("runs/arm", str(run)))[1:])
    (block,) = [block for block in blocks("python") if "onnxruntime" in block]
    exec(block, known := {})
    space = gymnasium.make("offairl/PointMazeLeft-v0").action_space
    wanted = action(records.read(run).policy.member(0), np.zeros(3), space)
    assert known["action"][0] == pytest.approx(wanted, abs=1e-5)


def late(name):
    """The evaluations in the second half of a recorded run."""
    run = records.read(RECORDS / name)
    return [row for row in run.rows if row.step > run.steps[-1] / 2]


def gaps(rows):
    return np.array([row.metrics["expert_logit"] - row.metrics["policy_logit"] for row in rows])


RECIPE = {
    robot: f"what-decides-demo/{robot}-released-fixed-short" for robot in ("Hopper", "Walker2d")
}
OTHER = {robot: name.replace("released", "dac") for robot, name in RECIPE.items()}
FAILED = {robot: f"locomotion-first-demo/{robot}-airl" for robot in RECIPE}


def test_the_ranges_are_those_of_the_records():
    """Of the good and the failed runs on each robot, side by side."""

    def row(title, values, digits):
        cells = (
            f"{min(found):,.{d}f}–{max(found):,.{d}f}"
            for found, d in zip(values, digits, strict=True)
        )
        return f"| {title} | {' | '.join(cells)} |"

    titles = {"entropy": "`entropy` of the verdict"}
    for robot in RECIPE:
        table = PAGE[PAGE.index(f"| on {robot} | good | failed |") :].split("\n\n")[0]
        names = [runs[robot] for runs in (RECIPE, FAILED)]
        found = [gaps(late(name)) for name in names]
        assert row("logit gap, expert minus policy", found, (1, 0)) in table
        for metric, digits in (("entropy", 2), ("penalty", 3), ("accuracy", 2), ("critic_loss", 0)):
            found = [[row.metrics[metric] for row in late(name)] for name in names]
            assert row(titles.get(metric, f"`{metric}`"), found, [digits] * 2) in table
    for robot, walking in (("Hopper", 1), ("Walker2d", 0)):
        returns = records.read(RECORDS / FAILED[robot]).returns[:, -1]
        assert len(returns) == 3
        assert sum(returns > 0.4 * demonstrated(robot)) == walking


def test_the_ranges_of_the_recipe_s_loss_are_those_of_the_records():
    """Of a good run and of one with one setting changed, on three robots."""
    runs = {
        "Hopper, good": "what-decides-demo/Hopper-released-fixed-short",
        "Hopper, nothing after the end": "hopper-none-demo/Hopper-released-fixed-short",
        "Walker2d, good": "what-decides-demo/Walker2d-released-fixed-short",
        "Walker2d, 10,000 random steps": "what-decides-demo/Walker2d-released-fixed-long",
        "HalfCheetah, good": "what-decides-demo/HalfCheetah-released-fixed-short",
        "HalfCheetah, a temperature of 1": "what-decides-demo/HalfCheetah-released-one-short",
    }
    for title, name in runs.items():
        assert records.read(RECORDS / name).config.discriminator.loss == "log-ratio"
        gap = gaps(late(name))
        entropy = [row.metrics["entropy"] for row in late(name)]
        ends = records.read(RECORDS / name).returns[:, -1]
        cells = (
            f"{gap.min():.1f}–{gap.max():.1f}",
            f"{min(entropy):.2f}–{max(entropy):.2f}",
            f"{ends.min():,.0f}–{ends.max():,.0f}".replace("-", "−"),
        )
        assert f"| {title} | {' | '.join(cells)} |" in PAGE


def test_within_a_run_both_improve_with_time():
    for name in RECIPE.values():
        rows = records.read(RECORDS / name).rows
        steps = [row.step for row in rows]
        assert spearmanr(gaps(rows), steps)[0] < -0.5
        assert spearmanr([row.mean_return for row in rows], steps)[0] > 0.5


def test_the_warning_is_where_good_and_failed_runs_part():
    """The largest gap of the good ones and the smallest of the failed ones, in the second half."""
    changed = "hopper-none-demo/Hopper-released-fixed-short"
    walker, hopper = gaps(late(RECIPE["Walker2d"])).max(), gaps(late(changed)).min()
    said = f"gap reached {walker:.1f}, and a failed hopper's came down to {hopper:.1f}"
    assert said in " ".join(PAGE.split())


def test_the_bet_on_accuracy():
    good, failed = (
        [row.metrics["accuracy"] for row in late(runs["Walker2d"])] for runs in (RECIPE, FAILED)
    )
    low, *_, high = sorted(round(100 * accuracy) for accuracy in failed)
    said = f"accuracy of {100 * min(good):.0f} % or more, the other with {low} to {high} %"
    assert said in " ".join(PAGE.split())


def test_the_gap_tells_good_seeds_from_bad_ones():
    names = [
        "what-decides-demo/Walker2d-released-fixed-short",
        "what-decides-more-demo/Walker2d-released-fixed-short",
        "locomotion-demo/Walker2d-airl",
        "locomotion-again-demo/Walker2d-airl",
    ]
    rows = [row for name in names for row in records.read(RECORDS / name).rows]
    rows = [row for row in rows if row.step == 100_000]
    assert len(rows) == 25
    found = spearmanr(gaps(rows), [row.mean_return for row in rows])[0]
    said = f"correlation of gap and return is −{-found:.1f} (Walker2d)"
    assert said in " ".join(PAGE.split())


def demonstrated(robot):
    return records.read_json(demonstrations.EXPERTS / f"{robot}.json")["demonstrated"][0]


def expert(robot):
    """What the first expert returns without noise."""
    return records.read_json(demonstrations.EXPERTS / f"{robot}.json")["returns"][0]


def after(robot, method, steps):
    """Returns after so many steps of all recorded seeds with the recipe's settings, or DAC's."""
    loss = "released" if method == "airl" else method
    names = [
        f"what-decides-demo/{robot}-{loss}-fixed-short",
        f"what-decides-more-demo/{robot}-{loss}-fixed-short",
        f"locomotion-demo/{robot}-{method}",
        f"locomotion-again-demo/{robot}-{method}",
    ]
    runs = [records.read(RECORDS / name) for name in names if (RECORDS / name).is_dir()]
    return np.concatenate([run.returns[:, run.steps == steps].ravel() for run in runs])


def test_the_percentages_are_those_of_the_records():
    counts = {"Walker2d": (25, 5, 20, 5), "Ant": (3, 3, 3, 3)}
    for robot in ("Hopper", "Walker2d", "HalfCheetah", "CustomAnt", "Ant"):
        ends = [
            100 * after(robot, method, steps) / expert(robot)
            for method in ("airl", "dac")
            for steps in (100_000, 500_000)
        ]
        assert tuple(map(len, ends)) == counts.get(robot, (10, 5, 10, 5))
        cells = [f"{np.median(end):.0f} ({end.min():.0f}–{end.max():.0f})" for end in ends]
        assert f"| {robot} | {' | '.join(cells)} |" in PAGE
    best = [
        records.read_json(demonstrations.EXPERTS / f"{r}.json")["returns"]
        for r in ("Hopper", "HalfCheetah")
    ]
    (there, here), (runs, ran) = ([f"{x:,.0f}" for x in (max(each), each[0])] for each in best)
    assert f"Hopper's returns {there} there and {here} here, HalfCheetah's {runs} and {ran}" in PAGE
    cheetah = records.read(RECORDS / "locomotion-long-demo/HalfCheetah-airl")
    late = 100 * cheetah.returns[:, -1] / expert("HalfCheetah")
    assert cheetah.steps[-1] == 1_000_000
    assert f"after a million steps it reaches {late.min():.0f}–{late.max():.0f} %" in PAGE
    falls = [
        int(demonstrations.load(f"{robot}-v5", experts=1).transitions.terminated.sum())
        for robot in ("Hopper", "Ant")
    ]
    text = " ".join(PAGE.split())
    assert f"{falls[0]} of Hopper's 50 end in a fall" in text
    assert "and about half of Ant's" in text
    assert falls[1] in range(20, 31)
    walker = records.read(RECORDS / "locomotion-demo/Walker2d-airl")
    worst = 100 * walker.returns.min(0) / expert("Walker2d")
    at, end = worst[walker.steps == 100_000][0], worst[-1]
    said = (
        f"at {at:.0f} % of the expert after 100,000 steps, and the worst at the end at {end:.0f} %"
    )
    assert said in text
    hopper = records.read(RECORDS / "locomotion-demo/Hopper-airl").returns
    second_half = hopper[:, hopper.shape[1] // 2 :]
    assert round(100 * (second_half < 0.75 * demonstrated("Hopper")).mean()) == 18


def test_what_is_said_of_dac_beside_the_recipe():
    def ratio(robot, steps):
        recipe, dac = (
            interquartile_mean(after(robot, method, steps)) for method in ("airl", "dac")
        )
        return recipe / dac

    assert 0.95 < ratio("HalfCheetah", 100_000) < 1.05
    assert 0.95 < ratio("Hopper", 100_000) < 1.05
    recipe, dac = (records.read(RECORDS / f"locomotion-demo/Hopper-{m}") for m in ("airl", "dac"))
    halves = [run.returns[:, len(run.steps) // 2 :].mean(1) for run in (recipe, dac)]
    assert 0.95 < interquartile_mean(halves[0]) / interquartile_mean(halves[1]) < 1.05
    assert min(ratio("Walker2d", 100_000), ratio("Walker2d", 500_000)) > 1.1
    assert ratio("CustomAnt", 100_000) < 0.9
    assert 0.95 < ratio("CustomAnt", 500_000) < 1.05

    def medians(robot, steps):
        return [
            round(100 * np.median(after(robot, m, steps)) / expert(robot)) for m in ("dac", "airl")
        ]

    for robot in ("Hopper", "Walker2d", "HalfCheetah", "CustomAnt", "Ant"):
        dac, airl = medians(robot, 100_000)
        assert f"| {robot} | fifty, first expert | {dac} | {airl} |" in PAGE
    text = " ".join(PAGE.split())
    for robot, said in (("Walker2d", "behind on Walker2d"), ("Hopper", "evaluation differ")):
        assert "{}, {} against {}".format(said, *medians(robot, 500_000)) in text


def test_dac_on_walker2d_and_halfcheetah_depends_on_the_demonstrations(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "book"))
    import benchmark_runs

    cells, text = benchmark_runs.read(), " ".join(PAGE.split())
    assert benchmark_runs.clear(cells, "4", "airl", "dac") == ([], ["Walker2d"])
    assert benchmark_runs.clear(cells, "50", "airl", "dac") == (["HalfCheetah"], [])

    for robot, count, said in (
        ("Walker2d", "50", "fifty"),
        ("Walker2d", "4", "four"),
        ("HalfCheetah", "50", "fifty"),
    ):
        ends = (cells[count, robot, method].ends for method in ("dac", "airl"))
        dac, recipe = (benchmark_runs.summary(x).mean for x in ends)
        assert f"| {robot} | {said}, strongest expert | {dac:.0f} | {recipe:.0f} |" in text


def test_the_defaults_were_best_or_level():
    for robot in ("Hopper", "Walker2d", "HalfCheetah", "CustomAnt"):
        place = RECORDS / "what-decides-demo"
        recipe = records.read(place / f"{robot}-released-fixed-short").returns[:, -1]
        for loss, temperature, warmup in (
            ("exact", "fixed", "short"),
            ("released", "one", "short"),
            ("released", "learned", "short"),
            ("released", "fixed", "long"),
        ):
            other = records.read(place / f"{robot}-{loss}-{temperature}-{warmup}").returns[:, -1]
            assert difference(other, recipe)[1] < 0, (robot, loss, temperature, warmup)


def wall(name):
    return records.read_json(RECORDS / name / "run.json")["wall_s"]


def test_the_hours_are_those_of_the_records():
    recipe = [wall(name) / 3600 for name in RECIPE.values()]
    assert {f"{hours:.2f}" for hours in recipe} == {"0.24"}
    small = [
        wall(f"locomotion-demo/{robot}-{method}") / 3600
        for robot in ("Hopper", "Walker2d", "HalfCheetah", "CustomAnt")
        for method in ("airl", "dac")
    ]
    assert f"{min(small):.1f}–{max(small):.1f}" == "0.4–2.5"
    large = [wall(path.parent.relative_to(RECORDS)) / 3600 for path in LARGE.glob("*/run.json")]
    assert f"{min(large):.1f}–{max(large):.1f}" == "1.2–2.3"
    times = 10 * 1_000_000 / (3 * 500_000)
    assert f"{min(large) * times:.0f}–{max(large) * times:.0f}" == "8–15"
    for row in ("0.24", "0.4–2.5", "1.2–2.3", "8–15"):
        assert f" | {row} | " in PAGE
    note = (ROOT / "book/notes/cost_of_the_runs.ipynb").read_text("utf-8")
    for row in ("0.4 to 2.5", "1.2 to 2.3", "8 to 15"):
        assert f"| {row} hours" in note
    pairs = [(name.replace("released", "dac"), name) for name in RECIPE.values()]
    for size, robot in itertools.product(("demo", "full"), ("Hopper", "Walker2d")):
        pairs.append(tuple(f"locomotion-{size}/{robot}-{method}" for method in ("dac", "airl")))
    ratios = [wall(dac) / wall(recipe) for dac, recipe in pairs]
    assert 0.4 < min(ratios) < max(ratios) < 0.85


def test_the_learned_return_tells_which_seeds_have_found_the_way():
    """All populations of the maze's transfer with paper-size networks, and the ants."""
    learned = {True: [], False: []}
    for folder in (RECORDS / "maze-retraining-full").iterdir():
        last = {row.seed: row for row in records.read(folder).rows}
        for row in last.values():
            learned[row.mean_return > -14].append(row.learned_return)
    assert len(learned[True]) > 50
    assert len(learned[False]) > 50
    assert max(learned[False]) < min(learned[True])
    ants = records.read(RECORDS / "decides-transfer-demo/state/scratch")
    of = [[row.learned_return for row in ants.rows if row.seed == seed] for seed in ants.seeds]
    assert sum(last > 0.7 * first for first, *_, last in of) == 4
    assert ants.returns[:, -1].max() < 100


@pytest.mark.parametrize(
    ("picture", "above", "below"),
    [("slow", 3_500, 3_200), ("weak", 300, 50), ("cramped", 900, -80)],
)
def test_a_strip_shows_what_its_caption_says(picture, above, below, monkeypatch):
    """Both episodes last to their end, and the upper one returns more."""
    monkeypatch.syspath_prepend(str(ROOT / "book/_static"))
    import compared

    drawn = {}
    monkeypatch.setattr(compared, "draw", lambda *given, **_: drawn.update([given]))
    runpy.run_path(str(ROOT / f"book/_static/{picture}.py"))
    upper, lower = (compared.played(*row)[1] for row in drawn[picture].items())
    assert upper.lengths == lower.lengths == 1_000
    assert upper.returns > above > below > lower.returns
    note = nbformat.read(ROOT / "book/notes/ant_rewards.ipynb", as_version=4).cells[0].source
    (shown,) = re.findall(rf"_static/{picture}\.png\n(.*?)\n```", PAGE + note, re.DOTALL)
    assert len(shown.rpartition("\n\n")[2].split()) <= 40
    assert (ROOT / f"book/_static/{picture}.png").stat().st_size <= 250_000


def test_what_is_printed_is_of_the_records():
    run = records.read(RECORDS / "maze-transfer-demo")
    for seed, reached in zip(run.seeds, run.returns[:, -1], strict=True):
        assert f"    {seed}     8,000{reached:11.2f}\n" in PAGE
    readme = (ROOT / "README.md").read_text()
    (tried,) = re.findall(r"```bash\n(offairl .*?)```", readme, re.DOTALL)
    require_command(tried.replace("\\\n", " "))
    (shown,) = re.findall(r"```text\n.*?```", readme, re.DOTALL)
    assert shown in PAGE
    config = records.read_json(RECORDS / "maze-transfer-demo/config.json")
    assert (config["experiment"], config["scale"]) == ("maze-transfer", "demo")
    exported = records.read(RECORDS / "maze-imitation-demo")
    (last,) = (row for row in exported.rows if (row.seed, row.step) == (0, exported.steps[-1]))
    assert f"Member 0: seed 0, return {last.mean_return:.3f} at step {last.step:,}" in PAGE
    assert f"return {demonstrated('CustomAnt'):.2f} (from 460.28 to 2113.22)" in PAGE


def test_what_transfers():
    """The rest of what is said of the maze is asserted in chapter 9."""
    maze = records.read(RECORDS / "maze-retraining-full/scratch").returns[:, -1]
    assert len(maze) == 10
    assert (maze > -14).all()
    assert "| AIRL | paper-size | 10,000 | 10 of 10 | not run |" in PAGE
    rewards = RECORDS / "maze-transfer-rewards-demo"
    kept = records.read(rewards / "implementation-4-released-and-airl/policy").returns[:, -1]
    tried = {
        "AIRL": (records.read(RECORDS / "maze-transfer-demo").returns[:, -1], kept[:5]),
        "log-ratio": (
            records.read(rewards / "released-and-airl/scratch").returns[:5, -1],
            kept[5:10],
        ),
    }
    for loss, ends in tried.items():
        scratch, policy = (f"{(end > -14).sum()} of {len(end)}" for end in ends)
        assert f"| {loss} | small | 3,000 | {scratch} | {policy} |" in PAGE
    whole, velocity, true = (
        records.read(RECORDS / "decides-transfer-demo" / reward / "scratch").returns[:, -1].round()
        for reward in ("state", "velocity", "true")
    )
    assert len(whole) == len(velocity) == 5
    assert whole.max() < 10
    warm = "centred, `--temperature None`"

    def row(settings, returns):
        return f"| {settings} | {returns.min():.0f} to {returns.max():.0f} |"

    assert row(f"from scratch, {warm}, 10,000 random steps", velocity) in PAGE
    assert (
        row(
            "from scratch on the *true* reward, `--temperature None`, 10,000 random steps "
            "({doc}`chapter 10 <10_where_rewards_fail>`)",
            true,
        )
        in PAGE
    )
    plain, short, cool, both = (
        records.read(RECORDS / f"decides-transfer-demo/velocity-{name}/scratch").returns[:, -1]
        for name in ("recipe-raw", "short", "cool", "recipe")
    )
    assert row("from scratch, the recipe's", plain) in PAGE
    for other in (short, cool, both, velocity):
        _, low, high = difference(other, plain)
        assert low < 0 < high
    assert f"| from scratch, {warm}, 1,000 random steps | one of five did not walk |" in PAGE
    assert (short > 100).sum() == 4
    assert min(cool.min(), both.min()) > 100
    kept, learned = (
        records.read(RECORDS / f"decides-transfer-demo/{name}/policy").returns[:, -1]
        for name in ("velocity-recipe", "velocity")
    )
    assert row("from the old policy, centred", kept) in PAGE
    assert row(f"from the old policy, {warm}", learned) in PAGE
    assert 0 < difference(learned, kept)[1] < 10
    marsh = records.read(RECORDS / "decides-marsh-demo/released-50/west").returns[:, -1]
    assert (marsh > -16).sum() == 1


def test_which_policy_to_take_is_what_the_record_says():
    import rollouts

    text = (ROOT / "book/recipe_working.md").read_text()
    table = text[text.index("| a seed's policy is |") :].split("\n\n")[0].splitlines()
    shown = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table]
    rules = ("the last", "the mean of the weights", "the learned return", "the length")
    for robot, worth in rollouts.read("which_policy").items():
        column = shown[0].index(f"on {robot.removesuffix('-airl')}")
        said = [int(line[column].replace(",", "")) for line in shown[2:]]
        assert said == [round(float(worth[rule].mean())) for rule in (*rules, "the true return")]
        assert worth["the mean of the weights"].mean() > worth["the last"].mean()
