"""Correlations of learned and true returns of the same episodes."""

from types import SimpleNamespace

import numpy as np
import pytest

from eairl_jax import Demonstrations, InputError
from eairl_jax.experiments.pipeline.agreement import agreement


@pytest.fixture
def reward():
    """Two seeds: one pays the first entry of the observation, the other its negative cube."""
    functions = (lambda obs, action: obs[..., 0] + 0 * action[..., 0], lambda obs, action: -(obs[..., 0] ** 3))
    return SimpleNamespace(description={"seeds": [5, 7]}, function=lambda lane: functions[lane])


def episodes(returns, length=2):
    """Episodes with these true returns; each step's observation is its reward."""
    reward = np.repeat(np.asarray(returns, np.float32) / length, length)
    obs = reward[:, None]
    lengths = np.full(len(returns), length, np.int32)
    return Demonstrations(obs=obs, action=obs, next_obs=obs, terminated=0 * reward, reward=reward, lengths=lengths)


def test_returns_of_all_files_are_correlated(reward):
    found = agreement(reward, [("a", episodes([1.0, 2.0])), ("b", episodes([4.0, 8.0], length=4))])
    np.testing.assert_allclose(found.true, [1, 2, 4, 8])
    np.testing.assert_allclose(found.learned, [[1, 2, 4, 8], [-2 / 8, -2.0, -4.0, -32.0]], rtol=1e-6)
    np.testing.assert_allclose(found.spearman, [1, -1])
    np.testing.assert_allclose(found.pearson, [1, np.corrcoef(found.learned[1], found.true)[0, 1]], rtol=1e-6)


@pytest.mark.parametrize(
    ("returns", "message"),
    {
        "two": ([1.0, 2.0], "2 episodes; expected at least 3"),
        "alike": ([1.0, 1.0, 1.0], "are 1 to 1: expected"),
    }.values(),
)
def test_what_cannot_be_correlated_is_refused(reward, returns, message):
    with pytest.raises(InputError, match=message):
        agreement(reward, [("file", episodes(returns))])


def test_a_reward_that_pays_alike_for_everything_is_refused():
    flat = SimpleNamespace(description={"seeds": [5]}, function=lambda _lane: lambda obs, _action: 0 * obs[..., 0])
    with pytest.raises(InputError, match="by the reward of seed 5 are 0 to 0"):
        agreement(flat, [("file", episodes([1.0, 2.0, 3.0]))])
