"""Rewards that are fitted to noise: what is played, what is compared, and what the fitted rewards say."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from eairl_jax import Config, noise_ranking
from eairl_jax.irl import reward_function
from eairl_jax.noise_ranking import RANKINGS, Episodes, Pieces, Sigmoid
from eairl_jax.normalize import ObsStats

NOISE = noise_ranking.noise_of_episodes()
STEPS = 40
KEY = jax.random.PRNGKey(0)
CONFIG = Config(method="airl_s", reward_form="s", reward_obs="raw", hidden=(8,))
AS_IS = ObsStats(jnp.zeros(2), jnp.ones(2), jnp.zeros(()))


@pytest.fixture(scope="module")
def noisy_walk():
    """Episodes whose first entry falls with noise, as a good behaviour would; the second is chance. Some end early."""
    goodness = (1.0 - NOISE)[:, None] + 0.3 * jax.random.normal(KEY, (len(NOISE), STEPS))
    chance = jax.random.normal(jax.random.PRNGKey(1), goodness.shape)
    lengths = jnp.where(jnp.arange(len(NOISE)) % 2, STEPS, 7)
    counts = (jnp.arange(STEPS) < lengths[:, None]).astype(jnp.float32)
    return Episodes(
        jnp.stack([goodness, chance], axis=-1), jnp.zeros((*counts.shape, 1)), counts, (counts * goodness).sum(axis=1)
    )


def test_episodes_have_the_noise_of_the_papers():
    assert NOISE.shape == (noise_ranking.LEVELS * noise_ranking.EPISODES,)
    np.testing.assert_allclose(np.unique(NOISE), np.arange(20) / 20)
    assert (np.diff(NOISE) >= 0).all()


def test_the_share_of_random_actions_is_the_noise(toy):
    """The toy writes down what was executed; its policy always acts 0.25."""
    env = toy(action_limit=0.5)
    config = dataclasses.replace(CONFIG, actions="clipped")
    episodes = jax.jit(lambda key: noise_ranking.play(key, env, lambda obs, _: 0 * obs[:, :2] + 0.25, 200, config))(KEY)
    is_random = np.asarray(episodes.action != 0.25).any(axis=-1)
    np.testing.assert_allclose(is_random.mean(axis=1), NOISE, atol=0.12)
    assert np.abs(np.asarray(episodes.action)).max() <= 0.5
    assert not is_random[NOISE == 0].any()


def test_steps_after_the_end_of_an_episode_do_not_count(toy):
    episodes = noise_ranking.play(KEY, toy(ends_at=3), lambda obs, _: obs[:, :2], 5, CONFIG)
    np.testing.assert_array_equal(episodes.counts, np.broadcast_to([1, 1, 1, 0, 0], episodes.counts.shape))
    rating = noise_ranking.ratings(lambda obs, _action: obs[..., 0], episodes)  # steps since the reset: 0, 1, 2
    np.testing.assert_allclose(rating, 1.0)


def test_the_loss_of_d_rex_is_that_of_bradley_and_terry():
    reward = jnp.array([[1.0, 2.0], [0.5, 0.5]])  # returns 3 and 1
    pieces = Pieces(reward, jnp.ones((2, 2)), jnp.zeros(2))
    np.testing.assert_allclose(
        noise_ranking.ranking_loss(pieces), -np.log(np.exp(3) / (np.exp(3) + np.exp(1))), rtol=1e-6
    )


def test_the_loss_of_ssrr_is_of_the_mean_reward_of_a_piece():
    reward, counts = jnp.array([[1.0, 3.0, 0.0], [6.0, 0.0, 0.0]]), jnp.array([[1.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    pieces = Pieces(reward, counts, jnp.array([1.0, 4.0]))
    np.testing.assert_allclose(noise_ranking.regression_loss(pieces), ((2 - 1) ** 2 + (6 - 4) ** 2) / 2)


@pytest.mark.parametrize("name", RANKINGS)
def test_pieces_lie_within_their_episodes_and_differ_enough(name, noisy_walk):
    ranking = RANKINGS[name]
    row, step, counts = jax.vmap(noise_ranking._draws(ranking, noisy_walk))(jax.random.split(KEY, 50))
    played = np.asarray(noisy_walk.counts).sum(axis=1)[row]
    length = np.asarray(counts).sum(axis=-1)
    assert (np.where(counts > 0, step, 0).max(axis=-1) < played).all()
    assert length.min() == min(round(ranking.shortest * STEPS), 7)
    assert length.max() == round(ranking.longest * STEPS)
    inside = np.asarray(counts)[..., 1:] > 0
    assert (np.diff(step, axis=-1)[inside] == 1).all()
    assert {0, 20} <= set(np.unique(np.asarray(step)[..., 0]))  # they begin anywhere
    if ranking.margin:
        better, worse = np.split(NOISE[row], 2, axis=1)
        assert (worse - better).min() == pytest.approx(ranking.margin)


def test_a_sigmoid_is_found_again():
    true = Sigmoid(middle=0.4, steepness=12.0, fall=300.0, low=-50.0)
    rating = true(NOISE) + np.random.default_rng(0).normal(0, 5, NOISE.shape)
    np.testing.assert_allclose(noise_ranking.fit_sigmoid(NOISE, rating)(NOISE), true(NOISE), atol=6)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
def test_targets_have_the_same_units_whatever_those_of_the_first_reward(scale):
    rating = scale * (Sigmoid(0.5, 10.0, 1.0, -3.0)(NOISE) + np.random.default_rng(0).normal(0, 0.05, NOISE.shape))
    target = noise_ranking.targets(RANKINGS["ssrr"], rating)
    np.testing.assert_allclose([target.mean(), target.std()], [0, 1], atol=1e-5)
    assert (np.diff(target) <= 0).all()
    assert target[0] > 0.5 > -0.5 > target[-1]


def test_ratings_that_do_not_fall_with_noise_have_nothing_to_follow():
    for rating in (np.ones_like(NOISE), NOISE):
        np.testing.assert_array_equal(noise_ranking.targets(RANKINGS["ssrr"], rating), 0.0)
    assert np.isnan(noise_ranking.targets(RANKINGS["ssrr"], np.full_like(NOISE, np.nan))).all()
    np.testing.assert_array_equal(noise_ranking.targets(RANKINGS["d_rex"], NOISE), 0.0)


@pytest.mark.parametrize("name", RANKINGS)
def test_a_fitted_reward_pays_for_what_falls_with_noise_and_for_nothing_else(name, noisy_walk):
    ranking = dataclasses.replace(RANKINGS[name], updates=300, lr=1e-2)
    target = noise_ranking.targets(ranking, 1.0 - NOISE)
    fit = jax.jit(lambda key: noise_ranking.fit(key, noisy_walk, jnp.asarray(target), AS_IS, ranking, CONFIG))
    params, _ = fit(KEY)
    reward = reward_function(CONFIG)
    rating = noise_ranking.ratings(lambda obs, action: reward(params, obs, action), noisy_walk)
    assert stats.spearmanr(rating, -NOISE).statistic > 0.95
    slope = jax.vmap(jax.grad(lambda obs: reward(params, obs, jnp.zeros(1))))(
        jnp.array([[0.2, 0.0], [0.5, 0.5], [0.8, 0.2]])
    )
    assert (slope[:, 0] > 5 * np.abs(slope[:, 1])).all()
