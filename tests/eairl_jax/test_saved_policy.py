"""A policy on disk acts as the policy that was trained, and so does its copy in NumPy."""

import dataclasses
import json
import pickle

import jax
import numpy as np
import pytest

from eairl_jax import Config, HParams, InputError, LearnedPolicy, load_policy, make_rl, policy_params, save_policy

OBS = np.random.default_rng(0).normal(3.0, 2.0, size=(2, 7, 4)).astype(np.float32)
LIMIT = 2.0
FORMS = {
    "sampled": {},
    "clipped": {"actions": "clipped"},
    "its own stds": {"state_dependent_std": True, "policy_activation": "tanh"},
    "absorbing": {"horizon": "absorbing"},
    "layer norm": {"policy_layer_norm": True},
}


@pytest.fixture(scope="module")
def trained(toy, tiny, scale):
    """`(algorithm, states [2, ...], LearnedPolicy)` of a kind of policy, with random weights."""

    def make(**changes):
        config = dataclasses.replace(tiny(policy_hidden=(6, 5)), **changes)
        env = toy(ends_at=4, action_limit=LIMIT, scale=tuple(map(tuple, scale)))
        algorithm = make_rl(env, config)
        state = jax.vmap(algorithm.init, (0, None))(jax.random.split(jax.random.PRNGKey(0), 2), HParams())
        nets = state.agent.policy.nets
        keys = iter(jax.random.split(jax.random.PRNGKey(1), 99))
        params = jax.tree.map(lambda x: x + 0.1 * jax.random.normal(next(keys), x.shape), nets.params)
        policy = dataclasses.replace(state.agent.policy, nets=dataclasses.replace(nets, params=params))
        state = dataclasses.replace(state, agent=dataclasses.replace(state.agent, policy=policy))
        description = {"task": "toy", "obs_size": 4, "action_size": 2, "action_limit": LIMIT, "seeds": [5, 6]}
        return algorithm, state, LearnedPolicy(description, config, policy_params(state))

    return make


@pytest.mark.parametrize("changes", FORMS.values(), ids=FORMS)
def test_a_loaded_policy_acts_as_it_was_trained(trained, tmp_path, changes):
    algorithm, state, policy = trained(**changes)
    save_policy(tmp_path / "policy", policy)
    loaded, key = load_policy(tmp_path / "policy"), jax.random.PRNGKey(7)
    for seed in range(2):
        row = jax.tree.map(lambda x, seed=seed: x[seed], state)
        for given in (None, key):
            expected = np.clip(algorithm.act(row, OBS, given), -LIMIT, LIMIT)
            for each in (policy, loaded, pickle.loads(pickle.dumps(loaded))):
                np.testing.assert_allclose(each(OBS, given, seed), expected, atol=1e-5)
            assert np.std(expected) > 0.01
        np.testing.assert_allclose(
            loaded.numpy(seed)(OBS), np.clip(algorithm.act(row, OBS, None), -LIMIT, LIMIT), atol=1e-5
        )


@pytest.mark.parametrize("changes", FORMS.values(), ids=FORMS)
def test_samples_in_numpy_have_the_policys_std(trained, changes):
    policy = trained(**changes)[2]
    wide = LearnedPolicy(policy.description | {"action_limit": 100.0}, policy.config, policy.params)
    obs, draws = np.repeat(OBS[:1, :1], 4000, axis=1), np.random.default_rng(0)
    ours = wide.numpy(1)(obs, draws)
    assert ours.dtype == wide.numpy(1)(obs.astype(np.float64)).dtype == np.float32  # as Gymnasium's spaces ask for
    theirs = wide(obs, jax.random.PRNGKey(0), 1)
    np.testing.assert_allclose(ours.mean(axis=1), theirs.mean(axis=1), atol=0.1)
    np.testing.assert_allclose(ours.std(axis=1), theirs.std(axis=1), rtol=0.05)


def edit(change):
    """Changes `policy.json`."""

    def apply(folder):
        path = folder / "policy.json"
        content = json.loads(path.read_text())
        change(content)
        path.write_text(json.dumps(content))

    return apply


BROKEN = {
    "no json": (lambda f: (f / "policy.json").unlink(), "holds no policy.json: use the policy/ folder"),
    "no arrays": (lambda f: (f / "policy.npz").unlink(), "policy.npz does not exist"),
    "a reward": (edit(lambda c: c.update(kind="eairl_jax reward")), "does not describe a policy"),
    "a newer format": (edit(lambda c: c.update(format=2)), "has the format 2, and this version reads 1"),
    "other networks": (edit(lambda c: c["config"].update(policy_hidden=[7])), "holds .*which no network has"),
    "another kind of std": (edit(lambda c: c["config"].update(state_dependent_std=True)), "raw_log_std"),
    "a changed limit": (edit(lambda c: c.update(action_limit=3.0)), "is not as it was written"),
}


@pytest.mark.parametrize(("breakage", "message"), BROKEN.values(), ids=BROKEN)
def test_a_broken_folder_is_refused(trained, tmp_path, breakage, message):
    save_policy(tmp_path, trained()[2])
    breakage(tmp_path)
    with pytest.raises(InputError, match=message):
        load_policy(tmp_path)


def test_a_call_is_checked(trained, tmp_path):
    policy = trained()[2]
    with pytest.raises(InputError, match="observations of length 3"):
        policy(OBS[..., :3])
    with pytest.raises(InputError, match="seed = 2: the run of this policy had 2 seeds"):
        policy(OBS, seed=2)
    with pytest.raises(InputError, match="config is None: expected a Config"):
        LearnedPolicy({}, None, policy.params)
    with pytest.raises(InputError, match=r"policy is .*: expected a LearnedPolicy"):
        save_policy(tmp_path, policy.params)
    with pytest.raises(InputError, match="has shape"):
        save_policy(tmp_path, LearnedPolicy(policy.description, Config(policy_hidden=(4, 4)), policy.params))
