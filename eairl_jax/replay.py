"""The policy's samples of past iterations, which the discriminator keeps seeing (Appendix D.2)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

from eairl_jax import train_state
from eairl_jax.config import Config
from eairl_jax.types import Key, Transition

# Paths that the pool of the authors' release holds.
POOL_PATHS = 100


@struct.dataclass
class Replay:
    """Past iterations' transitions: a ring of the last ones, or ("all") a sample of every one.

    Attributes:
      transitions: every leaf `[slots, T, N, ...]`.
      added: `[]` iterations added since the beginning.
    """

    transitions: Transition
    added: jax.Array


def empty(obs_size: int, action_size: int, config: Config) -> Replay:
    """A ring for the current iteration and the `history_length` before it, or for the pool that `paths` names."""
    slots, envs = config.history_length + 1, config.num_envs
    if config.history == "paths":
        envs = max(1, config.num_envs // 2)  # half of each batch
        slots = -(-POOL_PATHS // envs)
    leading = (slots, config.rollout_length, envs)
    tails = Transition((obs_size,), (action_size,), (), (obs_size,), (), (), ())
    return Replay(Transition(*(jnp.zeros(leading + tail) for tail in tails)), jnp.zeros((), jnp.int32))


def add(key: Key, replay: Replay, transition: Transition, config: Config) -> Replay:
    """Puts one iteration's transitions `[T, N, ...]` (as many environments as the ring has) in the oldest's place.

    In a sample of all, in that of any, or nowhere, so that each iteration is as likely as any other to be there
    (reservoir sampling, Vitter 1985).
    """
    slots, _, envs = replay.transitions.reward.shape
    slot = replay.added % slots
    if config.history == "all":
        drawn = jax.random.randint(key, (), 0, replay.added + 1)
        slot = jnp.where(replay.added < slots, replay.added, drawn)
    kept = jax.tree.map(lambda ring, new: ring.at[slot].set(new[:, :envs], mode="drop"), replay.transitions, transition)
    return Replay(kept, replay.added + 1)


def draw(key: Key, replay: Replay, current: Transition, updates: int, batch: int, length: int, config: Config):
    """Draws `[updates, batch, length, ...]`: segments of `length` steps of the policy, old and new.

    From the ring evenly, the current iteration being a part of it; or, with `config.history` "paths" or "all", half
    from the ring and half from the current iteration, `[T, N, ...]`.
    """
    slots, steps, num_envs = replay.transitions.reward.shape
    filled = jnp.minimum(replay.added, slots) * (steps // length) * num_envs
    index = jax.random.randint(key, (updates, batch), 0, filled)
    drawn = train_state.rows(replay.transitions, 3, train_state.segment(index, length, num_envs))
    if config.history == "iterations":
        return drawn
    now = jax.random.randint(jax.random.fold_in(key, 1), (updates, batch), 0, steps // length * config.num_envs)
    new = train_state.rows(current, 2, train_state.segment(now, length, config.num_envs))
    half = batch // 2
    return jax.tree.map(lambda old, new: jnp.concatenate([old[:, :half], new[:, half:]], axis=1), drawn, new)
