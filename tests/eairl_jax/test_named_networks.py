"""A network of a user's own: it learns, is saved by its name, and runs only where the program knows it."""

import json
import pickle
import sys

import flax.linen as nn
import jax
import numpy as np
import pytest

from eairl_jax import (
    NETWORKS,
    HParams,
    InputError,
    LearnedReward,
    export,
    learned_reward,
    load_reward,
    make_irl,
    named_networks,
    numpy_nets,
    save_reward,
)

pytestmark = pytest.mark.usefixtures("no_trace")
NAME = "somewhere.nets:Skip"
OBS, ACTION = (np.random.default_rng(0).normal(size=(7, n)).astype(np.float32) for n in (4, 2))


class Skip(nn.Module):
    """A perceptron with a linear part beside it."""

    width: int = 5

    @nn.compact
    def __call__(self, x):
        return (nn.Dense(1)(nn.tanh(nn.Dense(self.width)(x))) + nn.Dense(1)(x))[..., 0]


class Column(nn.Module):
    """Gives one number too many an axis."""

    @nn.compact
    def __call__(self, x):
        return nn.Dense(1)(x)


class Stateful(nn.Module):
    """Has variables that are no parameters."""

    @nn.compact
    def __call__(self, x):
        return nn.BatchNorm(use_running_average=True)(nn.Dense(1)(x))[..., 0]


class Unknown(nn.Module):
    """Cannot be computed."""

    @nn.compact
    def __call__(self, x):
        raise RuntimeError("no such\nthing")


@pytest.fixture
def saved(tmp_path, tiny, toy, demos):
    """`(folder, reward)` that a network of a user's own has learned; the program has forgotten the network."""
    NETWORKS[NAME] = Skip
    config = tiny(net=NAME, method="airl_sa")
    algorithm = make_irl(toy(), config)
    first = algorithm.init(jax.random.PRNGKey(0), HParams())
    state, metrics = jax.jit(algorithm.step)(first, HParams(discriminator_lr=0.05), demos)
    assert np.isfinite(metrics["discriminator_loss"])
    params = jax.tree.map(lambda x: np.asarray(x)[None], learned_reward(state))
    assert set(state.discriminator.params["h"]["params"]) == {"Dense_0", "Dense_1", "Dense_2"}  # the potential too
    before = learned_reward(first).params
    assert all(
        (a != b).any() for a, b in zip(*map(jax.tree.leaves, (before, learned_reward(state).params)), strict=True)
    )
    reward = LearnedReward({"task": "toy", "obs_size": 4, "action_size": 2, "seeds": [5]}, config, params)
    save_reward(tmp_path / "reward", reward)
    expected = reward(OBS, ACTION)
    del NETWORKS[NAME]
    return tmp_path / "reward", expected


def by_hand(params):
    """The reward that `Skip` computes, in double precision."""
    x, layers = np.concatenate([OBS, ACTION], axis=-1).astype(np.float64), params["g"]["params"]

    def dense(name, x):
        return x @ np.float64(layers[name]["kernel"][0]) + np.float64(layers[name]["bias"][0])

    # flax numbers layers in the order in which they are made: the last layer of the perceptron is made first.
    names = {layers[name]["kernel"].shape[1:]: name for name in layers}
    return (dense(names[5, 1], np.tanh(dense(names[6, 5], x))) + dense(names[6, 1], x))[..., 0]


def test_a_saved_reward_is_what_was_learned_and_runs_no_code_that_the_program_does_not_know(saved):
    folder, expected = saved
    assert json.loads((folder / "reward.json").read_text())["config"]["net"] == NAME
    for load in (load_reward, numpy_nets.load_reward):
        with pytest.raises(InputError, match=r"'somewhere.nets:Skip' is code that this program does not know.*net="):
            load(folder)
    assert "somewhere" not in sys.modules
    reward = load_reward(folder, net=Skip)
    np.testing.assert_array_equal(reward(OBS, ACTION), expected)
    np.testing.assert_allclose(expected, by_hand(reward.params.params), rtol=1e-4, atol=1e-5)
    np.testing.assert_array_equal(load_reward(folder)(OBS, ACTION), expected)  # known from now on
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(reward))(OBS, ACTION), expected)


def test_numpy_cannot_compute_it_and_an_exported_program_can(saved, tmp_path):
    folder, expected = saved
    reward = load_reward(folder, net=Skip)
    for attempt in (reward.numpy, lambda: numpy_nets.load_reward(folder)):
        with pytest.raises(InputError, match=r"NumPy cannot compute the network 'somewhere.nets:Skip'.*eairl export"):
            attempt()
    program, _ = export(reward, tmp_path)
    found = jax.export.deserialize(bytearray(program.read_bytes())).call(OBS, ACTION)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_another_network_of_the_name_is_refused_and_forgotten(saved):
    folder, expected = saved
    with pytest.raises(InputError, match=r"has shape \(1, 5, 1\): expected \(1, 3, 1\)"):
        load_reward(folder, net=lambda: Skip(width=3))
    assert NAME not in NETWORKS
    np.testing.assert_array_equal(load_reward(folder, net=Skip)(OBS, ACTION), expected)


def test_a_reward_of_the_librarys_network_takes_no_other(tmp_path, tiny, toy):
    algorithm, description = make_irl(toy(), tiny()), {"task": "toy", "obs_size": 4, "action_size": 2, "seeds": [5]}
    params = learned_reward(algorithm.init(jax.random.PRNGKey(0), HParams()))
    save_reward(tmp_path, LearnedReward(description, tiny(), jax.tree.map(lambda x: np.asarray(x)[None], params)))
    with pytest.raises(InputError, match="names no network of yours: leave net out"):
        load_reward(tmp_path, net=Skip)


UNFIT = {
    "another shape": (Column, r"gives \(1,\) for inputs of shape \(4,\): expected \(\), one number"),
    "state": (Stateful, "has batch_stats, params: expected parameters alone"),
    "an error": (Unknown, "cannot be computed for inputs of length 4: RuntimeError: no such$"),
    "no module": (dict, r"makes an empty object: expected a flax.linen.Module"),
}


@pytest.mark.parametrize(("net", "message"), UNFIT.values(), ids=UNFIT)
def test_what_cannot_compute_a_reward_is_refused_before_anything_is_compiled(tiny, toy, net, message):
    NETWORKS["mine"] = net
    with pytest.raises(InputError, match=f"^net = 'mine' {message}"):
        make_irl(toy(), tiny(net="mine"))


def test_a_module_is_imported_when_the_user_names_it(tmp_path, monkeypatch, tiny, toy):
    (tmp_path / "nets_of_mine.py").write_text(
        "import flax.linen as nn\nclass Linear(nn.Module):\n    @nn.compact\n"
        "    def __call__(self, x):\n        return nn.Dense(1)(x)[..., 0]\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    make_irl(toy(), tiny(net="nets_of_mine:Linear"))
    assert NETWORKS["nets_of_mine:Linear"] is sys.modules["nets_of_mine"].Linear
    NETWORKS["nets_of_mine:Linear"] = Skip
    named_networks.register("nets_of_mine:Linear")  # what is known stays
    assert NETWORKS["nets_of_mine:Linear"] is Skip


UNNAMED = {
    "mpl": 'expected "mlp", MODULE:NAME, or a key of eairl_jax.NETWORKS',
    "my_nets.py:ResNet": r"a file is loaded by the commands alone.*NETWORKS\['my_nets.py:ResNet'\] = ResNet",
    "no_such_module:ResNet": "no_such_module cannot be imported",
    "json:ResNet": "json has no class or function ResNet",
}


@pytest.mark.parametrize(("name", "message"), UNNAMED.items(), ids=UNNAMED)
def test_what_names_no_network_is_refused(tiny, toy, name, message):
    with pytest.raises(InputError, match=message):
        make_irl(toy(), tiny(net=name))
