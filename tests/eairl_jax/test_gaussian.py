"""The Gaussian against scipy and against integrals."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from eairl_jax.gaussian import Censored, Gaussian

MEAN = np.array([[0.3, -1.2], [2.0, 0.0], [-0.7, 0.9]])
LOG_STD = np.array([[0.1, -0.8], [-1.5, 0.4], [0.0, 0.3]])
LIMIT = 1.5
OTHER_MEAN, OTHER_LOG_STD = MEAN[::-1] * 0.5, LOG_STD[::-1] + 0.2


@pytest.fixture
def pi():
    return Gaussian(jnp.asarray(MEAN), jnp.asarray(LOG_STD))


def line(p):
    """Points to integrate over, where all but e^-72 of a Gaussian's mass lies."""
    return np.linspace(p.mean() - 12 * p.std(), p.mean() + 12 * p.std(), 20_001)


def test_log_prob_is_scipys_density(pi):
    action = np.array([[0.0, 0.0], [2.5, -3.0], [-9.0, 9.0]])
    expected = stats.norm.logpdf(action, MEAN, np.exp(LOG_STD)).sum(axis=-1)
    np.testing.assert_allclose(pi.log_prob(jnp.asarray(action)), expected, rtol=1e-5)


def test_entropy_is_the_integral_of_minus_p_log_p(pi):
    expected = np.zeros(3)
    for i, j in np.ndindex(3, 2):
        p = stats.norm(MEAN[i, j], np.exp(LOG_STD[i, j]))
        x = line(p)
        expected[i] += np.trapezoid(-p.pdf(x) * p.logpdf(x), x)
    np.testing.assert_allclose(pi.entropy(), expected, rtol=1e-5)


def test_kl_is_the_integral_of_p_log_p_over_q(pi):
    expected = np.zeros(3)
    for i, j in np.ndindex(3, 2):
        p = stats.norm(MEAN[i, j], np.exp(LOG_STD[i, j]))
        q = stats.norm(OTHER_MEAN[i, j], np.exp(OTHER_LOG_STD[i, j]))
        x = line(p)
        expected[i] += np.trapezoid(p.pdf(x) * (p.logpdf(x) - q.logpdf(x)), x)
    actual = pi.kl(Gaussian(jnp.asarray(OTHER_MEAN), jnp.asarray(OTHER_LOG_STD)))
    np.testing.assert_allclose(actual, expected, rtol=1e-4)
    np.testing.assert_allclose(pi.kl(pi), np.zeros(3), atol=1e-6)


def test_samples_have_the_mean_and_the_std(pi):
    samples = np.asarray(pi.sample(jnp.asarray(np.random.default_rng(0).normal(size=(20_000, 3, 2)))))
    np.testing.assert_allclose(samples.mean(axis=0), MEAN, atol=0.05)
    np.testing.assert_allclose(samples.std(axis=0), np.exp(LOG_STD), rtol=0.03)


@pytest.fixture
def censored():
    return Censored(jnp.asarray(MEAN), jnp.asarray(LOG_STD), limit=LIMIT)


def test_a_censored_gaussian_puts_the_tails_on_the_bounds(censored):
    assert np.abs(MEAN).max() > LIMIT  # a mean beyond its bound is one of the cases
    std = np.exp(LOG_STD)
    for action in (np.full((3, 2), -LIMIT), np.full((3, 2), LIMIT), np.array([[0.2, 1.5], [-1.5, 0.7], [1.5, -1.5]])):
        at_high, at_low = stats.norm.logsf(LIMIT, MEAN, std), stats.norm.logcdf(-LIMIT, MEAN, std)
        inside = stats.norm.logpdf(action, MEAN, std)
        expected = np.where(action == LIMIT, at_high, np.where(action == -LIMIT, at_low, inside)).sum(axis=-1)
        np.testing.assert_allclose(censored.log_prob(jnp.asarray(action)), expected, rtol=1e-4)


def test_its_entropy_is_minus_the_mean_log_prob_of_its_samples(censored):
    noise = jnp.asarray(np.random.default_rng(0).normal(size=(200_000, 3, 2)))
    samples = censored.sample(noise)
    assert float(jnp.abs(samples).max()) == LIMIT
    np.testing.assert_allclose(censored.entropy(), -censored.log_prob(samples).mean(axis=0), atol=0.02)


def test_far_beyond_its_bound_it_is_certain_and_its_gradient_finite():
    def log_prob(mean, action):
        return Censored(jnp.array([mean]), jnp.array([-0.5]), 1.0).log_prob(jnp.array([action]))

    assert float(log_prob(30.0, 1.0)) == 0.0
    slope = jax.grad(log_prob)
    assert float(slope(30.0, 1.0)) == 0.0
    assert -np.inf < float(slope(30.0, -1.0)) < 0.0
