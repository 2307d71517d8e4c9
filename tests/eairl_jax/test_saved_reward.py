"""A learned reward on disk is the reward that was learned."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import Config, InputError, LearnedReward, RewardParams, discriminator, load_reward, save_reward
from eairl_jax.methods import with_method_defaults
from eairl_jax.normalize import ObsStats

DESCRIPTION = {"task": "toy", "obs_size": 4, "action_size": 2, "seeds": [5, 6], "iteration": 100}
RNG = np.random.default_rng(0)
OBS, ACTION = RNG.normal(3.0, 2.0, size=(2, 7, 4)), RNG.normal(size=(2, 7, 2))


@pytest.fixture
def learned(tiny):
    """A reward of two seeds, whose normalisers differ."""

    def make(form="sa", part="net", **changes):
        config = tiny(reward_form=form, action_part=part, hidden=(6, 5), **changes)
        params = [discriminator.init(jax.random.PRNGKey(i), 4, 2, with_method_defaults(config)) for i in range(2)]
        if config.layer_norm:  # the first scales are 1 and the first biases 0
            params = [jax.tree.map(lambda x: x + RNG.normal(size=x.shape).astype(x.dtype), each) for each in params]
        stats = [ObsStats(jnp.full(4, 3.0 * i), jnp.full(4, 4.0), jnp.zeros(())) for i in range(2)]
        rewards = [{name: each[name] for name in ("g", "k") if name in each} for each in params]
        rows = map(RewardParams, rewards, stats)
        return LearnedReward(dict(DESCRIPTION), config, jax.tree.map(lambda *x: np.stack(x), *rows))

    return make


@pytest.fixture
def saved(tmp_path, learned):
    save_reward(tmp_path / "run" / "reward", learned())
    return tmp_path / "run" / "reward"


@pytest.mark.parametrize(
    ("form", "part"), [("sa", "net"), ("s", "net"), ("separable", "net"), ("separable", "quadratic")]
)
def test_a_round_trip_gives_the_same_rewards_for_raw_observations(tmp_path, learned, numpy_reward, form, part):
    reward = learned(form, part)
    save_reward(tmp_path, reward)
    loaded = load_reward(tmp_path, obs_size=4, action_size=2)
    assert (loaded.description, loaded.config) == (reward.description, reward.config)
    for seed in range(2):
        params = jax.tree.map(lambda x, seed=seed: x[seed], reward.params.params)
        given = loaded(OBS, ACTION, seed)
        np.testing.assert_array_equal(given, reward(OBS, ACTION, seed))
        np.testing.assert_allclose(given, numpy_reward(params, (OBS - 3.0 * seed) / 2, ACTION), atol=1e-4)
    assert np.abs(loaded(OBS, ACTION, 0) - loaded(OBS, ACTION, 1)).max() > 0.01


@pytest.mark.parametrize("form", ["sa", "separable"])
def test_a_reward_of_normalised_layers_is_the_same_in_jax_in_numpy_and_on_disk(tmp_path, learned, numpy_reward, form):
    reward = learned(form, layer_norm=True)
    save_reward(tmp_path, reward)
    loaded = load_reward(tmp_path)
    for seed in range(2):
        params = jax.tree.map(lambda x, seed=seed: x[seed], reward.params.params)
        expected = numpy_reward(params, (OBS - 3.0 * seed) / 2, ACTION)
        np.testing.assert_allclose(loaded(OBS, ACTION, seed), expected, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(loaded.numpy(seed)(OBS, ACTION), loaded(OBS, ACTION, seed), rtol=1e-5, atol=1e-5)
    plain = LearnedReward(reward.description, dataclasses.replace(reward.config, layer_norm=False), reward.params)
    with pytest.raises(InputError, match=r"LayerNorm_0/bias.*, which no network has"):
        save_reward(tmp_path / "plain", plain)


@pytest.mark.parametrize(("obs_size", "action_size"), [(3, 2), (4, 6), (3, 1)])
def test_other_sizes_are_refused_with_both(saved, obs_size, action_size):
    both = (
        "observations of length 4, actions of length 2.*"
        f"observations of length {obs_size} and actions of length {action_size}"
    )
    with pytest.raises(InputError, match=both):
        load_reward(saved, obs_size, action_size)
    with pytest.raises(InputError, match=both):
        load_reward(saved)(np.zeros((5, obs_size)), np.zeros((5, action_size)))


@pytest.mark.parametrize("seed", [2, -3])
def test_a_seed_that_was_not_trained_is_refused(saved, seed):
    with pytest.raises(InputError, match=str(seed)):
        load_reward(saved)(OBS, ACTION, seed=seed)


def edit(name, change):
    """Changes the JSON of a saved reward."""

    def apply(folder):
        path = folder / name
        content = json.loads(path.read_text())
        change(content)
        path.write_text(json.dumps(content))

    return apply


def rewrite(**arrays):
    return lambda folder: np.savez(folder / "reward.npz", **arrays)


BROKEN = {
    "no json": (lambda f: (f / "reward.json").unlink(), "holds no reward.json: use the reward/ folder"),
    "no arrays": (lambda f: (f / "reward.npz").unlink(), "reward.npz does not exist"),
    "json cut": (lambda f: (f / "reward.json").write_text('{"kind": "eair'), "reward.json is not JSON"),
    "arrays cut": (
        lambda f: (f / "reward.npz").write_bytes((f / "reward.npz").read_bytes()[:200]),
        "not a complete .npz",
    ),
    "objects": (rewrite(params=np.array([{}], dtype=object)), "not a complete .npz of plain arrays"),
    "another kind": (edit("reward.json", lambda c: c.update(kind="policy")), "does not describe a learned reward"),
    "no settings": (edit("reward.json", lambda c: c.pop("config")), "reward.json"),
    "unknown setting": (edit("reward.json", lambda c: c["config"].update(colour="red")), "reward.json"),
    "impossible setting": (edit("reward.json", lambda c: c["config"].update(num_envs=0)), "num_envs"),
    "no sizes": (edit("reward.json", lambda c: c.pop("obs_size")), "reward.json"),
    "arrays of something else": (rewrite(weights=np.zeros(3)), "reward.npz"),
    "no normaliser": (rewrite(**{"params/g/params/x": np.zeros(3)}), "reward.npz"),
}


@pytest.mark.parametrize(("breakage", "message"), BROKEN.values(), ids=BROKEN.keys())
def test_a_broken_folder_is_refused(saved, breakage, message):
    breakage(saved)
    with pytest.raises(InputError, match=message):
        load_reward(saved, 4, 2)


CONFIG = {
    "a text for a number": ({"num_envs": "x"}, "num_envs = 'x': expected a whole number"),
    "texts for widths": ({"hidden": ["a"]}, r"hidden = \('a',\): expected a tuple of whole numbers"),
    "other widths": ({"hidden": [6, 7]}, r"reward\.npz: params/g/params/MLP_0/Dense_1/.* has shape .*: expected"),
    "another depth": ({"hidden": [6]}, r"reward\.npz holds .*Dense_2/bias.*, which no network has"),
    "an absurd width": ({"hidden": [10**9]}, r"hidden = \(1000000000,\): expected 1 to 100 widths"),
    "many layers": ({"hidden": [1] * 1000}, "hidden = a list of 1000 values: expected 1 to 100 widths"),
    "a huge number": ({"iterations": 2**62}, "iterations = .*: expected at most 2147483647"),
    "another form": ({"reward_form": "separable"}, r"reward\.npz lacks params/k/params"),
    "a form of smaller input": ({"reward_form": "s"}, "Dense_0/kernel has shape"),
    "another horizon": ({"horizon": "absorbing"}, "has shape"),
    "an infinite std": (
        {"log_std_min": -1e300},
        "log_std_min = -1e.300: expected a number at least -30 and at most 30",
    ),
}


@pytest.mark.parametrize(("changes", "message"), CONFIG.values(), ids=CONFIG)
def test_settings_that_do_not_fit_the_parameters_are_refused(saved, changes, message):
    edit("reward.json", lambda c: c["config"].update(changes))(saved)
    with pytest.raises(InputError, match=message):
        load_reward(saved)


JSON = {
    "no settings": (lambda c: c.update(config=None), "the Config is None: expected an object of settings"),
    "seeds of text": (lambda c: c.update(seeds="56"), "seeds is '56': expected a list of at least 1 values"),
    "a seed that is another": (lambda c: c.update(seeds=[0, 2**32]), r"seeds\[1\] is 4294967296: .* to 4294967295"),
    "too many seeds": (lambda c: c.update(seeds=[1, 2, 3]), "has shape .* for 3 seeds"),
    "no size": (lambda c: c.update(obs_size=0), "obs_size is 0: expected a whole number from 1"),
    "an absurd size": (lambda c: c.update(obs_size=2**60), "obs_size is .*: expected a whole number from 1"),
    "another size": (lambda c: c.update(obs_size=5), "has shape"),
    "another method": (lambda c: c.update(method="gail"), "method is 'gail', and the config says 'eairl'"),
    "other iterations": (lambda c: c.update(iterations=[1]), "1 iterations of 2 seeds"),
    "a task of two lines": (lambda c: c.update(task="a\nb"), "task is 'a.nb': expected a text of one line"),
    "a changed note": (lambda c: c.update(iteration=200), "is not as it was written"),
    "a lost checksum": (lambda c: c.pop("checksum"), "has lost a part"),
}


@pytest.mark.parametrize(("change", "message"), JSON.values(), ids=JSON)
def test_a_description_is_checked(saved, change, message):
    edit("reward.json", change)(saved)
    with pytest.raises(InputError, match=message):
        load_reward(saved)


def test_a_reward_of_an_earlier_version_has_no_checksum(saved):
    edit("reward.json", lambda c: [c.pop(name) for name in ("checksum", "sealed")])(saved)
    assert load_reward(saved).description == DESCRIPTION


ARRAYS = {
    "NaN": ("params/g/params/MLP_0/Dense_0/bias", lambda x: x * np.nan, "no finite float32"),
    "whole numbers": ("params/g/params/MLP_0/Dense_0/bias", lambda x: x.astype(int), "no finite float32"),
    "a negative variance": ("obs_stats/var", lambda x: -x, "negative variance"),
    "a changed weight": ("params/g/params/MLP_0/Dense_0/bias", lambda x: x + 1, "is not as it was written"),
}


@pytest.mark.parametrize(("name", "change", "message"), ARRAYS.values(), ids=ARRAYS)
def test_parameters_are_finite_and_as_they_were_written(saved, name, change, message):
    with np.load(saved / "reward.npz") as archive:
        arrays = dict(archive)
    np.savez(saved / "reward.npz", **arrays | {name: change(arrays[name])})
    with pytest.raises(InputError, match=message):
        load_reward(saved)


UNSAVED = {
    "no reward": (lambda r: r.params, "reward is .*: expected a LearnedReward"),
    "other networks": (lambda r: LearnedReward(r.description, Config(), r.params), "params.* has shape"),
    "no task": (lambda r: LearnedReward({}, r.config, r.params), "lacks task"),
    "what JSON cannot hold": (
        lambda r: LearnedReward(r.description | {"note": {1, 2}}, r.config, r.params),
        "cannot be written as JSON",
    ),
}


@pytest.mark.parametrize(("make", "message"), UNSAVED.values(), ids=UNSAVED)
def test_what_could_not_be_loaded_is_not_saved(tmp_path, learned, make, message):
    with pytest.raises(InputError, match=message):
        save_reward(tmp_path / "new", make(learned()))
    assert not (tmp_path / "new").exists()


CALLS = {
    "a text": (("obs", ACTION), "obs is 'obs': expected an array"),
    "a number": ((1.0, ACTION), r"obs has shape \(\)"),
    "other axes": ((OBS, ACTION[:1]), "expected the same axes before the last"),
    "half a seed": ((OBS, ACTION, 0.5), "seed = 0.5: the run of this reward had 2 seeds"),
}


@pytest.mark.parametrize(("arguments", "message"), CALLS.values(), ids=CALLS)
def test_a_call_is_checked(learned, arguments, message):
    with pytest.raises(InputError, match=message):
        learned()(*arguments)
    with pytest.raises(InputError, match="config is None: expected a Config"):
        LearnedReward(DESCRIPTION, None, learned().params)
