"""A learned reward on disk is the reward that was learned."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import InputError, LearnedReward, RewardParams, discriminator, load_reward, save_reward
from eairl_jax.methods import with_method_defaults
from eairl_jax.normalize import ObsStats

DESCRIPTION = {"task": "toy", "obs_size": 4, "action_size": 2, "seeds": [5, 6], "iteration": 100}
RNG = np.random.default_rng(0)
OBS, ACTION = RNG.normal(3.0, 2.0, size=(2, 7, 4)), RNG.normal(size=(2, 7, 2))


@pytest.fixture
def learned(tiny):
    """A reward of two seeds, whose normalisers differ."""

    def make(form="sa", part="net"):
        config = tiny(reward_form=form, action_part=part, hidden=(6, 5))
        params = [discriminator.init(jax.random.PRNGKey(i), 4, 2, with_method_defaults(config)) for i in range(2)]
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
