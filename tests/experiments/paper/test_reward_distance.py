"""Measures of how close two rewards are, on rewards whose distance is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import Config, envs, random_policy
from eairl_jax.experiments.paper.reward_distance import EPISODES, GAMMA, Walk, canonical, epic, rank_correlation, walk

x = np.random.default_rng(0).normal(size=500)


@pytest.mark.parametrize(("learned", "distance"), [(3 * x + 7, 0.0), (-x, 1.0), (np.roll(x, 250), np.sqrt(0.5))])
def test_epic_knows_scale_and_sign(learned, distance):
    assert epic(learned, x) == pytest.approx(distance, abs=0.03)


def test_ranks_see_through_any_increasing_function():
    assert rank_correlation(np.exp(x), x) == pytest.approx(1.0)
    assert rank_correlation(-np.exp(x), x) == pytest.approx(-1.0)


@pytest.mark.filterwarnings("ignore::RuntimeWarning", "ignore::scipy.stats.ConstantInputWarning")
def test_a_constant_reward_has_no_measure():
    assert epic(np.ones(500), x) is None
    assert rank_correlation(np.ones(500), x) is None


def test_the_canonical_reward_by_hand():
    # R(s,a) = s + a: R + gamma (s' + mean A) - (s + mean A)
    before, action, after = (jnp.array(values) for values in ([1.0, 2.0], [[0.5], [-0.5]], [3.0, 5.0]))
    tried = jnp.array([[0.0], [0.4]])
    found = canonical(lambda s, a: s + a[0], Walk(before, action, after), tried)
    by_hand = before + action[:, 0] + GAMMA * (after + 0.2) - (before + 0.2)
    np.testing.assert_allclose(found, by_hand, rtol=1e-6)


def test_a_walk_is_of_the_environment():
    env = envs.make("pendulum")
    x = jax.jit(lambda key: walk(key, env, random_policy(env), Config()))(jax.random.PRNGKey(0))
    assert x.action.shape == (EPISODES * env.episode_length, 1)
    # The recorded states are whole: a step from one of them is the step that was taken.
    one = jax.tree.map(lambda leaf: leaf[37], x)
    again = env.step(one.before, one.action)
    np.testing.assert_allclose(again.obs, one.after.obs, rtol=1e-5)
    np.testing.assert_allclose(again.reward, one.after.reward, rtol=1e-5)
    np.testing.assert_allclose(x.before.obs[EPISODES], x.after.obs[0], rtol=1e-6)
