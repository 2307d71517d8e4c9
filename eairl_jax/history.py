"""The policy's samples of past iterations, which the discriminator keeps seeing (Appendix D.2)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

from eairl_jax.config import Config
from eairl_jax.types import Key, Transition


@struct.dataclass
class History:
    """A ring of the last iterations' transitions.

    Attributes:
      transitions: every leaf `[slots, T, N, ...]`.
      added: `[]` iterations added since the beginning; slot `added % slots` is the next to be overwritten.
    """

    transitions: Transition
    added: jax.Array


def empty(obs_size: int, action_size: int, config: Config) -> History:
    """A ring for the current iteration and the `history_length` before it."""
    leading = (config.history_length + 1, config.rollout_length, config.num_envs)
    tails = Transition((obs_size,), (action_size,), (), (obs_size,), (), (), ())
    return History(Transition(*(jnp.zeros(leading + tail) for tail in tails)), jnp.zeros((), jnp.int32))


def add(history: History, transition: Transition) -> History:
    """Puts one iteration's transitions `[T, N, ...]` in the place of the oldest."""
    slots = history.transitions.reward.shape[0]
    slot = history.added % slots
    kept = jax.tree.map(lambda ring, new: ring.at[slot].set(new), history.transitions, transition)
    return History(kept, history.added + 1)


def draw(key: Key, history: History, updates: int, batch: int) -> Transition:
    """Draws `[updates, batch, ...]` transitions, evenly over all that the ring holds."""
    slots, length, num_envs = history.transitions.reward.shape
    filled = jnp.minimum(history.added, slots) * length * num_envs
    index = jax.random.randint(key, (updates, batch), 0, filled)
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[3:])[index], history.transitions)
