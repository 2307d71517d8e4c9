"""A block: lanes of one process, as flat lists of arrays, computed by exported programs.

A run of several processes (`processes`) has blocks in each of them. Process 0 exports its programs by `jax.export`, so
the others need no Python of the algorithm. A program is that of one device, with the lanes of one device, so it does
not depend on the number of processes. Lanes come out bit-equal in any number of processes if each device has as many of
them as before. One case is apart: XLA compiles a program for a single device in another way than for several. Processes
that use one device each therefore differ in the last bits from one process with several devices.

Devices of a process that would be idle share a lane (`shards`). Then a program is that of the devices of one lane, and
the process has a block for each group of such devices. A lane is never spread over processes: its devices exchange
gradients many times an iteration.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.sharding import AbstractMesh, Mesh, NamedSharding, PartitionSpec

from eairl_jax.errors import InputError
from eairl_jax.processes import Arrays, Peer, Team, check_lanes
from eairl_jax.programs import row_shapes
from eairl_jax.shards import AXIS
from eairl_jax.types import HParams, PyTree

LANES = "lanes"

EVERYWHERE = PartitionSpec()
"""Of an array that every device has as a whole."""
Answer = tuple[dict[str, Any], Sequence[Any]]
"""What a call has to say, and its arrays."""


class Block:
    """Lanes of this process, on some of its devices. There is one state, which each call replaces.

    Calls return arrays that may still be computed.

    Args:
      arrays: keys `[lanes, key size]`, then the leaves of `HParams` `[lanes]`, then those of the data.
      hparams: how many leaves `HParams` have.
      devices: they have as many lanes each, or all of them the same lanes.
      data_per_lane: whether the leaves of the data have a lane axis.
      share: whether the devices compute the same lanes together.
    """

    def __init__(self, arrays: Arrays, hparams: int, devices: list, data_per_lane: bool, share: bool = False):
        self._mesh = Mesh(np.array(devices), (AXIS if share else LANES,))
        self._share = share
        self._of_lanes = PartitionSpec() if share else PartitionSpec(LANES)
        self._of_data = self._of_lanes if data_per_lane else PartitionSpec()
        self._keys, *rest = self._placed(arrays[: 1 + hparams], self._of_lanes)
        self._hparams, self._data = rest, self._placed(arrays[1 + hparams :], self._of_data)
        self._state: list[jax.Array] = []
        self._programs: dict[int, Any] = {}

    def init(self, arrays: Arrays) -> Answer:
        """Makes the state by an exported program, `arrays[0]`."""
        program = jax.jit(self._spread(arrays[0], (self._of_lanes, self._of_lanes)))
        self._state = program(self._keys, self._hparams)
        return {}, []

    def put(self, arrays: Arrays) -> Answer:
        """Takes the leaves of a state `[lanes, ...]`."""
        self._state = self._placed(arrays, self._of_lanes)
        return {}, []

    def take(self, _arrays: Arrays) -> Answer:
        """Gives the leaves of the state."""
        return {}, self._state

    def compile(self, arrays: Arrays, length: int) -> Answer:
        """Compiles an exported program of `length` iterations, `arrays[0]`."""
        spread = self._spread(arrays[0], (self._of_lanes, self._of_lanes, self._of_data))
        lowered = jax.jit(spread, donate_argnums=0).lower(self._state, self._hparams, self._data)
        self._programs[length] = lowered.compile()
        return {}, []

    def run(self, _arrays: Arrays, length: int) -> Answer:
        """Advances the state; gives the names of the metrics, and each metric `[lanes, length]`."""
        self._state, metrics = self._programs[length](self._state, self._hparams, self._data)
        return {"metrics": list(metrics)}, list(metrics.values())

    def _placed(self, arrays: Arrays, spec: PartitionSpec) -> list[jax.Array]:
        return [jax.device_put(each, NamedSharding(self._mesh, spec)) for each in arrays]

    def _spread(self, program: np.ndarray, in_specs: tuple) -> Any:
        call = jax.export.deserialize(bytearray(program)).call
        if self._share:
            return call  # it is that of these devices together
        return jax.shard_map(call, mesh=self._mesh, in_specs=in_specs, out_specs=self._of_lanes, check_vma=False)


class OwnLanes:
    """All lanes of this process: one block, or one for each group of devices that share a lane.

    Args:
      arrays, hparams, data_per_lane: of `Block`, for all lanes of the process.
      devices: how many devices of this process are used.
      shards: how many of them compute a lane together.
    """

    CALLS = frozenset({"init", "put", "take", "compile", "run"})
    OF_LANES = frozenset({"put"})
    """The calls whose arrays have a lane axis. Those of the others are the same for every block."""

    def __init__(self, arrays: Arrays, hparams: int, devices: int, data_per_lane: bool, shards: int = 1):
        used = jax.local_devices()[:devices]
        groups = [used] if shards == 1 else [used[i : i + shards] for i in range(0, devices, shards)]
        self._groups, of_lanes = len(groups), len(arrays) if data_per_lane else 1 + hparams
        self._blocks = [
            Block([*own, *arrays[of_lanes:]], hparams, group, data_per_lane, shards > 1)
            for own, group in zip(self._split(arrays[:of_lanes]), groups, strict=True)
        ]

    def call(self, name: str, arrays: Arrays, values: dict[str, Any]) -> tuple[dict[str, Any], Arrays]:
        """Calls one of `CALLS` of every block, side by side; returns what the first says, and all their arrays."""
        if name not in self.CALLS:
            raise InputError(f"a block cannot {name!r:.40}")
        own = self._split(arrays) if name in self.OF_LANES else [arrays] * self._groups
        answers = [getattr(block, name)(each, **values) for block, each in zip(self._blocks, own, strict=True)]
        parts = zip(*(result for _, result in answers), strict=True)
        return answers[0][0], [_joined(part) for part in parts]

    def _split(self, arrays: Arrays) -> list[Arrays]:
        """The rows of arrays `[lanes, ...]` that each block has."""
        return [list(each) for each in zip(*(np.split(array, self._groups) for array in arrays), strict=True)]


def serve(leader: Peer, asked: Callable[[], int | None] = lambda: None) -> bool:
    """Computes what process 0 asks for, until process 0 ends; returns whether it failed.

    Args:
      asked: the signal that has asked this process to stop, if one has. Process 0 hears of it with the next answer.

    Raises:
      ProcessLost: if process 0 is gone.
    """
    blocks: dict[int, OwnLanes] = {}
    while True:
        request, arrays = leader.receive()
        if request["call"] == "end":
            return request["failed"]
        for number in request["freed"]:
            blocks.pop(number, None)
        try:
            if request["call"] == "make":
                blocks[request["block"]] = OwnLanes(arrays, **request["values"])
                values, result = {}, []
            else:
                values, result = blocks[request["block"]].call(request["call"], arrays, request["values"])
        except Exception as e:  # whatever it is, process 0 says it
            values, result = {"error": f"{type(e).__name__}: {e}"}, []
        leader.send(values | {"number": request["number"], "asked": asked()}, result)


class Spread(NamedTuple):
    """Stands for the state of `Blocks`, whose arrays are in several processes. `Lanes.take` gives them.

    Attributes:
      number: how many states there were before.
    """

    number: int


class Blocks:
    """The lanes of a run in all processes of a team, a block in each.

    Args:
      team: this process, and those that serve it.
      init: `(keys [lanes, key size], hparams) -> state [lanes, ...]`.
      keys: `[lanes, key size]`.
      hparams: every leaf is `[lanes]`.
      data: what the algorithm learns from.
      data_per_lane: whether the leaves of `data` have a lane axis.
      shards: how many devices of a process compute a lane together.

    Raises:
      InputError: if a process would have no lane.
      ProcessLost: if a process is gone. So does every method.
    """

    def __init__(
        self,
        team: Team,
        init: Callable,
        keys: np.ndarray,
        hparams: HParams,
        data: PyTree,
        data_per_lane: bool,
        shards: int = 1,
    ):
        self._count, self._shards = len(keys), shards
        used, self._width = share(self._count, [devices // shards for devices in team.devices])
        rows = np.minimum(np.arange(sum(used) * self._width), self._count - 1)
        self._rows = np.split(rows, np.cumsum(used)[:-1] * self._width)
        self._team, self._init, self._states = team, init, 0
        self._hparams, self._data = jax.tree.structure(hparams), jax.tree.structure(data)
        of_lanes, of_data = [keys, *jax.tree.leaves(hparams)], jax.tree.leaves(data)
        self._shapes = [self._one_device(of_lanes), self._one_device(of_data) if data_per_lane else _shapes(of_data)]
        self._state = jax.eval_shape(init, self._shapes[0][0], self._hparams.unflatten(self._shapes[0][1:]))
        parts = [self._of(rows, of_data) if data_per_lane else of_data for rows in self._rows]
        arrays = [[*self._of(rows, of_lanes), *part] for rows, part in zip(self._rows, parts, strict=True)]
        alike = {"hparams": len(of_lanes) - 1, "data_per_lane": data_per_lane, "shards": shards}
        values = [alike | {"devices": each * shards} for each in used]
        self._number = team.new_block()
        weakref.finalize(self, team.free, self._number)
        team.ask(self._number, "make", values[1:], arrays[1:])
        self._own = OwnLanes(arrays[0], **values[0])
        team.answers()

    def init(self) -> Spread:
        """The state of every lane before the first iteration."""

        def flat(keys, hparams):
            return jax.tree.leaves(self._init(keys, self._hparams.unflatten(hparams)))

        keys, *hparams = self._shapes[0]
        return self._new("init", [[_exported(flat, self._shards, keys, hparams)]] * len(self._rows))

    def put(self, tree: PyTree) -> Spread:
        """Makes a state of a pytree of `[lanes, ...]`."""
        leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]
        return self._new("put", [self._of(rows, leaves) for rows in self._rows])

    def take(self, state: Spread) -> PyTree:
        """The state as NumPy arrays `[lanes, ...]`."""
        self._check(state)
        parts = [arrays for _, arrays in self._everywhere("take", {})]
        return jax.tree.unflatten(jax.tree.structure(self._state), self._of_all(parts))

    def shapes(self) -> PyTree:
        """The shapes `[lanes, ...]` of a state."""
        return row_shapes(self._state, self._count)

    def compile(self, state: Spread, length: int, chunk: Callable) -> None:
        """Compiles `length` iterations everywhere.

        Args:
          chunk: `(state, hparams, data) -> (state, metrics)`, all of them `[lanes, ...]` but perhaps the data.
        """
        self._check(state)
        structure = jax.tree.structure(self._state)

        def flat(state, hparams, data):
            trees = structure.unflatten(state), self._hparams.unflatten(hparams), self._data.unflatten(data)
            state, metrics = chunk(*trees)
            return jax.tree.leaves(state), metrics

        program = _exported(flat, self._shards, jax.tree.leaves(self._state), self._shapes[0][1:], self._shapes[1])
        self._everywhere("compile", {"length": length}, [[program]] * len(self._rows))

    def run(self, state: Spread, length: int) -> tuple[Spread, PyTree]:
        """Runs `length` iterations that were compiled before; returns the new state and metrics `[lanes, length]`."""
        self._check(state)
        parts = self._everywhere("run", {"length": length})
        names = parts[0][0]["metrics"]
        self._states += 1
        return Spread(self._states), dict(zip(names, self._of_all([arrays for _, arrays in parts]), strict=True))

    def _everywhere(
        self, call: str, values: dict[str, Any], arrays: Sequence[Arrays] | None = None
    ) -> list[tuple[dict[str, Any], Arrays]]:
        """Calls a method of every block. The others compute while this process does."""
        each = arrays or [[]] * len(self._rows)
        self._team.ask(self._number, call, [values] * len(self._team.workers), each[1:])
        return [self._own.call(call, each[0], values), *self._team.answers()]

    def _new(self, call: str, arrays: Sequence[Arrays]) -> Spread:
        self._everywhere(call, {}, arrays)
        self._states += 1
        return Spread(self._states)

    def _check(self, state: Spread) -> None:
        if state != Spread(self._states):
            raise InputError("the lanes are in several processes, which keep one state: the newest one is needed here")

    def _of(self, rows: np.ndarray, leaves: Sequence[Any]) -> Arrays:
        return [np.asarray(leaf)[rows] for leaf in leaves]

    def _of_all(self, parts: Sequence[Arrays]) -> Arrays:
        return [_joined(leaves)[: self._count] for leaves in zip(*parts, strict=True)]

    def _one_device(self, leaves: Sequence[Any]) -> list[jax.ShapeDtypeStruct]:
        return [jax.ShapeDtypeStruct((self._width, *leaf.shape[1:]), leaf.dtype) for leaf in leaves]


def share(lanes: int, devices: Sequence[int]) -> tuple[list[int], int]:
    """How many devices of each process get lanes, and how many lanes each of these devices gets.

    With fewer lanes than devices, the processes take turns: no process has two lanes more than another one that has an
    idle device.

    Args:
      devices: of every process.

    Raises:
      InputError: if there are more processes than lanes.
    """
    check_lanes(lanes, len(devices))
    used = [0] * len(devices)
    while sum(used) < min(lanes, sum(devices)):
        for process, count in enumerate(devices):
            used[process] += used[process] < count and sum(used) < lanes
    return used, -(-lanes // sum(used))


def _joined(parts: Sequence[Any]) -> np.ndarray:
    """Arrays as one, which is a copy only if there are several."""
    arrays = [np.asarray(each) for each in parts]
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


def _shapes(leaves: Sequence[Any]) -> list[jax.ShapeDtypeStruct]:
    return [jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in leaves]


def _exported(function: Callable, shards: int, *shapes: Any) -> np.ndarray:
    """The bytes of a program for one device, or for `shards` devices that compute the same lanes together."""
    jitted = jax.jit(function)
    if shards > 1:
        mesh = AbstractMesh((shards,), (AXIS,))
        together = jax.shard_map(function, mesh=mesh, in_specs=EVERYWHERE, out_specs=EVERYWHERE, check_vma=False)
        placed = NamedSharding(mesh, EVERYWHERE)
        jitted = jax.jit(together, in_shardings=placed, out_shardings=placed)
    try:
        return np.frombuffer(jax.export.export(jitted)(*shapes).serialize(), np.uint8)
    except (NotImplementedError, ValueError) as e:
        raise InputError(f"this cannot be computed by several processes ({e}): run it in one") from e
