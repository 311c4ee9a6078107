"""Command lines that make no sense, with the words of their messages; a new one is a new row.

Every message says what was found and what to do, without a traceback, and nothing is made.
"""

import re
import shutil
import sys
from pathlib import Path

import pytest
import torch

from offairl_lite import demonstrations
from offairl_lite.config import flat_settings
from offairl_lite.core.networks import Normaliser, StackedMLP
from offairl_lite.core.policies import Policy, SquashedGaussian
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rng import Rng
from offairl_lite.runs import cli, messages, records

MAZE, RIGHT = "offairl/PointMazeLeft-v0", "offairl/PointMazeRight-v0"
SMALL = (
    "--seeds 0 1 --total-steps 100 --learning-starts 50 --batch-size 8 --eval-every 100 "
    "--eval-episodes 1 --hidden 8"
)

# A command, and words of its message.
ROWS = [
    # The command itself.
    ("", "Expected one of", "list, run, resume"),
    ("frobnicate", "frobnicate", "list, run, resume"),
    ("run nowhere", "nowhere", "maze-imitation"),
    ("list nowhere", "no experiment 'nowhere'; there are: ", "maze-imitation"),
    ("run maze-expert --bogus 3", "Unrecognized options", "--bogus"),
    ("run maze-expert --scale huge", "huge", "demo", "full"),
    ("run --centre-reward maze-expert", "name the experiment before all options"),
    ("resume", "Missing from offairl resume", "the run's folder"),
    ("watch", "Missing from offairl watch", "a policy's file"),
    ("verify", "Missing from offairl verify", "its folder"),
    ("demos", "Missing from offairl demos", "Gymnasium id of the task"),
    ("resume done more", "more"),
    # Settings: types.
    ("run maze-expert --temperature hot", "--temperature", "'hot'"),
    ("run maze-expert --discount x", "--discount", "'x'"),
    ("run maze-expert --train-every 1.5", "--train-every", "'1.5'"),
    ("run maze-expert --total-steps 1e6", "--total-steps", "'1e6'"),
    ("run maze-expert --batch-size big", "--batch-size", "'big'"),
    ("run maze-expert --hidden 64x64", "--hidden", "64x64"),
    ("run maze-expert --learner dqn", "--learner", "'dqn'", "sac"),
    ("run maze-imitation --reward happiness", "--reward", "'happiness'", "r-s"),
    ("run maze-imitation --ablation two-sided", "--ablation", "'two-sided'", "state-pairs"),
    ("run maze-imitation --absorbing yes", "--absorbing", "'yes'", "bootstrap"),
    ("run maze-imitation --loss hinge", "--loss", "'hinge'", "mixture"),
    ("run maze-expert --gating max --primitives 2", "--gating", "'max'", "softmax"),
    ("run maze-expert --normalise yes", "yes"),
    # Settings: ranges.
    ("run maze-expert --discount 2", "discount is 2.0", "in [0, 1]"),
    ("run maze-expert --discount nan", "discount is nan", "in [0, 1]"),
    ("run maze-expert --learning-rate 0", "learning-rate is 0.0", "above 0"),
    ("run maze-expert --learning-rate inf", "learning-rate is inf", "above 0"),
    ("run maze-expert --learning-rate -1e-3", "learning-rate is -0.001", "above 0"),
    ("run maze-expert --reward-scale 0", "reward-scale is 0.0", "above 0"),
    ("run maze-expert --reward-scale inf", "reward-scale is inf", "above 0"),
    ("run maze-expert --temperature 0", "temperature is 0.0", "above 0"),
    ("run maze-expert --temperature nan", "temperature is nan", "above 0"),
    ("run maze-expert --target-entropy nan", "target-entropy is nan", "a number"),
    ("run maze-expert --target-rate 1.5", "target-rate is 1.5", "in [0, 1]"),
    ("run maze-expert --random-hold nan", "random-hold is nan", "at least 1"),
    ("run maze-expert --random-hold inf", "random-hold is inf", "at least 1"),
    ("run maze-expert --random-hold 0.5", "random-hold is 0.5", "at least 1"),
    ("run maze-expert --learning-starts 0", "learning-starts is 0", "at least 1"),
    (
        "run maze-expert --learning-starts 17000",
        "learning-starts is 17000",
        "lower --learning-starts",
    ),
    ("run maze-expert --total-steps 0", "total-steps is 0", "at least 1"),
    ("run maze-expert --total-steps -5", "total-steps is -5", "at least 1"),
    ("run maze-expert --batch-size 0", "batch-size is 0", "at least 1"),
    ("run maze-expert --replay-size 0", "replay-size is 0", "at least 1"),
    ("run maze-expert --eval-every 0", "eval-every is 0", "at least 1"),
    ("run maze-expert --eval-episodes 0", "eval-episodes is 0", "at least 1"),
    ("run maze-expert --train-every 0", "train-every is 0", "at least 1"),
    ("run maze-expert --train-every 99999", "train-every is 99999", "lower --train-every"),
    ("run maze-expert --hidden 8 0", "hidden is (8, 0)", "at least 1"),
    ("run maze-expert --hidden -1", "hidden is (-1,)", "at least 1"),
    ("run maze-expert --primitives 0", "primitives is 0", "at least 1"),
    ("run maze-expert --log-std-range 2 -5", "log-std-range is (2.0, -5.0)", "in ascending order"),
    ("run maze-expert --log-std-range 2", "--log-std-range"),
    ("run maze-imitation --gradient-penalty nan", "gradient-penalty is nan", "at least 0"),
    ("run maze-imitation --gradient-penalty -1", "gradient-penalty is -1.0", "at least 0"),
    ("run maze-imitation --reward-sees 0 0", "reward-sees is (0, 0)", "none twice"),
    ("run maze-imitation --reward-sees", "reward-sees is ()", "or None"),
    ("run maze-imitation --reward-sees -1", "reward-sees is (-1,)", "at least 0"),
    ("run maze-imitation --reward-sees 9", "reward-sees is (9,)", "indices from 0 to 2"),
    ("run maze-imitation --discriminator-updates 0", "discriminator-updates is 0", "at least 1"),
    ("run maze-imitation --discriminator-discount 2", "discriminator-discount is 2.0", "[0, 1]"),
    ("run maze-imitation --guide-steps -10", "guide-steps is -10", "at least 0"),
    ("run maze-imitation --guide-steps 99999", "guide-steps is 99999", "learning-starts"),
    # Settings that do not go together.
    ("run maze-imitation --learner td3", "needs log π", "use --learner sac"),
    ("run maze-imitation --learner ppo --temperature 1", "train-every is None", "set it"),
    ("run maze-imitation --reward gan-gcl", "GAN-GCL is a page now", "another reward"),
    ("run maze-expert --absorbing bootstrap", "--absorbing bootstrap", "set --absorbing none"),
    ("run maze-imitation --no-log-prob-in-reward", "--no-log-prob-in-reward", "it is for"),
    ("run maze-expert --loss exact", "loss has no use", "leave it out"),
    ("run maze-expert --ablation state-pairs", "state-pairs", "leave it out"),
    ("run maze-imitation --composition exact", "composition has no use", "leave it out"),
    ("run maze-expert --fixed-primitives", "--fixed-primitives", "set primitives"),
    ("run maze-expert --pretrained primitives", "--pretrained primitives", "set primitives"),
    (
        "run maze-expert --learner td3 --temperature 0.2",
        "temperature has no use with --learner td3",
        "leave it out",
    ),
    (
        "run maze-imitation --absorbing analytic --discount 1",
        "--absorbing analytic divides by 1 - discount",
        "below 1",
    ),
    # Grids and several runs.
    ("run maze-expert --grid temperature", "--grid temperature", "SETTING=VALUE,VALUE"),
    ("run maze-expert --grid =1", "no setting ''"),
    ("run maze-expert --grid foo=1", "no setting 'foo'", "temperature"),
    ("run maze-expert --grid temperature=", "temperature is ''", "a number above 0, or None"),
    ("run maze-expert --grid temperature=nan", "temperature is nan", "above 0"),
    ("run maze-expert --grid temperature=0.1,0.1", "in the grid twice", "every value once"),
    ("run maze-expert --grid temperature=1 --grid temperature=2", "each setting once"),
    ("run maze-expert --grid discount=2", "discount is 2", "in [0, 1]"),
    ("run maze-expert --grid hidden=8xx", "hidden is '8xx'", "a tuple"),
    ("run maze-expert --grid normalise=perhaps", "normalise is 'perhaps'", "True or False"),
    ("run maze-expert --grid learner=sac,dqn", "learner is 'dqn'", "td3"),
    ("run maze-expert --only foo", "no runs ['foo']", "none, since the experiment is one run"),
    ("run experts --only foo", "no runs ['foo']; there are: ", "Hopper-td3"),
    ("run locomotion --env-id Pendulum-v1", "sets --env-id itself", "--grid", "--only"),
    # Seeds, processes, devices.
    ("run maze-expert --seeds", "seeds are ()", "at least one"),
    ("run maze-expert --seeds -1", "seeds", "-1", "0"),
    ("run maze-expert --seeds 0.5", "--seeds", "0.5"),
    (f"run maze-expert {SMALL} --seeds 0 0", "seeds are", "two members with one seed"),
    ("run maze-expert --processes 0", "processes is 0", "at least 1"),
    ("run maze-expert --processes -2 --grid temperature=1,2", "processes is -2", "at least 1"),
    ("run maze-expert --processes two", "--processes", "two"),
    ("run maze-expert --threads 0", "threads is 0", "from 1 to 256"),
    ("run maze-expert --threads 100000", "threads is 100000", "from 1 to 256"),
    ("run maze-expert --device tpu", "--device", "'tpu'", "cuda"),
    ("run maze-expert --compile perhaps", "--compile", "'perhaps'", "auto"),
    ("run maze-expert --engine slurm", "--engine", "'slurm'", "ray"),
    ("resume done --processes 0", "processes is 0", "at least 1"),
    ("bench --seconds 0", "seconds is 0.0", "positive"),
    ("bench --seconds nan", "seconds is nan", "positive"),
    ("bench --rounds 0", "rounds is 0", "positive"),
    ("bench --populations 0 1", "populations is (0, 1)", "positive"),
    ("bench --populations", "populations is ()", "positive"),
    # Places.
    (f"run maze-expert {SMALL} --out /dev/null", "/dev/null is no folder", "choose another"),
    (f"run maze-expert {SMALL} --out file", "file is no folder", "choose another"),
    (f"run maze-expert {SMALL} --out file/below", "file is no folder", "choose another"),
    (f"run maze-expert {SMALL} --out used", "used is not empty", "another folder"),
    (
        f"run maze-expert {SMALL} --out done --discount 0.5",
        "discount 0.99, not 0.5",
        "another folder",
    ),
    (f"run maze-expert {SMALL} --out done --seeds 5", "seeds (0, 1), not (5,)", "another folder"),
    ("resume nowhere", "no run in", "nowhere", "`offairl run NAME --out nowhere` starts one"),
    ("resume used", "no run in", "used"),
    ("resume file", "file is a file, and not the folder of a run", "offairl watch"),
    ("resume done --steps 50", "reached step 100; it cannot end at 50", "--steps N"),
    ("resume done --steps 0", "--steps is 0", "at least 1"),
    ("resume done --steps many", "--steps", "many"),
    ("resume done --seeds 1", "seeds [1] are not all new", "[0, 1]"),
    ("resume done --seeds -4", "seeds", "-4", "0"),
    ("resume done --seeds 5 5", "not all new"),
    ("resume damaged", "curve.csv is damaged", "bring all of damaged back"),
    ("resume done --env-id Hopper-v5", "env-id is 'Hopper-v5'", MAZE),
    ("resume strange", "no module is imported", "`offairl resume strange --env-id evil:Evil-v0`"),
    ("resume strange --env-id other:Evil-v0", "env-id is 'other:Evil-v0'", "evil:Evil-v0"),
    ("resume strange --env-id evil:Evil-v0", "No module named 'evil'", "PYTHONPATH"),
    ("resume strange --steps 300", "no module is imported", "--env-id evil:Evil-v0"),
    ("verify nowhere", "no run in", "nowhere"),
    ("verify done --env-id Hopper-v5", "env-id is 'Hopper-v5'", MAZE),
    ("export strange --out files", "no module is imported", "--env-id evil:Evil-v0`"),
    ("verify strange", "no module is imported", "`offairl verify strange --env-id evil:Evil-v0`"),
    ("verify damaged", "curve.csv is damaged", "bring all of damaged back"),
    ("tensorboard nowhere", "no run in", "nowhere"),
    # Tasks.
    ("run imitate --env-id Nowhere-v0", "unknown environment 'Nowhere-v0'", "my_module:Nowhere-v0"),
    ("run maze-expert --env-id Nowhere-v0", "unknown environment 'Nowhere-v0'"),
    ("run maze-expert --env-id nomodule:Arm-v0", "nomodule"),
    ("run maze-expert --env-id CartPole-v1", "CartPole-v1: the action space", "Box"),
    ("run imitate --env-id Pendulum-v1", "no expert is shipped for Pendulum-v1", "--policy RUN"),
    ("demos Nowhere-v0", "unknown environment 'Nowhere-v0'"),
    ("demos Pendulum-v1", "no expert is shipped for Pendulum-v1", "--policy RUN"),
    # Demonstrations.
    (f"demos {MAZE} --trajectories 0", "trajectories is 0", "at least 1"),
    (f"demos {MAZE} --trajectories -3", "trajectories is -3", "at least 1"),
    (f"demos {MAZE} --trajectories few", "--trajectories", "few"),
    (f"demos {MAZE} --experts 0", "experts is 0", "1"),
    (f"demos {MAZE} --experts 7", "experts is 7", "2"),
    (f"demos {MAZE} --dataset own/none-v0", "no local data set 'own/none-v0'"),
    (f"demos {MAZE} --dataset own/pendulum-v0 --trajectories 2", "expected actions of shape"),
    (f"demos {MAZE} --dataset own/pendulum-v0 --experts 1", "--experts 1 would not be used"),
    ("demos Pendulum-v1 --dataset own/pendulum-v0 --trajectories 9", "it has 2", "give --traj"),
    ("demos Pendulum-v1 --policy mine", "needs a name", "--dataset own/trained-v0"),
    ("demos Pendulum-v1 --policy mine --dataset own/x", "own/x", "own/trained-v0"),
    ("demos Pendulum-v1 --policy mine --dataset ../x-v0", "../x-v0", "own/trained-v0"),
    ("demos Pendulum-v1 --policy mine --dataset own/pendulum-v0", "exists already"),
    ("demos Pendulum-v1 --policy none --dataset own/x-v0", "no run or policy file none"),
    ("run maze-imitation --trajectories 0", "trajectories is 0", "at least 1"),
    ("run maze-imitation --subsample 0", "subsample is 0", "at least 1"),
    ("run maze-imitation --experts 9", "experts is 9"),
    ("run maze-expert --trajectories 5", "--trajectories 5 would not be used", "leave it out"),
    ("run maze-expert --dataset own/pendulum-v0", "--dataset own/pendulum-v0 would not be used"),
    # Policies and rewards of other runs.
    ("run maze-transfer", "first `offairl run maze-imitation --scale demo`", "--frozen-reward"),
    ("run maze-expert --reward frozen", "a frozen reward of another run is needed", "RUN/reward"),
    ("run maze-expert --guide-steps 9", "a guide of another run is needed", "--guide RUN/policy"),
    ("run maze-expert --pretrained policy", "pretrained policy of another run", "RUN/policy"),
    ("run maze-transfer --frozen-reward no.safetensors", "no reward at no.safetensors"),
    ("run maze-transfer --frozen-reward file", "file", "safetensors"),
    ("run maze-transfer --frozen-reward mine/policy.safetensors", "holds 'policy', not a reward"),
    ("run maze-transfer --frozen-reward reward.safetensors", "2 ", "seeds", "--seeds 0 1"),
    ("run maze-expert --guide done", "--guide done would not be used", "--guide-steps 50"),
    ("run maze-expert --frozen-reward done", "--frozen-reward done would not be used"),
    (f"run maze-expert {SMALL} --pretrained policy --pretrained-policy mine", "1", "2"),
    # Exports.
    ("export", "Missing from offairl export"),
    ("export done", "--out"),
    ("export nowhere --out robot", "no run in", "nowhere"),
    ("export file --out robot", "file is no safetensors file of this package"),
    ("export reward.safetensors --out robot", "holds 'reward', not a policy"),
    ("export used --out robot", "no run in", "used"),
    ("export begun --out robot", "begun has no policy.safetensors", "`offairl resume begun` goes"),
    ("export damaged --out robot", "curve.csv is damaged", "bring all of damaged back"),
    ("export done --out robot --member 2", "member is 2; done has members 0 to 1"),
    ("export done --out robot --member -1", "member is -1", "0 to 1"),
    ("export done --out robot --member all", "--member", "all"),
    ("export done --out file", "file is no folder", "choose another"),
    ("export done --out file/below", "file is no folder", "choose another"),
    # Films.
    ("watch nowhere", "no run or policy file nowhere", "`offairl list`"),
    ("watch Pendulum-v1", "no expert is shipped for Pendulum-v1"),
    ("watch no.safetensors", "no policy at no.safetensors"),
    ("watch used", "used"),
    ("watch file", "file"),
    ("watch begun", "begun has no policy.safetensors", "`offairl resume begun` goes on"),
    ("watch reward.safetensors", "holds 'reward', not a policy"),
    ("watch done --member 2", "member is 2", "in [0, 1]"),
    ("watch done --member -1", "member is -1", "in [0, 1]"),
    ("watch done --out film.gif", "out is film.gif", "--out film.mp4"),
    ("watch done --env-id Hopper-v5", "3", "11"),
    ("watch done --env-id Nowhere-v0", "unknown environment 'Nowhere-v0'"),
    ("watch done --max-steps 0", "max-steps is 0", "at least 1"),
    ("watch done --max-steps -3", "max-steps is -3", "at least 1"),
    ("watch done --max-steps some", "--max-steps", "some"),
]


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A working directory with runs, files and data sets of all kinds, made once."""
    place, threads = tmp_path_factory.mktemp("commands"), torch.get_num_threads()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        patch.setenv("MINARI_DATASETS_PATH", str(place / "minari"))
        patch.delenv("OFFAIRL_SCALE", raising=False)
        patch.setattr(sys, "path", list(sys.path))
        actor, normaliser = SquashedGaussian(3, 2, (8,)), Normaliser.identity(2, 3)
        experts = Policy(MAZE, actor, actor.init(Rng((0, 1))), normaliser)
        experts.save("experts/PointMazeLeft.safetensors")
        patch.setattr(demonstrations, "EXPERTS", place / "experts")
        actor = SquashedGaussian(3, 1, (8,))
        mine = Policy("Pendulum-v1", actor, actor.init(Rng((0,))), Normaliser.identity(1, 3))
        mine.save("mine/policy.safetensors")
        net = StackedMLP((3, 4, 1))
        Reward(MAZE, net, True, net.init(Rng((0, 1))), normaliser).save("reward.safetensors")
        Path("file").write_text("mine")
        Path("used").mkdir()
        Path("used/notes.txt").write_text("mine")
        for line in (
            f"run maze-expert {SMALL} --out done",
            f"run maze-expert {SMALL} --out damaged",
            f"run maze-expert {SMALL} --out begun --prepare",
            f"demos {MAZE}",
            "demos Pendulum-v1 --policy mine --dataset own/pendulum-v0 --trajectories 2",
        ):
            cli.main(line.split())
        shutil.copytree("begun", "strange")
        about = records.read_json(Path("begun/config.json"))
        about["config"]["env_id"] = "evil:Evil-v0"
        records.write_json(Path("strange/config.json"), about)
        curve = Path("damaged/curve.csv")
        curve.write_text(curve.read_text().replace("-", "-1", 1))
        yield place
    torch.set_num_threads(threads)


def names(place):
    return sorted(path for path in place.rglob("*") if path.name != "lock")


def test_there_are_many_rows_and_each_is_there_once():
    lines = [line for line, *_ in ROWS]
    assert len(lines) == len(set(lines)) >= 180


@pytest.mark.parametrize(("line", "words"), [(line, words) for line, *words in ROWS])
def test_a_command_that_makes_no_sense_is_answered(line, words, place, capsys):
    before = names(place)
    with pytest.raises(SystemExit) as stop:
        cli.main(line.split())
    out, err = capsys.readouterr()
    if isinstance(stop.value.code, str):
        said = stop.value.code
        assert said.startswith("offairl: ")
        assert "\n" not in said
    else:
        assert stop.value.code == 2
        said = " ".join(re.sub(r"[│╭╮╰╯─]", " ", out + err).split())
    names_of = {*messages.OTHERS, *flat_settings()}
    if isinstance(
        stop.value.code, str
    ):  # What tyro says has help in it, where settings have names.
        assert not names_of & set(re.findall(r"[a-z]+(?:_[a-z]+)+(?!\.s)", said)), said
    for word in words:
        assert word in said
    assert not re.search("Errno|Traceback|KeyError|TypeError|dummy|Annotated", said)
    assert names(place) == before


def test_a_reward_of_another_task_is_taken_with_a_note(place, capsys):
    line = (
        f"run imitate --reward frozen --frozen-reward reward.safetensors {SMALL} --train-every 50"
    )
    for env_id, noted in ((MAZE, False), (RIGHT, True)):
        cli.main([*line.split(), "--prepare", "--env-id", env_id, "--out", f"noted-{noted}"])
        note = f"note: the frozen reward is of {MAZE}, this run of {RIGHT}; only sizes"
        assert (note in capsys.readouterr().err) == noted
