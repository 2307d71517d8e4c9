"""Rollouts in an environment that writes down what happened to it."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from eairl_jax import rollout
from eairl_jax.gaussian import Gaussian

NUM_ENVS, LENGTH, LIMIT = 8, 11, 4


def policy(obs):
    """Wide, so that clipping matters, and different in every state."""
    return Gaussian(0.3 * obs[:, :2], jnp.full((obs.shape[0], 2), 0.5))


@pytest.fixture
def play(toy):
    """`(state before, state after, transitions)` as NumPy arrays."""

    @functools.cache
    def run(ends_at=None, action_limit=None):
        env = toy(ends_at, action_limit)
        before = rollout.reset(jax.random.PRNGKey(1), env, NUM_ENVS, LENGTH, LIMIT)
        run = jax.jit(lambda state: rollout.rollout(jax.random.PRNGKey(0), env, policy, state, LENGTH, LIMIT))
        after, transitions = run(before)
        return jax.tree.map(np.asarray, (before, after, transitions))

    return run


def test_reset_starts_every_environment_elsewhere(play):
    before, _, _ = play()
    assert before.env.obs.shape == (NUM_ENVS, 4)
    assert len(set(before.env.obs[:, 3])) == NUM_ENVS
    assert np.isneginf(before.mean_return)
    np.testing.assert_array_equal(before.steps, np.zeros(NUM_ENVS))


@pytest.mark.parametrize("ends_at", [None, 3, 4, 7])
def test_next_observation_is_the_true_one_and_ends_are_what_they_are(play, ends_at):
    before, after, x = play(ends_at)
    episode = min(LIMIT, ends_at or LIMIT)
    step = np.arange(LENGTH) % episode
    end = step == episode - 1
    for n in range(NUM_ENVS):
        np.testing.assert_array_equal(x.obs[:, n, 0], step)
        # At an end too, s' continues the episode that ends, and does not begin the next one.
        np.testing.assert_array_equal(x.next_obs[:, n, 0], step + 1)
        np.testing.assert_array_equal(x.next_obs[:, n, 3], x.obs[:, n, 3])
        # The last step of the time limit is terminated, not truncated, if the task ends there of itself.
        terminates = ends_at is not None and ends_at <= LIMIT
        np.testing.assert_array_equal(x.terminated[:, n], end * terminates)
        np.testing.assert_array_equal(x.truncated[:, n], end * (not terminates))
        # Within an episode s' is the next row's s.
        np.testing.assert_array_equal(x.obs[1:, n][~end[:-1]], x.next_obs[:-1, n][~end[:-1]])
    # The episodes after the first start in states that were drawn anew, and not all in one.
    first, later = set(before.env.obs[:, 3]), set(x.obs[episode:, :, 3].ravel())
    assert not first & later
    assert len(later) > NUM_ENVS // 2
    np.testing.assert_array_equal(after.steps, LENGTH % episode)
    np.testing.assert_array_equal(after.env.obs[:, 0], LENGTH % episode)


@pytest.mark.parametrize("ends_at", [None, 3])
def test_returns_are_sums_over_episodes(play, ends_at):
    _, after, x = play(ends_at)
    episode = min(LIMIT, ends_at or LIMIT)
    whole = LENGTH // episode * episode
    executed = np.clip(x.action, -1, 1)
    np.testing.assert_allclose(x.reward, -((executed - 0.5) ** 2).sum(axis=-1), rtol=1e-5)
    returns = x.reward[:whole].reshape(-1, episode, NUM_ENVS).sum(axis=1)
    np.testing.assert_allclose(after.mean_return, returns.mean(), rtol=1e-5)
    np.testing.assert_allclose(after.episode_return, x.reward[whole:].sum(axis=0), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("limit", [None, 0.25])
def test_log_prob_is_of_the_unclipped_action_and_the_executed_action_is_clipped(play, limit):
    _, _, x = play(action_limit=limit)
    density = stats.norm.logpdf(x.action, 0.3 * x.obs[..., :2], np.exp(0.5)).sum(axis=-1)
    np.testing.assert_allclose(x.log_prob, density, rtol=1e-4)
    assert np.abs(x.action).max() > 1.5
    np.testing.assert_allclose(x.next_obs[..., 1:3], np.clip(x.action, -(limit or 1.0), limit or 1.0), rtol=1e-6)


def test_without_an_end_the_episodes_go_on_into_the_next_rollout(toy):
    env = toy()
    state = rollout.reset(jax.random.PRNGKey(1), env, NUM_ENVS, 5, 5).replace(mean_return=jnp.asarray(-7.0))
    run = jax.jit(lambda key, state: rollout.rollout(key, env, policy, state, 2, 5))
    state, first = run(jax.random.PRNGKey(2), state)
    assert state.mean_return == -7.0
    state, second = run(jax.random.PRNGKey(3), state)
    np.testing.assert_array_equal(second.obs[0], first.next_obs[-1])
    np.testing.assert_array_equal(state.steps, np.full(NUM_ENVS, 4))
    np.testing.assert_allclose(state.episode_return, first.reward.sum(axis=0) + second.reward.sum(axis=0), rtol=1e-5)


def test_short_rollouts_see_every_part_of_an_episode(toy):
    env, length, episode = toy(), 2, 6
    state = rollout.reset(jax.random.PRNGKey(1), env, NUM_ENVS, length, episode)
    np.testing.assert_array_equal(state.steps, [0, 2, 4, 0, 2, 4, 0, 2])
    run = jax.jit(lambda key, state: rollout.rollout(key, env, policy, state, length, episode))
    whole = np.zeros(NUM_ENVS)
    for i in range(2 * episode // length):
        started = np.asarray(state.steps) == 0
        state, x = run(jax.random.PRNGKey(i), state)
        # Every rollout ends some episodes, but the first ones of environments that began late have no return.
        assert set(np.asarray(state.steps)) == {0, 2, 4}
        whole = np.where(started, 0.0, whole) + x.reward.sum(axis=0)
        ended, late = np.asarray(state.steps) == 0, i < 2
        np.testing.assert_array_equal(np.isneginf(state.mean_return), late)
        if not late:
            np.testing.assert_allclose(state.mean_return, whole[ended].mean(), rtol=1e-5)
    assert np.isfinite(state.episode_return).all()
