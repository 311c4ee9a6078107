"""The experiments: full scale is the paper's protocol, and what is not in it is named."""

from dataclasses import replace

import pytest

from offairl_lite.config import CORRECTED, PAPER, RELEASE, differences
from offairl_lite.experiments import EXPERIMENTS, find


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_full_scale_is_the_paper_s_protocol(name):
    config, seeds = EXPERIMENTS[name].configs["full"], EXPERIMENTS[name].seeds["full"]
    assert seeds == tuple(range(10))
    assert (config.total_steps, config.eval_every, config.eval_episodes) == (1_000_000, 5_000, 10)
    assert (config.hidden, config.learning_rate) == ((400, 300), 1e-3)
    assert (config.reward_hidden, config.shaping_hidden) == ((100, 100), (100, 100))
    assert config.discriminator_activation == "tanh"


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_demo_scale_is_small(name):
    assert EXPERIMENTS[name].configs["demo"].total_steps <= 20_000
    assert len(EXPERIMENTS[name].seeds["demo"]) == 5


def test_experts_are_three_learners_on_the_eight_tasks_of_the_paper():
    experiment = find("experts")
    runs = {
        name: replace(experiment.configs["full"], **changes)
        for name, changes in experiment.variants.items()
    }
    assert len(runs) == 24
    assert len({run.env_id for run in runs.values()}) == 8
    for name, run in runs.items():
        task, _, learner = name.partition("-")
        assert run.env_id.split("/")[-1].startswith(f"{task}-v")
        expected = {
            "td3": ("td3", 0.2),
            "sac-fixed": ("sac", 0.2),
            "sac-learned": ("sac", None),
        }
        assert (run.generator, run.temperature) == expected[learner]
        assert (run.reward, run.batch_size, run.total_steps) == ("environment", 100, 1_000_000)
    maze = differences(runs["PointMazeLeft-sac-learned"], find("maze-expert").configs["full"])
    assert maze == {}


def test_what_the_maze_adds_to_the_corrected_preset():
    added = differences(CORRECTED, find("maze-imitation").configs["full"])
    assert set(added) == {"temperature", "target_entropy", "warmup_hold"}


@pytest.mark.parametrize("preset", [PAPER, RELEASE])
def test_what_the_maze_needs_is_off_in_the_presets_of_paper_and_release(preset):
    assert not preset.normalise
    assert preset.warmup_hold == 1
    assert preset.target_entropy is None


def test_both_scales_of_an_experiment_ask_the_same_question():
    for experiment in EXPERIMENTS.values():
        demo, full = experiment.configs["demo"], experiment.configs["full"]
        assert (demo.env_id, demo.reward, demo.generator) == (
            full.env_id,
            full.reward,
            full.generator,
        )
        assert experiment.reward_from is None or demo.reward == "frozen"


def test_an_unknown_experiment_lists_those_there_are():
    with pytest.raises(ValueError, match="no experiment 'maze'; there are: experts, maze-expert"):
        find("maze")
