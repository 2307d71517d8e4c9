"""Training: iterations in one `lax.scan`, seeds and hyperparameters in one `vmap`, lanes spread over the devices."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from eairl_jax import arguments, memory, processes, shards
from eairl_jax.blocks import LANES, Blocks
from eairl_jax.config import Config
from eairl_jax.errors import Diverged, InputError
from eairl_jax.hparams import check_hparams
from eairl_jax.programs import row_shapes
from eairl_jax.schema import shown
from eairl_jax.types import Algorithm, HParams, Key, Metrics, PyTree
from eairl_jax.xla import options_of_one_call, refuse_double_precision


def scan(algorithm: Algorithm, state: PyTree, hparams: HParams, data: PyTree, length: int) -> tuple[PyTree, Metrics]:
    """Runs `length` iterations of one lane; returns the state and metrics `[length]`.

    Raises:
      InputError: if a value of `hparams` is impossible, or if `length` is no whole number of at least 1.
    """
    check_hparams(hparams)
    length = arguments.count("length", length)
    return jax.lax.scan(lambda state, _: algorithm.step(state, hparams, data), state, length=length)


class Lanes:
    """Independent runs (lanes) of one algorithm, trained side by side: seeds, hyperparameters, rewards.

    A lane has one row in every leaf of `state`, of `hparams` and, with `data_per_lane`, of `data`. Lanes do not
    exchange data, so they are split evenly over the devices. If the number of lanes is not a multiple of the number of
    devices, copies of the last lane fill the gap; every result drops the copies. An algorithm that was built for
    several devices a lane (`make_irl(env, config, shards=2)`) gets as many for each.

    Lanes of one algorithm share what is compiled.

    Inside `processes.leading`, lanes are split over the devices of all processes. A state is then a `blocks.Spread`;
    `take` gives its arrays.

    Args:
      algorithm: the algorithm to train.
      keys: one random key for each lane, for example `jax.random.split(jax.random.key(0), 5)` for 5 lanes.
      hparams: every leaf is a scalar (the same value for every lane) or `[lanes]`.
      data: what the algorithm learns from, see `Algorithm.step`.
      data_per_lane: whether the leaves of `data` have a lane axis.
      devices: the devices to use, of this process; by default, all devices of this process and of its team.

    Raises:
      InputError: if `keys` are not one key for each lane, if a value of `hparams` is impossible, if a leaf of `hparams`
        or of `data` has another number of lanes, if there are more processes than lanes, or if the algorithm needs more
        devices a lane than there are (in a process, if there are several).
      ProcessLost: here and in every method, if one of several processes is gone.
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
        refuse_double_precision()
        _check_algorithm(algorithm)
        keys = raw_keys(keys)
        self.count = keys.shape[0]
        if data_per_lane:
            _check_rows("data", data, self.count)
        self._algorithm, self._data_axis = algorithm, 0 if data_per_lane else None
        hparams = self._of_lanes(hparams)
        data, init = jax.tree.map(jnp.asarray, data), jax.vmap(algorithm.init)
        self._programs: dict[int, Any] = {}
        team = None if devices else processes.current()
        devices = devices or jax.local_devices()
        _check_shards(algorithm.shards, min(team.devices) if team else len(devices))
        self._blocks = None
        if team:
            self._blocks = Blocks(team, init, np.asarray(keys), hparams, data, data_per_lane, algorithm.shards)
            return
        rows = min(self.count, len(devices) // algorithm.shards)
        self._rows = np.minimum(np.arange(-(-self.count // rows) * rows), self.count - 1)
        mesh = np.array(devices[: rows * algorithm.shards]).reshape(rows, algorithm.shards)
        self._mesh = Mesh(mesh, (LANES, shards.AXIS))
        self._lane_spec = PartitionSpec(LANES)
        self._data_spec = self._lane_spec if data_per_lane else PartitionSpec()
        self._sharding = NamedSharding(self._mesh, self._lane_spec)
        self.hparams = self.put(hparams)
        self.data = (
            self.put(data) if data_per_lane else jax.device_put(data, NamedSharding(self._mesh, self._data_spec))
        )
        self._init = _init_program(algorithm, self._mesh)
        self._keys = self.put(keys)

    def _of_lanes(self, hparams: HParams) -> HParams:
        """The floats with a lane axis, checked."""
        check_hparams(hparams)
        _check_rows("hparams", jax.tree.map(lambda x: x if np.ndim(x) else [x] * self.count, hparams), self.count)
        return jax.tree.map(lambda x: jnp.broadcast_to(jnp.asarray(x, jnp.float32), (self.count,)), hparams)

    @property
    def _devices(self) -> list[Any]:
        return list(self._mesh.devices.flat)

    def _named(self, what: str) -> str:
        return f"{what} of {self.count} {'lane' if self.count == 1 else 'lanes'}"

    def put(self, tree: PyTree) -> PyTree:
        """Distributes a pytree of `[lanes, ...]` over the devices, with copies of the last lane where needed."""
        if self._blocks:
            return self._blocks.put(tree)
        return jax.tree.map(lambda x: jax.device_put(np.asarray(x)[self._rows], self._sharding), tree)

    def take(self, tree: PyTree) -> PyTree:
        """Returns a distributed pytree as NumPy arrays `[lanes, ...]`, without the copies of the last lane."""
        if self._blocks:
            return self._blocks.take(tree)
        return jax.tree.map(lambda x: np.asarray(x)[: self.count], tree)

    def init(self) -> PyTree:
        """The state of every lane before the first iteration.

        Raises:
          InputError: as `check_memory`.
        """
        if self._blocks:
            return self._blocks.init()
        self.check_memory()
        return self._init(self._keys, self.hparams)

    def check_memory(self) -> None:
        """Checks that there is memory for the states. Of lanes in several processes, nothing is known.

        Raises:
          InputError: if the states need more memory than is free.
        """
        if not self._blocks:
            memory.refuse_too_much(self._state_size, self._named("the states"), self._devices)

    def memory(self, length: int) -> Memory:
        """What a training in chunks of `length` iterations needs.

        Raises:
          InputError: if the iterations were not compiled, or if the lanes are in several processes.
        """
        if self._blocks or length not in self._programs:
            raise InputError(f"the memory of {length} iterations is not known: compile them first, in one process")
        devices = len(self._devices)
        return Memory(devices * self._state_size, devices * memory.scratch(self._programs[length]))

    @property
    def _state_size(self) -> int:
        """Bytes of the states on each device."""
        return memory.size(self.shapes()) // self.count * (len(self._rows) // self._mesh.shape[LANES])

    def blank(self) -> PyTree:
        """NumPy zeros `[lanes, ...]` in the shapes of a state; nothing is compiled. Checkpoints need such a tree."""
        return jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), self.shapes())

    def shapes(self) -> PyTree:
        """The shapes `[lanes, ...]` of a state (`jax.ShapeDtypeStruct`); nothing is compiled."""
        if self._blocks:
            return self._blocks.shapes()
        return row_shapes(jax.eval_shape(self._init, self._keys, self.hparams), self.count)

    def compile(self, state: PyTree, length: int) -> float:
        """Compiles `length` iterations; returns the seconds that this took.

        Hardly any if these lanes, or others of the same algorithm and the same shapes, have compiled them before.

        Raises:
          InputError: if the iterations need more memory, beside the states, than is free.
        """
        length = arguments.count("length", length)
        if length in self._programs:
            return 0.0
        started = time.perf_counter()
        if self._blocks:
            self._programs[length] = self._blocks.compile(
                state, length, _chunk(self._algorithm, length, self._data_axis)
            )
        else:
            program = _chunk_program(self._algorithm, length, self._data_axis, self._mesh)
            compiled = program.lower(state, self.hparams, self.data).compile()
            memory.refuse_too_much(memory.scratch(compiled), self._named("the iterations"), self._devices)
            self._programs[length] = compiled
        return time.perf_counter() - started

    def run(self, state: PyTree, length: int, check: bool = True) -> tuple[PyTree, Metrics]:
        """Runs `length` iterations of every lane. The memory of `state` is reused: do not use `state` afterwards.

        To be able to go back, keep `take(state)` before the call; `put` makes a state of it again.

        Args:
          check: whether metrics that are not finite raise `Diverged`. Else they are returned as they are, for a caller
            that goes on with the other lanes (`not_finite` finds them).

        Returns:
          The state after the iterations, and the metrics as NumPy arrays `[lanes, length]`.

        Raises:
          Diverged: if a metric is no longer finite. The metric `true_return` may be NaN: no episode has ended yet.
        """
        self.compile(state, length)
        if self._blocks:
            state, metrics = self._blocks.run(state, length)
        else:
            state, metrics = self._programs[length](state, self.hparams, self.data)
            metrics = self.take(metrics)
        if check:
            refuse_not_finite(metrics)
        if "true_return" in metrics:
            returns = metrics["true_return"]
            metrics["true_return"] = np.where(np.isneginf(returns), np.float32(np.nan), returns)
        return state, metrics


class Memory(NamedTuple):
    """Bytes on all devices together.

    Attributes:
      states: of the states of all lanes.
      beside: what the iterations need beside them; 0 where XLA does not say.
    """

    states: int
    beside: int


KEPT_PROGRAMS = 8
"""Programs that stay compiled for further `Lanes` of the same algorithm and the same shapes."""


@functools.lru_cache(KEPT_PROGRAMS)
def _init_program(algorithm: Algorithm, mesh: Mesh) -> Any:
    """`(keys, hparams) -> state`, all of them `[lanes, ...]`."""
    spec = PartitionSpec(LANES)
    return jax.jit(_spread(jax.vmap(algorithm.init), mesh, (spec, spec)), compiler_options=options_of_one_call())


@functools.lru_cache(KEPT_PROGRAMS)
def _chunk_program(algorithm: Algorithm, length: int, data_axis: int | None, mesh: Mesh) -> Any:
    """`(state, hparams, data) -> (state, metrics)` of `length` iterations, all of them `[lanes, ...]`."""
    spec = PartitionSpec(LANES)
    specs = (spec, spec, PartitionSpec() if data_axis is None else spec)
    return jax.jit(_spread(_chunk(algorithm, length, data_axis), mesh, specs), donate_argnums=0)


def _chunk(algorithm: Algorithm, length: int, data_axis: int | None) -> Callable:
    def chunk(state, hparams, data):
        run = jax.vmap(lambda s, h, d: scan(algorithm, s, h, d, length), in_axes=(0, 0, data_axis))
        return run(state, hparams, data)

    return chunk


def _spread(function: Callable, mesh: Mesh, in_specs) -> Callable:
    return jax.shard_map(function, mesh=mesh, in_specs=in_specs, out_specs=PartitionSpec(LANES), check_vma=False)


class NotFinite(NamedTuple):
    """The first value of a lane that is NaN or infinite.

    Attributes:
      lane: from 0.
      iteration: of the call, from 1.
      metric, value: the name of the metric, and its value.
    """

    lane: int
    iteration: int
    metric: str
    value: float


def not_finite(metrics: dict[str, np.ndarray]) -> list[NotFinite]:
    """The first value that is NaN or infinite of each lane that has one, in the order of the lanes.

    The metric `true_return` is -inf (or NaN) while no episode has ended.

    Args:
      metrics: NumPy arrays `[lanes, length]`.
    """
    first: dict[int, NotFinite] = {}
    for name, values in metrics.items():
        bad = np.isposinf(values) if name == "true_return" else ~np.isfinite(values)
        for lane in np.flatnonzero(bad.any(axis=1)).tolist():
            t = int(bad[lane].argmax())
            if lane not in first or t + 1 < first[lane].iteration:
                first[lane] = NotFinite(lane, t + 1, name, float(values[lane, t]))
    return [first[lane] for lane in sorted(first)]


def refuse_not_finite(metrics: dict[str, np.ndarray]) -> None:
    """Raises `Diverged` for the earliest iteration at which a metric `[lanes, length]` is NaN or infinite."""
    bad = min(not_finite(metrics), key=lambda each: each.iteration, default=None)
    if bad:
        length = next(iter(metrics.values())).shape[1]
        raise Diverged(
            f"{bad.metric} became {bad.value} in lane {bad.lane} at iteration {bad.iteration} of {length}: try a "
            "lower learning rate",
            bad.metric,
            bad.lane,
            bad.iteration,
            bad.value,
        )


def _check_algorithm(algorithm: Algorithm) -> None:
    if not isinstance(algorithm, Algorithm):
        raise InputError(
            f"algorithm is {shown(algorithm)}: expected an Algorithm, for example make_irl(env, Config()) of eairl_jax"
        )


def _check_shards(count: int, devices: int) -> None:
    """Raises `InputError` if a lane cannot have `count` devices of a process that has `devices`."""
    if count > devices:
        raise InputError(
            f"the algorithm was built with shards = {count}, and there are {devices} devices: build it with "
            f"shards={devices} or fewer"
        )


SMALLEST_SHARD, SMALLEST_SHARD_ON_CPU = 1024, 16
"""Environments that are worth a device of their own. On a GPU, 128 take as long as 16."""
SHORTEST_ITERATION_ON_CPU = 6400
"""Environment steps of an iteration that is worth two devices. Devices that share a lane wait for each other some 20 ms
an iteration: a maze with 3,200 steps gets slower by that, a swimmer with 8,000 faster (`docs/performance.md`)."""


def shards_for(lanes: int, config: Config) -> int:
    """How many devices a lane should have: `shards` of `make_irl` and `make_rl`.

    One, unless there are at least twice as many devices as lanes, and enough environments and steps for several. The
    devices of a lane are of one process: with several processes, the one with the fewest decides.

    Args:
      lanes: how many lanes there are.
      config: `num_envs` environments of a lane are split evenly.
    """
    on_cpu = jax.default_backend() == "cpu"
    if on_cpu and config.steps_per_iteration < SHORTEST_ITERATION_ON_CPU:
        return 1
    own, devices = lanes, jax.local_device_count()
    if team := processes.current():
        own, devices = -(-lanes // len(team.devices)), min(team.devices)
    smallest = SMALLEST_SHARD_ON_CPU if on_cpu else SMALLEST_SHARD
    return shards.fitting(config.num_envs, min(devices // own, config.num_envs // smallest))


def _check_rows(name: str, tree: PyTree, count: int) -> None:
    """Raises `InputError` unless every leaf has one row for each lane."""
    for path, leaf in jax.tree_util.tree_flatten_with_path(tree, is_leaf=lambda x: isinstance(x, list))[0]:
        if np.shape(leaf)[:1] != (count,):
            raise InputError(
                f"{name}{jax.tree_util.keystr(path)} has shape {np.shape(leaf)}: expected one row for each of the "
                f"{count} lanes"
            )


def raw_keys(keys: Key) -> jax.Array:
    """Random keys as old-style keys `[lanes, key size]`; `keys` are `[lanes]` of `jax.random.key`, or old-style keys.

    Raises:
      InputError: if `keys` are not one key for each lane.
    """
    if not hasattr(keys, "dtype") or not hasattr(keys, "shape"):
        raise InputError(
            f"keys are {shown(keys)}: expected one random key for each lane, for example "
            "jax.random.split(jax.random.key(0), 5) for 5 lanes"
        )
    if jnp.issubdtype(keys.dtype, jax.dtypes.prng_key):
        keys = jax.random.key_data(keys)
    one_key = jax.eval_shape(jax.random.PRNGKey, 0)
    if keys.ndim != 2 or keys.shape[0] == 0 or keys.shape[1:] != one_key.shape or keys.dtype != one_key.dtype:
        raise InputError(
            f"keys have shape {keys.shape} and dtype {keys.dtype}: expected one random key for each lane, "
            f"[lanes, {one_key.shape[0]}] of {one_key.dtype}; split the key, for example "
            "jax.random.split(jax.random.key(0), 5) for 5 lanes"
        )
    return keys
