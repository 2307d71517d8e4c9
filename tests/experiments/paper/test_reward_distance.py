"""Measures of how close two rewards are, on rewards whose distance is known."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import Config, Demonstrations, random_policy
from eairl_jax.experiments.paper import reward_distance
from eairl_jax.experiments.paper.reward_distance import (
    EPISODES,
    GAMMA,
    Transitions,
    canonical,
    epic,
    measures,
    of_transfer,
    rank_correlation,
    walk,
)

x = np.random.default_rng(0).normal(size=500)


@pytest.mark.parametrize(("learned", "distance"), [(3 * x + 7, 0.0), (-x, 1.0), (np.roll(x, 250), np.sqrt(0.5))])
def test_epic_ignores_the_scale_and_not_the_sign(learned, distance):
    assert epic(learned, x) == pytest.approx(distance, abs=0.03)


def test_ranks_ignore_every_increasing_function():
    assert rank_correlation(np.exp(x), x) == pytest.approx(1.0)
    assert rank_correlation(-np.exp(x), x) == pytest.approx(-1.0)


@pytest.mark.filterwarnings("ignore::RuntimeWarning", "ignore::scipy.stats.ConstantInputWarning")
def test_a_constant_reward_has_no_measure():
    assert epic(np.ones(500), x) is None
    assert rank_correlation(np.ones(500), x) is None


def test_the_canonical_reward_by_hand():
    # R(s,a) = s + a: R + gamma (s' + mean A) - (s + mean A)
    before, action, after = (jnp.array(values) for values in ([1.0, 2.0], [[0.5], [-0.5]], [3.0, 5.0]))
    actions = jnp.array([[0.0], [0.4]])
    shaped = canonical(lambda s, a: s + a[0], Transitions(before, action, after), actions)
    by_hand = before + action[:, 0] + GAMMA * (after + 0.2) - (before + 0.2)
    np.testing.assert_allclose(shaped, by_hand, rtol=1e-6)


@pytest.fixture
def task(toy):
    """An environment that compiles fast; its true reward is `-|action - 0.5|^2`."""
    env = toy(action_limit=1.0)
    env.episode_length = 30
    return env


def test_a_walk_consists_of_steps_of_the_environment(task):
    transitions = jax.jit(lambda key: walk(key, task, random_policy(task), Config()))(jax.random.PRNGKey(0))
    assert transitions.action.shape == (EPISODES * task.episode_length, 2)
    # The recorded states are whole: a step from one of them leads to the next one.
    one = jax.tree.map(lambda leaf: leaf[37], transitions)
    again = task.step(one.before, one.action)
    np.testing.assert_allclose(again.obs, one.after.obs, rtol=1e-5)
    np.testing.assert_allclose(again.reward, one.after.reward, rtol=1e-5)
    np.testing.assert_allclose(transitions.before.obs[EPISODES], transitions.after.obs[0], rtol=1e-6)


def test_the_true_reward_is_at_no_distance_and_its_opposite_is_opposed(task, monkeypatch):
    def scaled_true_reward(scale, obs, action):
        return -scale * jnp.sum((action - 0.5) ** 2, axis=-1)

    monkeypatch.setattr(reward_distance, "reward_function", lambda config: scaled_true_reward)
    reward = SimpleNamespace(config=Config(), params=np.array([2.0, -2.0]), description={"seeds": [0, 1]})
    at_random = random_policy(task)
    algorithm = SimpleNamespace(act=lambda state, obs, key: at_random(obs, key))
    agents = SimpleNamespace(algorithm=algorithm, state=np.zeros(2))
    action = jax.random.uniform(jax.random.PRNGKey(1), (90, 2))
    obs, true = jnp.zeros((90, 4)), scaled_true_reward(1.0, None, action)
    expert = Demonstrations(obs, action, obs, true, jnp.zeros(90), jnp.full(3, 30))
    measured = measures(reward, agents, task, expert)
    np.testing.assert_allclose(measured["epic"], [0, 1], atol=0.02)
    for transitions in ("expert", "policy", "random"):
        np.testing.assert_allclose(measured[f"rank correlation, {transitions}"], [1, -1], atol=0.01)
        good, bad = measured[f"worth, {transitions}"]
        assert good < 0 < bad
    np.testing.assert_allclose(measured["worth, expert"], [2 * true.mean(), -2 * true.mean()], rtol=1e-5)


def test_the_measures_of_a_transfer_are_kept(tmp_path):
    (tmp_path / "closeness.json").write_text('{"source": {"epic": [0.5]}}')
    assert of_transfer(tmp_path / "learned", tmp_path) == {"source": {"epic": [0.5]}}
