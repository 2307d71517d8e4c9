"""Advantages against sums written out by hand."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eairl_jax.gae import gae

compiled = jax.jit(gae)
LENGTH, ENVS = 7, 3


def batch(seed):
    """Random rewards and values; each step ends an episode, one way or the other, with probability 0.4."""
    rng = np.random.default_rng(seed)
    reward, value, next_value = rng.normal(size=(3, LENGTH, ENVS)).astype(np.float32)
    kind = rng.choice(3, p=(0.6, 0.2, 0.2), size=(LENGTH, ENVS))
    return reward, value, next_value, (kind == 1).astype(np.float32), (kind == 2).astype(np.float32)


def written_out(reward, value, next_value, terminated, truncated, gamma, lambda_):
    """A_t = sum over k of (gamma lambda)^k delta_{t+k}, up to the end of t's episode or of the batch."""
    advantage = np.zeros((LENGTH, ENVS))
    for t, n in np.ndindex(LENGTH, ENVS):
        for k in range(LENGTH - t):
            i = t + k
            future = 0.0 if terminated[i, n] else gamma * next_value[i, n]
            advantage[t, n] += (gamma * lambda_) ** k * (reward[i, n] + future - value[i, n])
            if terminated[i, n] or truncated[i, n]:
                break
    return advantage


unit = st.floats(0.0, 1.0, width=32)


@settings(max_examples=40)
@given(seed=st.integers(0, 2**31), gamma=unit, lambda_=unit)
def test_equals_the_sum_of_discounted_deltas(seed, gamma, lambda_):
    data = batch(seed)
    advantage, target = compiled(*data, gamma, lambda_)
    expected = written_out(*data, gamma, lambda_)
    np.testing.assert_allclose(advantage, expected, atol=1e-4)
    np.testing.assert_allclose(target, expected + data[1], atol=1e-4)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**31), gamma=unit)
def test_lambda_1_is_the_return_minus_the_value_and_lambda_0_one_step(seed, gamma):
    reward, value, next_value, terminated, truncated = data = batch(seed)
    total, value_to_go = np.zeros(ENVS), np.zeros((LENGTH, ENVS))
    for t in reversed(range(LENGTH)):
        # What follows: nothing after the end, V(s') where the episode or the batch is cut, else the return to go.
        cut = truncated[t] + (1 - truncated[t]) * float(t == LENGTH - 1)
        follows = (1 - terminated[t]) * np.where(cut > 0, next_value[t], total)
        value_to_go[t] = total = reward[t] + gamma * follows
    # The sum of deltas telescopes only where V(s') is the next row's V(s).
    chained = np.where((terminated + truncated)[:-1] > 0, next_value[:-1], value[1:])
    next_value = np.concatenate([chained, next_value[-1:]])
    data = (reward, value, next_value, terminated, truncated)
    np.testing.assert_allclose(compiled(*data, gamma, 1.0)[1], value_to_go, atol=1e-4)
    one_step = reward + gamma * (1 - terminated) * next_value
    np.testing.assert_allclose(compiled(*data, gamma, 0.0)[1], one_step, atol=1e-5)


@pytest.mark.parametrize(
    ("end", "expected"),
    [
        # deltas: 1 + 0.5*4 - 2 = 1; then of the middle step below; then 3 + 0.5*2 - 1 = 3; gamma lambda = 0.25
        ("none", [1 + 0.25 * (2 + 0.25 * 3), 2 + 0.25 * 3, 3]),
        ("truncated", [1 + 0.25 * 2, 2, 3]),
        ("terminated", [1 + 0.25 * -2, -2, 3]),
    ],
)
def test_by_hand(end, expected):
    reward, value, next_value = [1.0, 2.0, 3.0], [2.0, 4.0, 1.0], [4.0, 8.0, 2.0]
    ends = ([0.0, float(end == name), 0.0] for name in ("terminated", "truncated"))
    columns = (np.array(x)[:, None] for x in (reward, value, next_value, *ends))
    np.testing.assert_allclose(gae(*columns, 0.5, 0.5)[0][:, 0], expected, rtol=1e-6)
