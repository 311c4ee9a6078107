"""The class that a user meets first."""

from pathlib import Path
from types import SimpleNamespace

import gymnasium
import minari
import numpy as np
import pytest
import torch
from minari.data_collector.episode_buffer import EpisodeBuffer
from own_task import BOX, Arm, Goal, as_parts

from offairl_lite import AIRL, demonstrations, envs
from offairl_lite.core.rollouts import action
from offairl_lite.demonstrations import Recording
from offairl_lite.learned_reward import LearnedReward
from offairl_lite.runs import folders, pictures, records
from offairl_lite.runs.export import export

SMALL = {
    "learning_starts": 20,
    "train_every": 10,
    "batch_size": 4,
    "hidden": (8,),
    "reward_hidden": (4,),
    "shaping_hidden": (4,),
    "eval_every": 20,
    "eval_episodes": 1,
}


def controller(obs):
    return np.clip([-obs[0], 0.5], [-2, 0], [4, 1])


def episode(seed=0, steps=5):
    rng = np.random.default_rng(seed)
    actions = rng.uniform([-2, 0], [4, 1], (steps, 2))
    return np.concatenate([rng.uniform(-1, 1, (1, 2)), actions]), actions


def arm(**kwargs):
    return gymnasium.wrappers.TimeLimit(Arm(**kwargs), 5)


def small(env, demos=controller, **options):
    return AIRL(env, demos, **{"seeds": 2, "trajectories": 2, **SMALL, **options})


@pytest.fixture(autouse=True)
def undrawn(monkeypatch):
    monkeypatch.setattr(pictures, "draw", lambda folder: None)
    monkeypatch.setattr(records, "_commit", lambda: None)  # Git takes longer than the run.


@pytest.fixture
def task(own):
    return own("ownbot/Arm-v0")


@pytest.fixture
def model(task):
    return small(task).learn(40, progress=False)


def same(one, other):
    """Whether two models are the same to the last bit."""
    assert one.run.rows == other.run.rows
    for mine, yours in ((one.run.policy, other.run.policy), (one.run.reward, other.run.reward)):
        assert torch.equal(mine.params, yours.params)


def test_twice_is_the_same_as_at_once(task, model, caplog):
    twice = small(task).learn(25, progress=False).learn(3, progress=False)
    assert "nothing was learned in these 3 steps" in caplog.text
    assert "after every 10, next at step 30" in caplog.text
    twice.learn(12, progress=False)
    rows = {(row.seed, row.step): row.mean_return for row in twice.run.rows}
    assert {(r.seed, r.step): r.mean_return for r in model.run.rows}.items() <= rows.items()
    assert torch.equal(model.run.policy.params, twice.run.policy.params)
    assert torch.equal(model.run.reward.params, twice.run.reward.params)


def test_what_is_saved_goes_on_as_if_it_had_not_been(task, tmp_path):
    model = small(task, demos=[episode(), episode(1)]).learn(30, progress=False)
    model.save(tmp_path / "arm")
    loaded = AIRL.load(tmp_path / "arm")
    same(loaded, model)
    same(loaded.learn(20, progress=False), model.learn(20, progress=False))
    assert records.read(tmp_path / "arm").steps.max() == 30  # The copy is left as it was.
    model.save(tmp_path / "arm")
    same(AIRL.load(tmp_path / "arm"), model)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("")
    with pytest.raises(FileExistsError, match="no run"):
        model.save(tmp_path / "other")


def test_a_run_of_the_command_line_can_be_loaded(model, tmp_path):
    model.save(tmp_path / "arm")
    folders.extend(tmp_path / "arm", 60)
    folders.work(tmp_path / "arm", progress=False)
    same(AIRL.load(tmp_path / "arm"), model.learn(20, progress=False))


def test_a_policy_acts_as_elsewhere(task, model):
    rng = np.random.default_rng(0)
    obs, space = rng.uniform(-1, 1, (3, 2)), gymnasium.make(task).action_space
    batch, state = model.predict(obs)
    assert (batch.shape, state) == ((3, 2), None)
    for one, wanted in zip(obs, batch, strict=True):
        found = model.predict(one)[0]
        assert space.contains(found)
        np.testing.assert_allclose(found, wanted, rtol=1e-6)
        np.testing.assert_array_equal(found, action(model.run.policy.member(0), one, space))
    other = model.predict(obs, seed=1)[0]
    np.testing.assert_allclose(other[0], action(model.run.policy.member(1), obs[0], space))
    assert not np.allclose(other, batch)
    noisy = [model.predict(obs, deterministic=False)[0] for _ in range(2)]
    assert not np.allclose(*noisy)
    assert all(space.contains(a) for a in np.concatenate(noisy))


def test_one_policy_is_evaluated_by_others(task, model):
    evaluation = pytest.importorskip(
        "stable_baselines3.common.evaluation", reason="Stable-Baselines3 is not installed"
    )
    env = gymnasium.make(task)
    mean, _ = evaluation.evaluate_policy(model, env, 2, warn=False)
    assert np.isfinite(mean)


@pytest.mark.parametrize("reward", ["r-s", "r-sa"])
def test_a_reward_pays_what_it_pays_others(task, reward, tmp_path):
    model = small(task, reward=reward).learn(30, progress=False)
    obs, a = np.array([0.3, -0.2]), np.array([1.0, 0.25])
    env = LearnedReward(gymnasium.make(task), model.run.reward, member=1)
    env._seen = torch.tensor(obs, dtype=torch.float32).view(1, 1, -1)
    env.env.reset(seed=0)
    paid = env.step(a)[1]
    own = (a,) if reward == "r-sa" else ()
    assert model.reward(obs, *own, seed=1) == pytest.approx(paid, rel=1e-5)
    both = model.reward(np.stack([obs, obs]), *(np.stack([x, x]) for x in own), seed=1)
    np.testing.assert_allclose(both, [paid, paid], rtol=1e-5)
    assert both.shape == (2,)
    assert model.reward(obs, *own) != pytest.approx(paid)
    tensors = (torch.tensor(x, dtype=torch.float32) for x in (obs, *own))
    assert model.reward(*tensors, seed=1) == pytest.approx(paid, rel=1e-5)
    if own:
        with pytest.raises(ValueError, match=r"r\(s, a\): give it the actions"):
            model.reward(obs)


def test_a_task_may_be_an_environment_a_function_or_wrapped(task):
    wrapped = gymnasium.wrappers.RescaleAction(arm(), np.float32(-1), np.float32(1))
    heavy = arm()
    heavy.unwrapped.mass = 2.0  # What no registration knows of.
    for env in (arm(mass=2.0), lambda: arm(mass=2.0), heavy):
        same(small(env).learn(30, progress=False), small(arm(mass=2.0)).learn(30, progress=False))
    model = small(wrapped, demos=[(obs, np.clip(a, -1, 1)) for obs, a in (episode(), episode(1))])
    found = model.learn(30, progress=False).predict(np.zeros((50, 2)), deterministic=False)[0]
    assert np.abs(found).max() <= 1
    plain = small(task).learn(30, progress=False)
    assert torch.equal(
        plain.run.policy.params, small(arm()).learn(30, progress=False).run.policy.params
    )


def test_an_environment_is_given_again(tmp_path):
    model = small(arm()).learn(30, progress=False)
    model.save(tmp_path / "arm")
    envs.gymnasium.registry.pop(model.config.env_id)  # As in another process.
    with pytest.raises(ValueError, match=r"object or a function: .*AIRL.load\(path, env\)"):
        AIRL.load(tmp_path / "arm")
    same(AIRL.load(tmp_path / "arm", arm).learn(10, progress=False), model_of(40))
    # Another task is refused, and models that are open keep theirs.
    with pytest.raises(ValueError, match=r"have \(3, 1\) numbers; .*\(2, 2\)"):
        AIRL.load(tmp_path / "arm", lambda: envs.gymnasium.make("Pendulum-v1"))
    same(model.learn(10, progress=False), model_of(40))


def test_a_model_is_a_reward_for_others_and_its_folder_is_no_other_s(task, tmp_path):
    model = small(task, folder=tmp_path / "arm").learn(30, progress=False)
    options = {n: x for n, x in SMALL.items() if n not in ("reward_hidden", "shaping_hidden")}
    again = AIRL(arm(mass=2.0), reward="frozen", frozen_reward=model, seeds=2, **options)
    assert torch.equal(again.inherited["frozen_reward"].params, model.run.reward.params)
    paid = [LearnedReward(arm(), x, member=0) for x in (model, model.run.reward)]
    for env in paid:
        env.reset(seed=0)
    assert paid[0].step(np.zeros(2))[1] == paid[1].step(np.zeros(2))[1]
    with pytest.raises(FileExistsError, match=r"has a run already: go on with a copy, AIRL\.load"):
        small(task, folder=tmp_path / "arm", temperature=0.5)


def model_of(steps):
    model = small(arm())
    return model.learn(30, progress=False).learn(steps - 30, progress=False)


def test_a_task_is_made_once_before_it_trains_and_closed():
    made, closed = [], []

    class Counted(Arm):
        def close(self):
            closed.append(self)

    def make():
        assert len(made) == len(closed), "two were open at once"
        made.append(1)
        return gymnasium.wrappers.TimeLimit(Counted(), 5)

    AIRL(make, [episode(), episode(1)], seeds=3, **SMALL)
    assert (len(made), len(closed)) == (1, 1)


FLAT = {
    "obs": np.concatenate([episode(i)[0][:-1] for i in range(3)]),
    "actions": np.concatenate([episode(i)[1] for i in range(3)]),
    "episode_starts": np.tile([True, False, False, False, False], 3),
}


class Model:
    def predict(self, obs, deterministic=False):
        return controller(obs), None


@pytest.mark.parametrize(
    "given",
    [
        [Recording(*episode()), Recording(*episode(1), terminated=True)],
        [episode(), episode(1)],
        [{"obs": obs, "action": a} for obs, a in (episode(), episode(1))],
        [SimpleNamespace(obs=o, acts=a, terminal=False) for o, a in (episode(), episode(1))],
        FLAT,
        controller,
        Model(),
    ],
    ids=["recordings", "tuples", "dictionaries", "imitation", "flat", "function", "model"],
)
def test_demonstrations_come_in_many_forms(given, task):
    shown = AIRL(task, given, trajectories=2, **SMALL).demonstrations
    assert shown.lengths == ((4, 4) if given is FLAT else (5, 5))
    if not isinstance(given, Model) and given is not controller:
        np.testing.assert_allclose(shown.transitions.obs[0], episode()[0][0], rtol=1e-6)
        middle, half = np.array([1, 0.5]), np.array([3, 0.5])
        scaled = (episode()[1][0] - middle) / half
        np.testing.assert_allclose(shown.transitions.action[0], scaled, atol=1e-6)
    ends = isinstance(given, list) and isinstance(given[1], Recording)
    assert shown.transitions.terminated.sum() == ends


@pytest.mark.parametrize("kind", [str, Path])
def test_flat_arrays_may_be_a_file(kind, task, tmp_path):
    np.savez(tmp_path / "arm.npz", **FLAT)
    shown = demonstrations.of(kind(tmp_path / "arm.npz"), task)
    assert torch.equal(shown.transitions.obs, demonstrations.of(FLAT, task).transitions.obs)


def test_demonstrations_by_name_and_of_a_policy(task, model, minari_folder):
    demonstrations.write([Recording(*episode()), Recording(*episode(1))], task, "own/arm-v0")
    assert len(AIRL(task, "own/arm-v0", **SMALL).demonstrations) == 2
    assert len(demonstrations.load(task, dataset_id="own/arm-v0")) == 2
    assert len(AIRL(task, dataset="own/arm-v0", trajectories=1, **SMALL).demonstrations) == 1
    by_policy = AIRL(task, model.run.policy, trajectories=4, **SMALL).demonstrations
    assert by_policy.lengths == (5,) * 4
    assert AIRL(task, by_policy, **SMALL).demonstrations is by_policy


def test_without_demonstrations_the_shipped_experts_show_the_task(shipped_experts, minari_folder):
    model = AIRL("offairl/PointMazeLeft-v0", trajectories=3, **SMALL)
    assert len(model.demonstrations) == 3


def test_a_reward_is_used_again(task, model):
    options = {n: x for n, x in SMALL.items() if n not in ("reward_hidden", "shaping_hidden")}
    learned = model.run.reward
    again = AIRL(arm(mass=2.0), reward="frozen", frozen_reward=learned, seeds=2, **options)
    again.learn(30, progress=False)
    np.testing.assert_array_equal(again.reward(np.zeros(2)), model.reward(np.zeros(2)))


def test_the_defaults_are_the_recipe_s(task):
    config = AIRL(task, controller, trajectories=2).config
    recipe = {"loss": "log-ratio", "temperature": 0.2, "train_every": 1000, "hidden": (64, 64)}
    assert {name: config.flat()[name] for name in recipe} == recipe
    assert config.schedule.learning_starts == 1000
    assert AIRL(task, controller, trajectories=2).seeds == (0, 1, 2)


def test_demonstrations_that_nobody_learns_from_are_refused(task):
    with pytest.raises(ValueError, match="no use for demonstrations: give none"):
        AIRL(task, [episode()], reward="environment")


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"temprature": 1}, TypeError, "'temprature'; did you mean temperature"),
        ({"trajectory": 1}, TypeError, "did you mean trajectories"),
        ({"seed": 1}, TypeError, "did you mean seeds"),
        ({"lr": 1}, TypeError, "'lr'; did you mean one of `offairl run imitate --help`"),
        ({"trajectories": -1}, ValueError, "trajectories is -1; expected"),
        ({"subsample": 0}, ValueError, "subsample is 0; expected"),
        ({"device": "gpu"}, ValueError, r"device is 'gpu'; expected one of \('cpu', 'cuda'\)"),
        ({"compile": True}, ValueError, "compile is True; expected one of"),
        ({"threads": 0}, ValueError, "threads is 0; expected a number from 1"),
        ({"guide": "runs/x"}, ValueError, "guide=runs/x would not be used: add guide_steps=50"),
        ({"total_steps": 100}, TypeError, r"\.learn\(100\)"),
        ({"total_timesteps": 100}, TypeError, r"\.learn\(100\)"),
        ({"temperature": -1}, ValueError, "temperature is -1; expected a number above 0"),
        ({"seeds": 0}, ValueError, "seeds is 0; expected a whole number of at least 1"),
        ({"seeds": [1, 1]}, ValueError, "two members with one seed"),
        ({"demonstrations": 3}, ValueError, "demonstrations are 3; expected a list of episodes"),
        ({"demonstrations": []}, ValueError, "expected a list of episodes"),
        ({"demonstrations": [(1, 2, 3, 4, 5)]}, ValueError, "recording 0 is a tuple; expected"),
        ({"demonstrations": [episode(), np.zeros(3)]}, ValueError, "give the names: dict"),
        ({"demonstrations": {"obs": np.zeros((3, 2))}}, ValueError, "expected obs and actions"),
        ({"demonstrations": lambda obs: obs[:1]}, ValueError, "episode 0, step 0: the action is"),
        ({"reward": "environment"}, ValueError, "reward_hidden has no use with"),
        ({"seeds": []}, ValueError, r"seeds are \(\); expected at least one"),
        ({"env": "Arm-v9"}, ValueError, "unknown environment 'Arm-v9'"),
        ({"env": 3}, ValueError, "env is 3; expected"),
    ],
)
def test_what_is_wrong_is_said_before_anything_is_done(arguments, error, words, task):
    given = {"env": task, "demonstrations": [episode(), episode(1)], "seeds": 2, **SMALL}
    with pytest.raises(error, match=words):
        AIRL(**{**given, **arguments})


def test_what_cannot_be_used_says_why(task, model, tmp_path):
    new = small(task)
    for use in (new.predict, new.reward, lambda obs: new.save(tmp_path / "new")):
        with pytest.raises(ValueError, match=r"call learn\(100_000\) first"):
            use(np.zeros(2))
    with pytest.raises(ValueError, match=r"seed is 7; there are \[0, 1\]"):
        model.predict(np.zeros(2), seed=7)
    for wrong in (np.zeros((1, 1, 2)), None):
        with pytest.raises(ValueError, match=r"expected \(O,\) or \(B, O\)"):
            model.reward(wrong)
    with pytest.raises(ValueError, match="3"):
        model.predict(np.zeros(3))
    with pytest.raises(ValueError, match="total_timesteps is 0"):
        model.learn(total_timesteps=0)


def test_a_model_that_was_stopped_has_its_last_evaluation_and_goes_on(task, monkeypatch):
    model, whole = small(task), small(task).learn(60, progress=False)
    keep = folders._Worker.keep

    def stop(worker, rows):
        keep(worker, rows)
        if rows and rows[0].step == 40:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(folders._Worker, "keep", stop)
        with pytest.raises(KeyboardInterrupt):
            model.learn(60, progress=False)
    assert model.run.steps.max() == 40
    at = records.read(whole.folder, step=40).policy
    assert torch.equal(model.run.policy.params, at.params)
    model.predict(np.zeros(2))
    same(model.learn(60, progress=False), whole)


def test_a_space_that_is_no_box_says_how_to_wrap_it():
    with pytest.raises(ValueError, match="OneHotActions"):
        AIRL("CartPole-v1", controller)
    with pytest.raises(ValueError, match="TransformAction"):
        AIRL(arm(actions=BOX(-np.inf, np.inf, (2,))), controller)
    seen = gymnasium.spaces.Dict(
        {"b": BOX(-1, 1, (1,)), "a": gymnasium.spaces.Sequence(BOX(-1, 1))}
    )
    with pytest.raises(ValueError, match=r"observation space Dict\(.* is not supported"):
        AIRL(arm(observations=seen), controller)


def flat(obs):
    obs = np.float32(obs)
    return np.concatenate([obs, np.eye(3, dtype=np.float32)[np.int64(obs[..., 0] > 0)]], -1)


def test_dictionaries_of_observations_are_flattened(caplog, minari_folder, tmp_path):
    goal = gymnasium.wrappers.TimeLimit(Goal(), 5)
    arrays = {**FLAT, "obs": as_parts(FLAT["obs"])}
    model = small(goal, demos=arrays).learn(40, progress=False)
    assert "observations are dictionaries, flattened in the order a, b, c" in caplog.text
    wanted = flat(episode()[0][:4])
    np.testing.assert_array_equal(model.demonstrations.transitions.obs[:4], wanted)
    obs = np.random.default_rng(0).uniform(-1, 1, (3, 2))
    for use in (lambda x: model.predict(x)[0], model.reward):
        assert use(as_parts(obs)).shape == use(flat(obs)).shape
        np.testing.assert_array_equal(use(as_parts(obs)), use(flat(obs)))
        np.testing.assert_array_equal(use([as_parts(one) for one in obs]), use(flat(obs)))
        np.testing.assert_allclose(use(as_parts(obs[1])), use(flat(obs))[1], rtol=1e-5)
    model.save(tmp_path / "goal")
    same(AIRL.load(tmp_path / "goal", goal), model)
    export(tmp_path / "goal", tmp_path / "out", member=0)
    assert "as the task gives them, in the order a, b, c." in (
        (tmp_path / "out/README.txt").read_text()
    )
    assert model.predict(gymnasium.make(model.config.env_id).reset(seed=0)[0])[0].shape == (2,)
    demonstrations.generate(
        lambda obs: controller(np.concatenate([obs["a"], obs["b"]])),
        model.config.env_id,
        2,
        "own/goal-v0",
    )
    assert len(small(goal, demos="own/goal-v0").demonstrations) == 2
    paid = LearnedReward(goal, model.run.reward, member=0)
    before, _ = paid.reset(seed=0)
    assert isinstance(before, dict)
    seen, r, *_ = paid.step(np.array([1.0, 0.25]))
    assert isinstance(seen, dict)
    assert r == pytest.approx(model.reward(before))


@pytest.mark.parametrize("form", ["arrays", "list", "next", "function", "minari"])
def test_demonstrations_with_dictionaries_come_in_the_same_forms(form, own, minari_folder):
    env_id = own("ownbot/Goal-v0", "own_task:Goal")
    obs, actions = episode()
    steps = {"actions": actions, "dones": np.arange(5) == 4}
    given = {
        "arrays": [(as_parts(obs), actions)],
        "list": [{"obs": [as_parts(one) for one in obs], "action": actions}],
        "next": {"obs": as_parts(obs[:-1]), "next_obs": as_parts(obs[1:]), **steps},
        "function": lambda obs: controller([*obs["a"], *obs["b"]]),
        "minari": "own/goal-v0",
    }[form]
    if form == "minari":
        write_raw(env_id, obs, actions)
    transitions = demonstrations.of(given, env_id, 1).transitions
    if form == "function":
        assert not torch.equal(transitions.obs[0], transitions.obs[1])
        assert transitions.obs.shape == (5, 5)
    else:
        np.testing.assert_array_equal(transitions.obs, flat(obs[:-1]))
        np.testing.assert_array_equal(transitions.next_obs, flat(obs[1:]))


def write_raw(env_id, obs, actions):
    """Write a data set as Minari itself records a task: with dictionaries."""
    env, last = gymnasium.make(env_id), np.arange(5) == 4
    buffer = EpisodeBuffer(0, None, None, as_parts(obs), actions, np.zeros(5), last & False, last)
    with pytest.warns(UserWarning, match="is set to None"):
        minari.create_dataset_from_buffers("own/goal-v0", [buffer], env=env, algorithm_name="none")
    raw = minari.load_dataset("own/goal-v0")
    assert set(raw[0].observations) == {"a", "b", "c"}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda obs: obs.pop("b"), r"have the parts \['c', 'a'\]; expected \['a', 'b', 'c'\]"),
        (lambda obs: obs.update(a=obs["a"][:2]), "recording 0, .* dimensions .* must match"),
    ],
)
def test_parts_that_do_not_fit_are_named(change, words, own):
    obs, actions = episode()
    change(obs := as_parts(obs))
    with pytest.raises(ValueError, match=words):
        demonstrations.of([(obs, actions)], own("ownbot/Goal-v0", "own_task:Goal"))
