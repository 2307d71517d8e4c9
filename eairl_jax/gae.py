"""Generalised advantage estimation (Schulman et al. 2016) that distinguishes termination from truncation."""

from __future__ import annotations

import jax


def gae(
    reward: jax.Array,
    value: jax.Array,
    next_value: jax.Array,
    terminated: jax.Array,
    truncated: jax.Array,
    gamma: float | jax.Array,
    lambda_: float | jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Advantages and value targets; all arrays are `[T, N]`.

    `delta_t = r_t + gamma (1 - terminated_t) V(s'_t) - V(s_t)` and
    `A_t = delta_t + gamma lambda (1 - terminated_t) (1 - truncated_t) A_{t+1}`.
    After a terminated step no reward follows. After a truncated step the reward that V(s') predicts follows, but the
    next step of the batch belongs to another episode.

    Args:
      reward: r.
      value: V(s).
      next_value: V(s') of the true next observation, not of the state after a reset.
      terminated: 1 where the task ended the episode.
      truncated: 1 where the time limit ended the episode.
      gamma: discount factor.
      lambda_: lambda.

    Returns:
      `(advantage, advantage + value)`.
    """
    delta = reward + gamma * (1.0 - terminated) * next_value - value
    carry_on = gamma * lambda_ * (1.0 - terminated) * (1.0 - truncated)

    def backward(advantage, step):
        delta_t, carry_on_t = step
        advantage = delta_t + carry_on_t * advantage
        return advantage, advantage

    _, advantage = jax.lax.scan(backward, delta[-1] * 0.0, (delta, carry_on), reverse=True)
    return advantage, advantage + value
