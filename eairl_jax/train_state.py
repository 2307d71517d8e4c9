"""Adam on minibatches: how every network is trained."""

from __future__ import annotations

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import optax
from flax import struct

from eairl_jax.shards import ONE, Shards
from eairl_jax.types import Metrics, PyTree
from eairl_jax.xla import prevent_loop_fusion

_ADAM = optax.scale_by_adam()


@struct.dataclass
class TrainState:
    """The parameters of one or more networks and their Adam moments.

    The learning rate is an argument of every update and not a part of the state, so that a rate can be vmapped.

    Attributes:
      params: pytree of parameters.
      adam: the state of `optax.scale_by_adam` for these parameters.
    """

    params: PyTree
    adam: PyTree


def init(params: PyTree) -> TrainState:
    """The state before the first update: the given parameters, and moments of 0."""
    return TrainState(params, _ADAM.init(params))


def adam_step(state: TrainState, gradient: PyTree, lr: float | jax.Array) -> TrainState:
    """Takes one Adam step (Kingma and Ba 2015) against the gradient."""
    direction, adam = _ADAM.update(gradient, state.adam)
    params = jax.tree.map(lambda p, d: p - lr * d, state.params, direction)
    return TrainState(params, adam._replace(count=prevent_loop_fusion(adam.count)))


def clip_norm(gradient: PyTree, max_norm: float | jax.Array) -> PyTree:
    """Scales a gradient down to the global norm `max_norm` where its norm is larger."""
    scale = jnp.minimum(1.0, max_norm / (optax.tree.norm(gradient) + 1e-8))
    return jax.tree.map(lambda g: g * scale, gradient)


def fit(
    state: TrainState,
    loss: Callable[[PyTree, PyTree], tuple[jax.Array, Metrics]],
    minibatches: PyTree,
    lr: float | jax.Array,
    shards: Shards = ONE,
) -> tuple[TrainState, Metrics]:
    """Takes one Adam step on each of the minibatches, in their order.

    Args:
      loss: `(params, minibatch) -> (loss [], metrics)`.
      minibatches: pytree of `[updates, batch, ...]`.
      shards: the devices, each of which takes the gradient of a part of every minibatch. With more than one, the loss
        and the metrics must be means over the minibatch.

    Returns:
      The state after the last step, and the metrics, averaged over the updates.
    """

    def update(state, minibatch):
        gradient, metrics = shards.mean(jax.grad(loss, has_aux=True)(state.params, minibatch))
        return adam_step(state, gradient, lr), metrics

    state, metrics = jax.lax.scan(update, state, shards.part(minibatches, axis=1))
    return state, jax.tree.map(lambda m: m.mean(axis=0), metrics)


def draw_minibatches(key: jax.Array, data: PyTree, sample_axes: int, updates: int, batch: int) -> PyTree:
    """Draws minibatches `[updates, batch, ...]` with replacement.

    Args:
      data: pytree of samples; the first `sample_axes` axes of every leaf count the samples.
    """
    size = jax.tree.leaves(data)[0].size // max(1, math.prod(jax.tree.leaves(data)[0].shape[sample_axes:]))
    return take_samples(data, sample_axes, jax.random.randint(key, (updates, batch), 0, size))


def take_samples(data: PyTree, sample_axes: int, index: jax.Array) -> PyTree:
    """The samples `[*index.shape, ...]` that an index names.

    Args:
      data: pytree of samples; the first `sample_axes` axes of every leaf count the samples.
      index: positions of samples, of any shape, in row-major order over these axes.
    """
    return jax.tree.map(lambda x: jnp.asarray(x).reshape(-1, *x.shape[sample_axes:])[index], data)


def segment_indices(segments: jax.Array, length: int, num_envs: int = 1) -> jax.Array:
    """Positions of the samples of whole segments: `length` consecutive steps of one environment.

    Args:
      segments: numbers of segments, of any shape, among samples laid out `[..., T, num_envs]`.

    Returns:
      `[*segments.shape, length]`, an index for `take_samples`.
    """
    block, env = jnp.divmod(segments[..., None], num_envs)
    return (block * length + jnp.arange(length)) * num_envs + env
