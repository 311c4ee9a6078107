"""The experiments: full scale is the paper's protocol, and what is not in it is named."""

import itertools

import mujoco
import pytest

from offairl_lite import envs
from offairl_lite.ablations.released import RELEASE
from offairl_lite.config import CORRECTED, PAPER, differences
from offairl_lite.config.settings import SYNONYMS
from offairl_lite.experiments import EXPERIMENTS, configure, find

SCALES = ("demo", "full")


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_full_scale_is_the_paper_s_protocol(name):
    config, seeds = EXPERIMENTS[name].configs["full"], EXPERIMENTS[name].seeds["full"]
    assert seeds == tuple(range(10))
    assert (config.total_steps, config.schedule.eval_every, config.schedule.eval_episodes) == (
        1_000_000,
        5_000,
        10,
    )
    assert (config.learner.hidden, config.learner.learning_rate) == ((400, 300), 1e-3)
    if config.imitates:
        discriminator = config.discriminator
        assert discriminator.reward_hidden == discriminator.shaping_hidden == (100, 100)
        assert discriminator.activation == "tanh"


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_demo_scale_is_small(name):
    config = EXPERIMENTS[name].configs["demo"]
    # On-policy learning takes ten times the steps, and each of them less. The ants learn nothing in
    # fewer than 50,000, and have three seeds. What decides between methods is seen later still.
    ants = name.startswith("ant-")
    most = {"what-decides": 100_000, "locomotion": 500_000}
    most |= {"benchmark": 100_000, "benchmark-warm": 100_000}
    most = most.get(name, 60_000 if ants or config.learner.kind == "ppo" else 20_000)
    assert config.total_steps <= most
    assert len(EXPERIMENTS[name].seeds["demo"]) == (3 if ants else 5)


def test_experts_are_three_learners_on_the_eight_tasks_of_the_paper():
    experiment = find("experts")
    runs = {
        name: experiment.configs["full"].change(**changes)
        for name, changes in experiment.variants.items()
    }
    assert len(runs) == 24
    assert len({run.env_id for run in runs.values()}) == 8
    for name, run in runs.items():
        task, _, learner = name.partition("-")
        assert run.env_id.split("/")[-1].startswith(f"{task}-v")
        expected = {
            "td3": ("td3", None),
            "sac-fixed": ("sac", 0.2),
            "sac-learned": ("sac", None),
        }
        assert (run.learner.kind, run.flat().get("temperature")) == expected[learner]
        assert (run.reward, run.total_steps) == ("environment", 1_000_000)
        assert run.schedule.batch_size == 100
    maze = differences(runs["PointMazeLeft-sac-learned"], find("maze-expert").configs["full"])
    assert maze == {}


def test_the_on_policy_experiments_discriminate_their_own_block_and_differ_in_their_reward():
    rewards = set()
    for name in ("maze-gail", "maze-airl-ppo", "hopper-gail"):
        experiment = find(name)
        for scale, config in experiment.configs.items():
            assert (config.learner.kind, config.schedule.replay_size) == (
                "ppo",
                config.schedule.train_every,
            )
            for changes in experiment.variants.values():
                assert set(differences(config, config.change(**changes))) <= {"reward"}
                rewards.add(config.change(**changes).reward)
            if scale == "demo":
                assert config.total_steps % config.schedule.train_every == 0
    assert rewards == {
        *("gail-survival", "gail-termination", "dac"),
        *("logit-sa", "logit-s"),
    }


def test_the_velocity_of_the_ant_s_torso_is_where_the_reward_looks_for_it():
    seen = configure("ant-rewards/implementation-4-velocity", "demo").discriminator.reward_sees
    for env_id in ("offairl/CustomAnt-v0", "offairl/DisabledAnt-v0"):
        # Observations are the positions, all but x and y, and then the velocities, of which a free
        # joint's linear ones come first.
        model = envs.TASKS[env_id].model()
        assert model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
        assert seen == tuple(model.nq - 2 + axis for axis in range(3))


DAC_ALONE = {"dac": {"reward": "dac"}, "dac-td3": {"reward": "dac", "learner": "td3"}}


@pytest.mark.parametrize(
    ("name", "warmup", "temperature", "between"),
    [
        (
            "locomotion",
            1_000,
            0.2,
            {
                "airl": {"loss": "log-ratio"},
                "mcp-4": {"loss": "log-ratio", "primitives": 4},
                "mcp-8": {"loss": "log-ratio", "primitives": 8},
                **DAC_ALONE,
            },
        ),
        (
            "locomotion-first",
            10_000,
            None,
            {
                "airl": {},
                "airl-mixture": {"loss": "airl-mixture"},
                "airl-soft": {"loss": "airl-mixture", "temperature": 1.0},
                "mcp-4": {"primitives": 4},
                "mcp-8": {"primitives": 8},
                **DAC_ALONE,
            },
        ),
    ],
)
def test_locomotion_sets_imitators_side_by_side_with_nothing_else_between_them(
    name, warmup, temperature, between
):
    experiment = find(name)
    for config in experiment.configs.values():
        tasks = set()
        for variant, changes in experiment.variants.items():
            task, _, method = variant.partition("-")
            run, same = config.change(**changes), config.change(env_id=changes["env_id"])
            falls = task in ("Hopper", "Walker2d", "Ant")
            absorbing = {"absorbing": "bootstrap"} if falls else {}
            assert run == same.change(**absorbing, **between[method])
            tasks.add(run.env_id)
        assert len(tasks) == 5
        assert len(experiment.variants) == len(tasks) * len(between)
        assert config.discriminator.loss == "airl"
        assert config.learner.temperature == temperature
        assert (config.schedule.learning_starts, config.schedule.train_every) == (warmup, 1_000)


def test_what_decides_varies_loss_temperature_and_warm_up_and_nothing_else():
    experiment = find("what-decides")
    varied = {"loss", "reward", "temperature", "learning_starts"}
    assert len(experiment.variants) == 4 * 4 * 3 * 2
    for config in experiment.configs.values():
        for name, changes in experiment.variants.items():
            robot, loss, temperature, warmup = name.split("-")
            run = config.change(**changes)
            recipe = config.change(**experiment.variants[f"{robot}-released-fixed-short"])
            assert set(differences(run, recipe)) <= varied
            alpha = {"fixed": 0.2, "learned": None, "one": 1.0}[temperature]
            assert run.learner.temperature == alpha
            assert run.schedule.learning_starts == {"short": 1_000, "long": 10_000}[warmup]
            assert (run.reward == "dac") == (loss == "dac")
            assert run.discriminator.loss == SYNONYMS["loss"].get(loss, "airl")


def test_the_recipe_is_what_decided():
    for robot in ("Hopper", "Walker2d", "HalfCheetah", "CustomAnt"):
        short = configure(f"what-decides/{robot}-released-fixed-short", "demo")
        long = configure(f"locomotion/{robot}-airl", "demo")
        schedule = {"total_steps", "eval_every", "eval_episodes"}
        unused = {"trunk_hidden", "primitive_hidden", "gate_hidden"}
        assert set(differences(short, long)) == schedule | unused
        dac = configure(f"locomotion/{robot}-dac", "demo")
        assert set(differences(long, dac)) == {"loss", "reward"}


@pytest.mark.parametrize("name", ["maze-retraining", "ant-transfer"])
def test_what_is_kept_of_a_policy_has_one_episode_of_random_actions_unless_helped(name):
    experiment, steps = find(name), {"maze-retraining": 100, "ant-transfer": 1_000}[name]
    for scale, config in experiment.configs.items():
        runs = {v: config.change(**changes) for v, changes in experiment.variants.items()}
        assert {run.reward for run in runs.values()} == {"frozen"}
        for variant, run in runs.items():
            assert (run.pretrained == "nothing") == variant.startswith("scratch")
            assert (run.learner.primitives is None) == variant.startswith(("scratch", "policy"))
            assert run.learner.fixed_primitives == ("-gate" in variant)
            assert (run.schedule.guide_steps > 0) == variant.endswith("-starts")
            warmup = run.schedule.learning_starts, run.schedule.random_hold
            if run.pretrained == "nothing" or variant.endswith("-helped"):
                assert warmup == (config.schedule.learning_starts, config.schedule.random_hold)
            else:
                assert warmup == (steps, 1), scale


def test_the_ants_that_are_carried_over_are_of_the_form_that_is_learned():
    # An actor fits only one of the same architecture.
    form = ("hidden", "trunk_hidden", "primitive_hidden", "gate_hidden", "gating", "primitives")
    for scale, ant in itertools.product(("demo", "full"), ("policy", "4-gate", "8-both")):
        k = ant.split("-")[0]
        source = "locomotion-first/CustomAnt-" + ("airl" if k == "policy" else f"mcp-{k}")
        learned, retrained = configure(source, scale), configure(f"ant-transfer/{ant}", scale)
        assert not set(differences(learned, retrained)) & set(form)


def test_the_released_order_is_the_only_thing_that_is_otherwise_in_its_runs():
    experiment = find("ant-transfer")
    released = [name for name in experiment.variants if name.endswith("-released-order")]
    assert len(released) == 6
    for scale, name in itertools.product(("demo", "full"), released):
        run = configure(f"ant-transfer/{name}", scale)
        other = configure(f"ant-transfer/{name.removesuffix('-released-order')}", scale)
        assert differences(other, run) == {
            "env_id": ("offairl/DisabledAnt-v0", "offairl/DisabledAntReleased-v0")
        }


def test_entropy_is_counted_once_in_two_ways():
    experiment = find("maze-rewards")
    for scale, number in itertools.product(("demo", "full"), (1, 2)):
        twice, cold, soft, learned = (
            experiment.configs[scale].change(
                **experiment.variants[f"implementation-{number}{form}"]
            )
            for form in ("", "-cold", "-soft", "-learned")
        )
        assert cold.discriminator.log_prob_in_reward
        assert cold.learner.temperature < 0.01
        assert set(differences(twice, cold)) == {"temperature", "target_entropy"}
        assert not soft.discriminator.log_prob_in_reward
        assert soft.learner.temperature == 1
        assert set(differences(cold, soft)) == {"temperature", "log_prob_in_reward"}
        assert set(differences(twice, learned)) == {"log_prob_in_reward"}
        assert learned.learner.temperature is None


def test_what_the_maze_adds_to_the_corrected_preset():
    added = differences(CORRECTED, find("maze-imitation").configs["full"])
    assert set(added) == {"temperature", "target_entropy", "random_hold"}


@pytest.mark.parametrize("preset", [PAPER, RELEASE])
def test_what_the_maze_needs_is_off_in_the_presets_of_paper_and_release(preset):
    assert not preset.schedule.normalise
    assert preset.schedule.random_hold == 1
    assert preset.learner.target_entropy is None


def test_both_scales_of_an_experiment_ask_the_same_question():
    for experiment in EXPERIMENTS.values():
        demo, full = experiment.configs["demo"], experiment.configs["full"]
        assert (demo.env_id, demo.reward, demo.learner.kind) == (
            full.env_id,
            full.reward,
            full.learner.kind,
        )
        assert (experiment.reward_from is None) == (demo.reward != "frozen")
        if experiment.reward_from in EXPERIMENTS:  # all of its runs, or a single one
            continue
        if experiment.reward_from is not None:
            assert configure(experiment.reward_from, "full").imitates


def test_what_a_reward_is_worth_is_asked_of_all_rewards_alike():
    experiment = find("maze-transfer-rewards")
    transfer, expert = find("maze-transfer").configs["demo"], find("maze-expert").configs["demo"]
    runs = {
        name: experiment.configs["demo"].change(**changes)
        for name, changes in experiment.variants.items()
    }
    assert differences(transfer, runs["scratch"]) == {}
    for begin in ("scratch", "scratch-alone", "policy", "policy-alone"):
        assert set(differences(runs[begin], runs[f"back-{begin}"])) == {"env_id"}
        true = runs[f"true-{begin}"]
        assert set(differences(runs[begin], true)) == {"reward", "reward_scale"}
        assert true.reward == "environment"
        assert true.learner.reward_scale == expert.learner.reward_scale
        assert (true.pretrained == "policy") == begin.startswith("policy")
        assert (true.schedule.random_hold > 1) != begin.endswith("alone")


def test_the_marsh_is_learned_from_one_start_and_tried_from_another():
    learned, tried = find("marsh-imitation"), find("marsh-transfer")
    assert tried.reward_from == "marsh-imitation/implementation-4"
    tasks = {changes.get("env_id") for changes in tried.variants.values()}
    assert tasks == {None, "offairl/PointMarshWest-v0"}
    for scale, config in learned.configs.items():
        assert config.env_id == tried.configs[scale].env_id == "offairl/PointMarsh-v0"
        imitation = find("maze-imitation").configs[scale]
        assert set(differences(config, imitation)) == {"env_id"}


def test_an_unknown_experiment_lists_those_there_are():
    with pytest.raises(ValueError, match="no experiment 'maze'; there are: experts, hopper-gail"):
        find("maze")


def test_hopper_runs_differ_in_their_reward_and_in_what_follows_a_fall_and_in_nothing_else():
    experiment = find("hopper-absorbing")
    for scale, config in experiment.configs.items():
        runs = [config.change(**changes) for changes in experiment.variants.values()]
        assert {(run.reward, run.schedule.absorbing) for run in runs} == {
            (reward, absorbing)
            for reward in ("dac", "r-s")
            for absorbing in ("none", "bootstrap", "analytic")
        }
        assert all(set(differences(config, run)) <= {"reward", "absorbing"} for run in runs)
        if scale == "full":
            dac = find("hopper-dac")
            dac = dac.configs[scale].change(**dac.variants["sac"])
            assert dac in runs


def test_a_run_is_configured_by_its_name():
    experiment = find("maze-dac")
    for scale, config in experiment.configs.items():
        assert configure("maze-dac/td3", scale) == config.change(learner="td3")
        assert configure("maze-expert", scale) is not None
    for wrong in ("maze-dac", "maze-dac/ppo", "maze-imitation/td3"):
        with pytest.raises(ValueError, match=f"no run '{wrong}'; there are: maze-"):
            configure(wrong, "demo")
    with pytest.raises(ValueError, match="no experiment 'maze'"):
        configure("maze/td3", "demo")


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_robots_are_shown_by_as_many_experts_as_when_they_were_recorded(name):
    """One at demo scale, two at full scale; a maze has five at either; the benchmark the best."""
    experiment = EXPERIMENTS[name]
    if name.startswith("benchmark"):
        assert experiment.experts == {"demo": "best", "full": "best"}
        return
    robot = "Point" not in experiment.configs["demo"].env_id
    imitates = experiment.configs["demo"].imitates
    one, two = (1, 2) if robot and imitates else (None, None)
    assert experiment.experts == {"demo": one, "full": two}


def test_the_benchmark_compares_methods_with_nothing_else_between_them():
    experiment = find("benchmark")
    assert len(experiment.variants) == 25
    for robot in ("HalfCheetah", "Hopper", "Walker2d", "Ant", "CustomAnt"):
        recipe, dac, states = (
            configure(f"benchmark/{robot}-{method}", "demo")
            for method in ("airl", "dac", "state-dac")
        )
        assert differences(dac, states) == {"ablation": (None, "state-pairs")}
        sqil, iq_learn = (
            configure(f"benchmark/{robot}-{method}", "demo") for method in ("sqil", "iq-learn")
        )
        assert differences(sqil, iq_learn) == {"reward": ("sqil", "iq-learn")}
        for group in ("schedule", "learner"):
            assert getattr(sqil, group) == getattr(recipe, group)
        warm = configure(f"benchmark-warm/{robot}-airl-warm", "demo")
        assert differences(recipe, warm) == {"pretrained": ("nothing", "policy")}
        assert differences(recipe, dac) == {
            "reward": ("r-s", "dac"),
            "loss": ("log-ratio", "airl"),
        }
        assert recipe.schedule.absorbing == (
            "none" if robot in ("HalfCheetah", "CustomAnt") else "bootstrap"
        )
        if robot != "Ant":
            known = configure(f"what-decides/{robot}-released-fixed-short", "demo")
            assert differences(known, recipe) == {"eval_episodes": (5, 10)}
