"""Training: iterations in one `lax.scan`, seeds and hyperparameters in one `vmap`, lanes spread over the devices."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from eairl_jax.types import Algorithm, HParams, Key, Metrics, PyTree

LANES = "lanes"


def scan(algorithm: Algorithm, state: PyTree, hparams: HParams, data: PyTree, length: int) -> tuple[PyTree, Metrics]:
    """`length` iterations of one lane; metrics `[length]`."""
    return jax.lax.scan(lambda state, _: algorithm.step(state, hparams, data), state, length=length)


class Lanes:
    """Independent runs of one algorithm, trained side by side: seeds, hyperparameters, rewards.

    A lane is a row of every leaf of `state`, `hparams` and, if `data_per_lane`, of `data`. Lanes never talk to each
    other, so they are split evenly over the devices; where they do not divide, the last lane is repeated, and
    its copies are dropped from every result.

    Args:
      algorithm: what to train.
      keys: `[lanes]` random keys, one a lane.
      hparams: leaves are scalars (the same for every lane) or `[lanes]`.
      data: what the algorithm learns from.
      data_per_lane: whether the leaves of `data` have a lane axis.
      devices: default, all of this process.
    """

    def __init__(
        self,
        algorithm: Algorithm,
        keys: Key,
        hparams: HParams,
        data: PyTree = (),
        data_per_lane: bool = False,
        devices: list | None = None,
    ):
        self.count = keys.shape[0]
        devices = (devices or jax.devices())[: self.count]
        self._algorithm = algorithm
        self._rows = np.minimum(np.arange(-(-self.count // len(devices)) * len(devices)), self.count - 1)
        mesh = Mesh(np.array(devices), (LANES,))
        self._lane_spec = PartitionSpec(LANES)
        self._data_spec = self._lane_spec if data_per_lane else PartitionSpec()
        self._mesh, self._data_axis = mesh, 0 if data_per_lane else None
        self._sharding = NamedSharding(mesh, self._lane_spec)
        hparams = jax.tree.map(lambda x: jnp.broadcast_to(jnp.asarray(x, jnp.float32), (self.count,)), hparams)
        self.hparams = self.put(hparams)
        data = jax.tree.map(jnp.asarray, data)
        self.data = self.put(data) if data_per_lane else jax.device_put(data, NamedSharding(mesh, self._data_spec))
        self._programs: dict[int, Any] = {}
        self._init = jax.jit(self._spread(jax.vmap(algorithm.init), (self._lane_spec, self._lane_spec)))
        self._keys = self.put(keys)

    def put(self, tree: PyTree) -> PyTree:
        """Lays a pytree of `[lanes, ...]` out over the devices, padding included."""
        return jax.tree.map(lambda x: jax.device_put(np.asarray(x)[self._rows], self._sharding), tree)

    def take(self, tree: PyTree) -> PyTree:
        """Brings a pytree of lanes back as NumPy arrays `[lanes, ...]`, padding dropped."""
        return jax.tree.map(lambda x: np.asarray(x)[: self.count], tree)

    def init(self) -> PyTree:
        """The state of every lane before the first iteration."""
        return self._init(self._keys, self.hparams)

    def compile(self, state: PyTree, length: int) -> float:
        """Compiles a chunk of `length` iterations; returns the seconds it took (0 if it was there)."""
        if length in self._programs:
            return 0.0
        started = time.perf_counter()

        def chunk(state, hparams, data):
            run = jax.vmap(lambda s, h, d: scan(self._algorithm, s, h, d, length), in_axes=(0, 0, self._data_axis))
            return run(state, hparams, data)

        spread = self._spread(chunk, (self._lane_spec, self._lane_spec, self._data_spec))
        program = jax.jit(spread, donate_argnums=0).lower(state, self.hparams, self.data).compile()
        self._programs[length] = program
        return time.perf_counter() - started

    def run(self, state: PyTree, length: int) -> tuple[PyTree, Metrics]:
        """`length` iterations of every lane. The state given is consumed.

        Returns:
          The state afterwards, and metrics as NumPy arrays `[lanes, length]`.
        """
        self.compile(state, length)
        state, metrics = self._programs[length](state, self.hparams, self.data)
        return state, self.take(metrics)

    def _spread(self, function: Callable, in_specs) -> Callable:
        return jax.shard_map(
            function, mesh=self._mesh, in_specs=in_specs, out_specs=self._lane_spec, check_vma=False
        )  # fmt: skip
