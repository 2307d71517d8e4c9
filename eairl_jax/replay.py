"""The policy's samples of past iterations, which the discriminator continues to see (Appendix D.2)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

from eairl_jax import horizon, train_state
from eairl_jax.config import Config
from eairl_jax.types import Key, Transition

# Paths in the pool of the authors' release.
POOL_PATHS = 100


@struct.dataclass
class Replay:
    """Transitions of past iterations: a ring of the last iterations, or (history "all") a sample of all iterations.

    Attributes:
      transitions: every leaf `[slots, T, N, ...]`, one slot for each stored iteration.
      added: `[]` number of iterations that have been added so far.
    """

    transitions: Transition
    added: jax.Array


def empty(obs_size: int, action_size: int, config: Config) -> Replay:
    """A replay without samples.

    The number of slots is `history_length` + 1; with history "paths" it is the number that holds the release's pool.
    """
    slots, envs = config.history_length + 1, config.num_envs
    if config.history == "paths":
        envs = max(1, config.num_envs // 2)  # half of each batch
        slots = -(-POOL_PATHS // envs)
    leading = (slots, config.rollout_length, envs)
    tails = Transition((obs_size,), (action_size,), (), (obs_size,), (), (), ())
    return Replay(Transition(*(jnp.zeros((*leading, *tail)) for tail in tails)), jnp.zeros((), jnp.int32))


def add(key: Key, replay: Replay, transition: Transition, config: Config) -> Replay:
    """Adds the transitions `[T, N, ...]` of one iteration; of N environments, as many as a slot has.

    They replace the oldest. With history "all" they replace a random iteration, or are not stored, so that every
    iteration is stored with equal probability (reservoir sampling, Vitter 1985).
    """
    slots, _, envs = replay.transitions.reward.shape
    slot = replay.added % slots
    if config.history == "all":
        drawn = jax.random.randint(key, (), 0, replay.added + 1)
        slot = jnp.where(replay.added < slots, replay.added, drawn)
    stored = jax.tree.map(
        lambda ring, new: ring.at[slot].set(new[:, :envs], mode="drop"), replay.transitions, transition
    )
    return Replay(stored, replay.added + 1)


def draw_segments(
    key: Key,
    replay: Replay,
    current: Transition,
    shape: tuple[int, int, int],
    config: Config,
    stay: jax.Array | int = 1,
) -> Transition:
    """Draws segments of consecutive steps of the policy.

    With history "iterations" all segments come evenly from the replay, which contains the current iteration. With
    "paths" or "all" one half comes from the replay and the other half from the current iteration.

    Args:
      current: `[T, N, ...]` the transitions of the current iteration.
      shape: `(updates, batch, length)`; `length` is the number of steps in a segment.
      stay: how much more often an absorbing step is drawn than another one (`horizon.stay`).

    Returns:
      `[updates, batch, length, ...]`.
    """
    updates, batch, length = shape
    slots, steps, num_envs = replay.transitions.reward.shape
    filled = jnp.minimum(replay.added, slots) * (steps // length) * num_envs
    index = _draw(key, (updates, batch), filled, horizon.alive(replay.transitions.obs, config), stay)
    past = train_state.take_samples(replay.transitions, 3, train_state.segment_indices(index, length, num_envs))
    if config.history == "iterations":
        return past
    count = steps // length * config.num_envs
    index = _draw(jax.random.fold_in(key, 1), (updates, batch), count, horizon.alive(current.obs, config), stay)
    new = train_state.take_samples(current, 2, train_state.segment_indices(index, length, config.num_envs))
    half = batch // 2
    return jax.tree.map(lambda past, new: jnp.concatenate([past[:, :half], new[:, half:]], axis=1), past, new)


def _draw(
    key: Key, shape: tuple[int, ...], count: jax.Array | int, alive: jax.Array | float, stay: jax.Array | int
) -> jax.Array:
    """Draws from the first `count` segments with replacement.

    Args:
      alive: for each segment 0 if it is an absorbing step, else 1; a number if none is.
      stay: how much more often an absorbing step is drawn.
    """
    if isinstance(stay, int):  # all are drawn equally often
        return jax.random.randint(key, shape, 0, count)
    weight = jnp.where(jnp.ravel(alive) > 0, 1, stay)
    ends = jnp.cumsum(jnp.where(jnp.arange(weight.size) < count, weight, 0))
    return jnp.searchsorted(ends, jax.random.randint(key, shape, 0, ends[-1]), side="right")
