"""Adam on minibatches: how every network is fitted."""

from __future__ import annotations

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import optax
from flax import struct

from eairl_jax.types import Metrics, PyTree

_ADAM = optax.scale_by_adam()


@struct.dataclass
class TrainState:
    """Parameters and their Adam moments. The learning rate is no part of it: rates stay free to be vmapped."""

    params: PyTree
    adam: PyTree


def start(params: PyTree) -> TrainState:
    """Parameters before the first update."""
    return TrainState(params, _ADAM.init(params))


def prevent_loop_fusion(number: jax.Array) -> jax.Array:
    """The same scalar (infinity for NaN), by way of a sort: a loop that holds one is never compiled into one kernel.

    On a CPU XLA makes loops one kernel as far as `eairl_jax.experiments.cli.configure_jax` lets it, which suits physics and not
    networks: their products are then ten times slower than its library's.
    """
    most = jnp.inf if jnp.issubdtype(number.dtype, jnp.floating) else jnp.iinfo(number.dtype).max
    return jnp.sort(jnp.stack([number, jnp.asarray(most, number.dtype)]))[0]


def descend(fitted: TrainState, gradient: PyTree, lr: float | jax.Array) -> TrainState:
    """One Adam step down the gradient."""
    direction, adam = _ADAM.update(gradient, fitted.adam)
    params = jax.tree.map(lambda p, d: p - lr * d, fitted.params, direction)
    return TrainState(params, adam._replace(count=prevent_loop_fusion(adam.count)))


def clip_norm(gradient: PyTree, max_norm: float | jax.Array) -> PyTree:
    """Scales a gradient down to `max_norm` where its global norm is above it."""
    scale = jnp.minimum(1.0, max_norm / (optax.tree.norm(gradient) + 1e-8))
    return jax.tree.map(lambda g: g * scale, gradient)


def fit(
    fitted: TrainState,
    loss: Callable[[PyTree, PyTree], tuple[jax.Array, Metrics]],
    minibatches: PyTree,
    lr: float | jax.Array,
) -> tuple[TrainState, Metrics]:
    """Descends `loss(params, minibatch) -> (loss, metrics)` once on each of the minibatches.

    Args:
      minibatches: pytree of `[updates, batch, ...]`.

    Returns:
      The fitted parameters and the metrics, averaged over the updates.
    """

    def update(fitted, minibatch):
        gradient, metrics = jax.grad(loss, has_aux=True)(fitted.params, minibatch)
        return descend(fitted, gradient, lr), metrics

    fitted, metrics = jax.lax.scan(update, fitted, minibatches)
    return fitted, jax.tree.map(lambda m: m.mean(axis=0), metrics)


def draw(key: jax.Array, data: PyTree, axes: int, updates: int, batch: int) -> PyTree:
    """Draws minibatches `[updates, batch, ...]` with replacement from data whose first `axes` axes are samples."""
    size = jax.tree.leaves(data)[0].size // max(1, math.prod(jax.tree.leaves(data)[0].shape[axes:]))
    return rows(data, axes, jax.random.randint(key, (updates, batch), 0, size))


def rows(data: PyTree, axes: int, index: jax.Array) -> PyTree:
    """The samples of an index, `[*index.shape, ...]`, of data whose first `axes` axes are samples."""
    return jax.tree.map(lambda x: jnp.asarray(x).reshape(-1, *x.shape[axes:])[index], data)


def segment(index: jax.Array, length: int, num_envs: int = 1) -> jax.Array:
    """Rows, of samples laid out `[..., T, num_envs]`, of the segments of `length` steps that `index` counts.

    Returns:
      `[*index.shape, length]`; with a length of 1 the index itself.
    """
    block, env = jnp.divmod(index[..., None], num_envs)
    return (block * length + jnp.arange(length)) * num_envs + env
