"""The experiments: full scale is the paper's protocol, and what is not in it is named."""

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
    with pytest.raises(ValueError, match="no experiment 'maze'; there are: maze-expert"):
        find("maze")
