"""The normaliser stands still within an iteration and moves on between two, if it is a running one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import HParams, agent
from eairl_jax.ppo import ppo


@pytest.mark.parametrize("mode", ["running", "task", "none"])
def test_an_iteration_ends_with_the_statistics_of_what_was_seen(toy, tiny, mode):
    config = tiny(normalize_obs=mode)
    env, optimizer = toy(), ppo(4, 2, config)
    start = agent.init(jax.random.PRNGKey(0), env, optimizer, HParams(), config)
    acting, raw = agent.collect(jax.random.PRNGKey(1), start, env, optimizer, config)
    jax.tree.map(np.testing.assert_array_equal, acting.obs_stats, start.obs_stats)
    assert raw.obs.shape == (6, 4, 4)
    after = agent.end_iteration(acting, acting.policy, raw, config)
    assert after.iteration == 1
    seen = np.asarray(raw.obs).reshape(-1, 4)
    mean, var = (seen.mean(axis=0), seen.var(axis=0)) if mode == "running" else (np.zeros(4), np.ones(4))
    np.testing.assert_allclose(after.obs_stats.mean, mean, atol=1e-5)
    np.testing.assert_allclose(after.obs_stats.var, var, atol=1e-4)


def test_a_fresh_policy_has_the_std_of_the_first_iteration(toy, tiny):
    config, hparams = tiny(policy_reset_every=2), HParams(std_initial_fraction=3.0)
    optimizer = ppo(4, 2, config)
    start = agent.init(jax.random.PRNGKey(0), toy(), optimizer, hparams, config)
    later = start.replace(iteration=jnp.asarray(2), policy=start.policy.replace(log_std_offset=jnp.zeros(())))
    for fresh in (start, agent.reset_policy_if_due(jax.random.PRNGKey(1), later, optimizer, hparams, config)):
        log_std = agent.distribution(fresh, jnp.zeros(4), optimizer).log_std
        np.testing.assert_allclose(log_std, config.log_std_init + np.log(3.0), rtol=1e-5)


def test_both_ends_of_a_transition_stand_behind_one_normaliser_and_the_policy_too(toy, tiny, transitions):
    config = tiny()
    optimizer = ppo(4, 2, config)
    acting = agent.init(jax.random.PRNGKey(0), toy(), optimizer, HParams(), config)
    stats = acting.obs_stats.replace(mean=jnp.arange(4.0), var=jnp.full(4, 4.0))
    acting, x = acting.replace(obs_stats=stats), jax.tree.map(jnp.asarray, transitions())
    normalized = agent.normalize_obs(acting, x)
    np.testing.assert_allclose(normalized.obs, (x.obs - np.arange(4)) / 2, atol=1e-5)
    np.testing.assert_allclose(normalized.next_obs, (x.next_obs - np.arange(4)) / 2, atol=1e-5)
    for name in ("action", "log_prob", "reward", "terminated", "truncated"):
        np.testing.assert_array_equal(getattr(normalized, name), getattr(x, name))
    pi, direct = agent.distribution(acting, x.obs, optimizer), optimizer.distribution(acting.policy, normalized.obs)
    np.testing.assert_allclose(pi.mean, direct.mean, atol=1e-6)
    assert np.abs(pi.mean - optimizer.distribution(acting.policy, x.obs).mean).max() > 1e-4
