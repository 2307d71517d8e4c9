"""Behaviour cloning is maximum likelihood on the expert's actions, and nothing else."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from eairl_jax import Demonstrations, HParams, make_bc, scan

NETS = {"policy_hidden": (32, 32), "policy_activation": "tanh"}
GAIN = np.array([[0.3, -0.2], [0.1, 0.4], [-0.3, 0.2], [0.2, 0.1]], np.float32)
BIAS = np.array([0.2, -0.1], np.float32)


def made_of(obs, action):
    """Demonstrations of these observations and actions `[E, T, ...]`."""
    episodes, steps = obs.shape[:2]
    obs, action = (jnp.asarray(x).reshape(episodes * steps, -1) for x in (obs, action))
    rest = jnp.zeros(episodes * steps)
    return Demonstrations(obs, action, obs, rest, rest, jnp.full(episodes, steps))


@pytest.fixture
def clone(toy, tiny):
    """Clones demonstrations: `(algorithm, state before, state after, metrics [iterations])`."""

    def run(demos, iterations=40, hparams=None, **changes):
        hparams = hparams or HParams(policy_lr=1e-2, policy_lr_final_fraction=0.0)
        env = toy(ends_at=4, scale=changes.pop("scale", None))
        config = tiny(iterations=iterations, discriminator_updates=20, discriminator_batch=64, **(NETS | changes))
        algorithm = make_bc(env, config)
        before = jax.jit(algorithm.init)(jax.random.PRNGKey(0), hparams)
        after, metrics = jax.jit(functools.partial(scan, algorithm, length=iterations))(before, hparams, demos)
        return algorithm, before, after, jax.tree.map(np.asarray, metrics)

    return run


@pytest.fixture(scope="module")
def linear_expert():
    """Sixty steps of an expert whose mean action is linear in the state."""
    rng = np.random.default_rng(0)
    obs = rng.normal(size=(4, 15, 4)).astype(np.float32)
    return made_of(obs, obs @ GAIN + BIAS + 0.05 * rng.normal(size=(4, 15, 2)).astype(np.float32))


@pytest.mark.parametrize("optimizer", ["ppo", "trpo"])
def test_the_mean_approaches_a_linear_expert(clone, linear_expert, equal_trees, optimizer):
    algorithm, before, after, metrics = clone(linear_expert, optimizer=optimizer)
    rise = metrics["log_prob_expert"]
    assert rise[-5:].mean() > rise[:1].mean() + 2.0
    assert (np.diff(rise.reshape(4, 10).mean(axis=1)) > 0).all()
    assert metrics["entropy"][-1] < metrics["entropy"][0] - 2.0
    wanted = linear_expert.obs @ GAIN + BIAS
    errors = [np.abs(algorithm.act(state, linear_expert.obs, None) - wanted).mean() for state in (before, after)]
    assert errors[1] < 0.06 < 0.2 < errors[0]
    # Nothing else is learned, though it acts.
    was, now = (state.agent.policy.nets for state in (before, after))
    equal_trees(was.params["critic"], now.params["critic"])
    equal_trees(was.adam.mu["critic"], now.adam.mu["critic"])
    assert after.agent.iteration == 40
    assert np.isfinite(metrics["true_return"]).all()
    assert (metrics["policy_reward"] == 0).all()


def test_it_finds_the_maximum_of_the_likelihood(clone, scale):
    """Of two states that were seen often: the mean of the actions in each, and the std that is left over."""
    rng = np.random.default_rng(1)
    states = np.array([[1.0, 0.5, -0.5, 1.0], [-1.0, 1.5, 1.5, 2.0]], np.float32)
    which = np.arange(20) % 2
    action = np.array([[0.4, -0.3], [-0.2, 0.6]])[which] + rng.normal(size=(20, 2)) * (0.3, 0.1)
    demos = made_of(states[which].reshape(2, 10, 4), action.reshape(2, 10, 2).astype(np.float32))
    means = np.stack([action[which == i].mean(axis=0) for i in range(2)])
    std = np.sqrt(((action - means[which]) ** 2).mean(axis=0))
    algorithm, _, after, metrics = clone(demos, iterations=60, scale=tuple(map(tuple, scale)))
    np.testing.assert_allclose(algorithm.act(after, states, None), means, atol=0.02)
    samples = algorithm.act(after, jnp.tile(states[:1], (20_000, 1)), jax.random.PRNGKey(0))
    np.testing.assert_allclose(np.std(samples, axis=0), std, rtol=0.04)
    best = stats.norm(means[which], std).logpdf(action).sum(axis=1).mean()
    np.testing.assert_allclose(metrics["log_prob_expert"][-10:].mean(), best, atol=0.1)


def test_the_metric_is_the_likelihood_of_what_the_expert_did(clone, linear_expert, equal_trees):
    """At a rate of 0 nothing is learned; what is measured is the likelihood under the policy that is."""
    algorithm, before, after, metrics = clone(linear_expert, iterations=1, hparams=HParams(policy_lr=0.0))
    equal_trees(before.agent.policy.nets.params, after.agent.policy.nets.params)
    mean, std = algorithm.act(before, linear_expert.obs, None), np.exp(-0.5)
    every = stats.norm(mean, std).logpdf(linear_expert.action).sum(axis=-1)
    assert abs(metrics["log_prob_expert"][0] - every.mean()) < 4 * every.std() / np.sqrt(20 * 64)


def test_of_executed_actions_the_part_beyond_the_bound_has_no_effect(clone):
    obs = np.random.default_rng(0).normal(size=(3, 5, 4)).astype(np.float32)
    action = 0.5 + obs[..., :2]
    far = np.where(action > 1.0, 9.0, action)
    assert (far == 9.0).any()
    once, again = (clone(made_of(obs, x), iterations=2, actions="clipped") for x in (action, far))
    jax.tree.map(np.testing.assert_array_equal, once[2], again[2])
