"""Files of policies and rewards from elsewhere: data, which are read whole or refused by name."""

import json
import sys

import gymnasium
import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from offairl_lite.analysis import films
from offairl_lite.core.networks import Normaliser, StackedMLP
from offairl_lite.core.policies import MultiplicativeGaussian, Policy, SquashedGaussian
from offairl_lite.core.rewards import Reward
from offairl_lite.core.rng import Rng
from offairl_lite.core.rollouts import rollout
from offairl_lite.runs import cli

MAZE = "offairl/PointMazeLeft-v0"
ACTOR = SquashedGaussian(3, 2, (4,))
NET = StackedMLP((3, 4, 1), "tanh")
SCALE = {"mean": torch.zeros(2, 1, 3), "std": torch.ones(2, 1, 3)}
TENSORS = {
    Policy: {"params": ACTOR.init(Rng((0, 1))), **SCALE},
    Reward: {"params": NET.init(Rng((0, 1))), **SCALE},
}
ACTOR_DATA = {
    "name": "SquashedGaussian",
    "obs_dim": 3,
    "action_dim": 2,
    "hidden": [4],
    "log_std_range": [-5.0, 2.0],
}
ABOUT = {
    Policy: {"kind": "policy", "env_id": MAZE, "actor": ACTOR_DATA},
    Reward: {
        "kind": "reward",
        "env_id": MAZE,
        "sizes": [3, 4, 1],
        "activation": "tanh",
        "state_only": True,
    },
}
ABSENT = object()


def write(path, kind, about=None, tensors=None, text=None):
    """Write a file that is right but for some changes."""
    about = ABOUT[kind] | (about or {})
    about = {name: value for name, value in about.items() if value is not ABSENT}
    tensors = TENSORS[kind] | (tensors or {})
    tensors = {name: value for name, value in tensors.items() if value is not ABSENT}
    save_file(tensors, path, {"about": json.dumps(about) if text is None else text})
    return path


@pytest.fixture
def path(tmp_path):
    return tmp_path / "given.safetensors"


@pytest.mark.parametrize("kind", [Policy, Reward])
def test_a_file_that_is_right_is_read(path, kind):
    read = kind.load(write(path, kind))
    assert (read.env_id, len(read)) == (MAZE, 2)
    assert torch.equal(read.params, TENSORS[kind]["params"])
    half = {"params": TENSORS[kind]["params"].half()}
    assert kind.load(write(path, kind, tensors=half)).params.dtype == torch.float32


@pytest.mark.parametrize("kind", [Policy, Reward])
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{nope", "given.safetensors is no safetensors file of this package: Expecting"),
        ("", "given.safetensors is no safetensors file of this package: Expecting value"),
        ("[" * 200_000, "given.safetensors is no safetensors file of this package"),
        ('{"a":' * 100_000, "given.safetensors is no safetensors file of this package"),
        ("[]", "given.safetensors holds 'no metadata', not a"),
        ("[1, 2]", "given.safetensors holds 'no metadata', not a"),
        ("null", "given.safetensors holds 'no metadata', not a"),
        ("3", "given.safetensors holds 'no metadata', not a"),
        ('"policy"', "given.safetensors holds 'no metadata', not a"),
        ("{}", "given.safetensors holds 'something unnamed', not a"),
        ('{"kind": "checkpoint"}', "given.safetensors holds 'checkpoint', not a"),
        ('{"kind": ["policy"]}', "given.safetensors holds ['policy'], not a"),
    ],
)
def test_metadata_that_cannot_be_read(refused, path, kind, text, words):
    write(path, kind, text=text)
    refused(lambda: kind.load(path), words)


@pytest.mark.parametrize("kind", [Policy, Reward])
@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is no safetensors file of this package"),
        (b"a text", "is no safetensors file of this package"),
        (b"\xff" * 64, "is no safetensors file of this package"),
        (slice(0, 40), "is no safetensors file of this package"),
        (slice(0, -1), "is no safetensors file of this package"),
        (slice(8, None), "is no safetensors file of this package"),
    ],
)
def test_bytes_that_cannot_be_read(refused, path, kind, content, words):
    whole = write(path, kind).read_bytes()
    path.write_bytes(whole[content] if isinstance(content, slice) else content)
    refused(lambda: kind.load(path), f"given.safetensors {words}")


@pytest.mark.parametrize("kind", [Policy, Reward])
def test_one_is_not_taken_for_the_other(refused, path, kind):
    other = Reward if kind is Policy else Policy
    write(path, kind)
    refused(lambda: other.load(path), f"given.safetensors holds {kind.__name__.lower()!r}, not a")


def of(part, index, value):
    """A tensor of the right file with one number changed, for each kind of file."""

    def change(kind):
        tensor = TENSORS[kind][part].clone()
        tensor[index] = value
        return {part: tensor}

    return change


def by(part, change):
    """A tensor of the right file changed as a whole."""
    return lambda kind: {part: change(TENSORS[kind][part]).contiguous()}


@pytest.mark.parametrize("kind", [Policy, Reward])
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (of("params", (1, 3), torch.nan), "params must be finite"),
        (of("params", (0, 0), torch.inf), "params must be finite"),
        (of("mean", (0, 0, 1), torch.nan), "mean must be finite"),
        (of("std", (0, 0, 1), torch.inf), "std must be finite, and std above 0"),
        (of("std", (1, 0, 2), 0.0), "std must be finite, and std above 0"),
        (of("std", (1, 0, 2), -1.0), "std must be finite, and std above 0"),
        (
            by("params", torch.Tensor.long),
            "params is torch.int64 of shape...expected torch.float32",
        ),
        (by("params", torch.Tensor.double), "params is torch.float64 of...expected torch.float32"),
        (by("params", torch.Tensor.bfloat16), "params is torch.bfloat16 of...expected torch.float"),
        (by("params", torch.Tensor.bool), "params is torch.bool of...expected torch.float32"),
        (by("mean", torch.Tensor.long), "mean is torch.int64 of...expected torch.float32"),
        (by("std", torch.Tensor.double), "std is torch.float64 of...expected torch.float32"),
        (by("params", lambda x: x[:, 1:]), "params is torch.float32 of shape (2, ...expected"),
        (by("params", lambda x: x[0]), "params is torch.float32 of shape ("),
        (by("params", lambda x: x[None]), "params is torch.float32 of shape (1, 2, "),
        (by("params", lambda x: x.sum()), "len() of a 0-d tensor"),
        (by("params", lambda x: x[:0]), "params is torch.float32 of shape (0, ...expected"),
        (by("params", lambda x: x[:1]), "mean is torch.float32 of shape (2, 1, 3); expected"),
        (by("mean", lambda x: x[:1]), "mean is torch.float32 of shape (1, 1, 3); expected"),
        (by("std", lambda x: x[:1]), "std is torch.float32 of shape (1, 1, 3); expected"),
        (by("mean", lambda x: x[:, 0]), "mean is torch.float32 of shape (2, 3); expected"),
        (by("std", lambda x: x[..., :2]), "std is torch.float32 of shape (2, 1, 2); expected"),
        (lambda kind: {"params": ABSENT}, "it has no 'params'"),
        (lambda kind: {"mean": ABSENT}, "it has no 'mean'"),
        (lambda kind: {"std": ABSENT}, "it has no 'std'"),
    ],
)
def test_tensors_that_do_not_make_one(refused, path, kind, change, words):
    write(path, kind, tensors=change(kind))
    refused(lambda: kind.load(path), f"given.safetensors describes no ...{words}")


def actor(**changes):
    """What a policy's file says, with another actor."""
    data = {name: x for name, x in (ACTOR_DATA | changes).items() if x is not ABSENT}
    return {"actor": data}


@pytest.mark.parametrize(
    ("kind", "about", "words"),
    [
        (Policy, {"env_id": ABSENT}, "it has no 'env_id'"),
        (Policy, {"env_id": None}, "env_id is None; expected a text"),
        (Policy, {"env_id": 3}, "env_id is 3; expected a text"),
        (Policy, {"env_id": [MAZE]}, "env_id is ['offairl/PointMazeLeft-v0']; expected a text"),
        (Reward, {"env_id": ABSENT}, "it has no 'env_id'"),
        (Reward, {"env_id": {}}, "env_id is {}; expected a text"),
        (Policy, {"actor": ABSENT}, "it has no 'actor'"),
        (Policy, {"actor": None}, "'NoneType' object is not iterable"),
        (Policy, {"actor": "SquashedGaussian"}, "dictionary update sequence"),
        (Policy, {"actor": []}, "it has no 'name'"),
        (Policy, actor(name=ABSENT), "it has no 'name'"),
        (Policy, actor(name="Actress"), "the actor is 'Actress'; expected one of Squashed"),
        (Policy, actor(name="Policy"), "the actor is 'Policy'; expected one of Squashed"),
        (Policy, actor(name=["SquashedGaussian"]), "unhashable type: 'list'"),
        (Policy, actor(obs_dim=ABSENT), "missing 1 required positional argument: 'obs_dim'"),
        (Policy, actor(hidden=ABSENT), "missing 1 required positional argument: 'hidden'"),
        (Policy, actor(colour="red"), "unexpected keyword argument 'colour'"),
        (Policy, actor(obs_dim=4), "params is torch.float32 of shape (2, ...expected"),
        (Policy, actor(obs_dim="3"), "obs_dim is '3'; expected a whole number of at least 1"),
        (Policy, actor(obs_dim=3.0), "obs_dim is 3.0; expected a whole number of at least 1"),
        (Policy, actor(obs_dim=-3), "obs_dim is -3; expected a whole number of at least 1"),
        (Policy, actor(action_dim=True), "action_dim is True; expected a whole number"),
        (Policy, actor(action_dim=0), "action_dim is 0; expected a whole number of at least 1"),
        (Policy, actor(hidden=4), "hidden is 4; expected a tuple, each part a whole number"),
        (Policy, actor(hidden="4"), "hidden is '4'; expected a tuple"),
        (Policy, actor(hidden=[4.5]), "hidden is [4.5]; expected a tuple"),
        (Policy, actor(hidden=[-4]), "hidden is [-4]; expected a tuple"),
        (Policy, actor(hidden=[[4]]), "hidden is [[4]]; expected a tuple"),
        (Policy, actor(hidden=[10**12]), "params is torch.float32 of shape (2, ...expected"),
        (Policy, actor(log_std_range=[0.0]), "log_std_range is [0.0]; expected 2 numbers"),
        (Policy, actor(log_std_range=["a", "b"]), "log_std_range is ['a', 'b']; expected 2 num"),
        (
            Policy,
            actor(log_std_range=[2, -5]),
            "log_std_range is [2, -5]; expected 2 numbers in asc",
        ),
        (Policy, actor(log_std_range=[0, float("nan")]), "log_std_range is [0, nan]; expected 2"),
        (
            Policy,
            actor(name="Deterministic", log_std_range=ABSENT, noise_std="loud"),
            "noise_std is 'loud'; expected a number",
        ),
        (
            Policy,
            actor(name="MultiplicativeGaussian", gating="hard"),
            "gating is 'hard'; expected one of ('softmax', 'sigmoid', 'softplus')",
        ),
        (
            Policy,
            actor(name="MultiplicativeGaussian", primitives=0),
            "primitives is 0; expected a whole number of at least 1",
        ),
        (Reward, {"sizes": ABSENT}, "missing 1 required positional argument: 'sizes'"),
        (Reward, {"sizes": None}, "sizes is None; expected a tuple"),
        (Reward, {"sizes": "341"}, "sizes is '341'; expected a tuple"),
        (Reward, {"sizes": [3, 4.0, 1]}, "sizes is [3, 4.0, 1]; expected a tuple"),
        (Reward, {"sizes": [3, 0, 1]}, "sizes is [3, 0, 1]; expected a tuple"),
        (Reward, {"sizes": []}, "tuple index out of range"),
        (Reward, {"sizes": [3]}, "net.sizes=(3,) and state_only=True, for observations of 3"),
        (Reward, {"sizes": [3, 4, 2]}, "net.sizes=(3, 4, 2) and state_only=True"),
        (Reward, {"sizes": [4, 4, 1]}, "net.sizes=(4, 4, 1) and state_only=True"),
        (Reward, {"sizes": [3, 5, 1]}, "params is torch.float32 of shape (2, 21); expected"),
        (Reward, {"activation": "sine"}, "activation is 'sine'; expected one of ('relu', 'tanh')"),
        (Reward, {"activation": None}, "activation is None; expected one of ('relu', 'tanh')"),
        (Reward, {"state_only": ABSENT}, "it has no 'state_only'"),
        (Reward, {"state_only": "no"}, "state_only is 'no'; expected True or False"),
        (Reward, {"state_only": 1}, "state_only is 1; expected True or False"),
        (Reward, {"state_only": False}, "state_only=False, for observations of 3"),
    ],
)
def test_metadata_that_do_not_make_one(refused, path, kind, about, words):
    write(path, kind, about)
    refused(lambda: kind.load(path), f"given.safetensors describes no ...{words}")


def test_an_actor_s_lists_become_tuples(path):
    plain = MultiplicativeGaussian(
        3, 2, (4,), primitives=2, primitive_hidden=(4,), gate_hidden=(4,)
    )
    Policy(MAZE, plain, plain.init(Rng((0,))), Normaliser.identity(1, 3)).save(path)
    assert Policy.load(path).actor == plain


@pytest.fixture
def evil(tmp_path, monkeypatch):
    """A policy's file that names a module, which lies in the working directory."""
    (tmp_path / "evil.py").write_text(
        "import gymnasium\nfrom own_task import Arm\n"
        "gymnasium.register('Evil-v0', entry_point=Arm, max_episode_steps=5)\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    plain = SquashedGaussian(2, 2, (4,))
    policy = Policy("evil:Evil-v0", plain, plain.init(Rng((0,))), Normaliser.identity(1, 2))
    policy.save(tmp_path / "evil.safetensors")
    yield tmp_path / "evil.safetensors"
    gymnasium.registry.pop("Evil-v0", None)
    sys.modules.pop("evil", None)


@pytest.mark.parametrize(
    "use",
    [
        lambda path: cli.watch(str(path)),
        lambda path: rollout((p := Policy.load(path)), p.env_id, (0,), 1),
        lambda path: films.frames((p := Policy.load(path)), p.env_id),
    ],
)
def test_a_file_s_module_is_not_imported(refused, evil, use):
    refused(lambda: use(evil), "unknown environment 'Evil-v0'...my_module:Evil-v0")
    assert "evil" not in sys.modules


def test_the_reward_s_module_is_not_imported_either(path):
    assert Reward.load(write(path, Reward, {"env_id": "a:b:Evil-v0"})).env_id == "Evil-v0"


def test_a_module_that_the_user_names_is_imported(evil, capsys):
    made = rollout(Policy.load(evil), "evil:Evil-v0", (0,), 1)
    assert made.lengths.tolist() == [[5]]
    # Now that it is there, the task's own name will do.
    np.testing.assert_array_equal(rollout(Policy.load(evil), "Evil-v0", (0,), 1).obs, made.obs)
