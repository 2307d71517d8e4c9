"""One lane on several devices: each computes a part (a shard) of the environments and of every minibatch.

A lane's state is the same on all of its devices. In each iteration a device simulates its part of the environments. The
parts are joined, so every device then has all samples. It takes the gradient of its part of each minibatch, and the
gradients are averaged. All random numbers are drawn as on one device. So the result differs in the order of sums alone,
that is, in the last bits.

`Lanes` runs such a program: it names the devices' axis (`AXIS`). Outside of it only `Shards(1)` works.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
from jax.flatten_util import ravel_pytree

from eairl_jax import arguments
from eairl_jax.errors import InputError
from eairl_jax.types import PyTree

AXIS = "shards"
"""The name of the axis of the devices that compute one lane."""


@dataclass(frozen=True)
class Shards:
    """The devices that compute one lane together.

    Attributes:
      count: how many there are. With one device, every method returns what it is given.
    """

    count: int = 1

    def part(self, tree: PyTree, axis: int = 0) -> PyTree:
        """This device's part of every leaf along an axis; the whole leaf if it has no equal parts."""

        def of_leaf(leaf):
            if leaf.shape[axis] % self.count:
                return leaf
            size = leaf.shape[axis] // self.count
            return jax.lax.dynamic_slice_in_dim(leaf, jax.lax.axis_index(AXIS) * size, size, axis)

        return tree if self.count == 1 else jax.tree.map(of_leaf, tree)

    def join(self, tree: PyTree, axis: int = 0) -> PyTree:
        """The parts of all devices, one after another along an axis."""
        if self.count == 1:
            return tree
        return jax.tree.map(lambda leaf: jax.lax.all_gather(leaf, AXIS, axis=axis, tiled=True), tree)

    def mean(self, tree: PyTree) -> PyTree:
        """The mean of every leaf over the devices, all leaves in one exchange."""
        if self.count == 1:
            return tree
        flat, unravel = ravel_pytree(tree)
        return unravel(jax.lax.pmean(flat, AXIS))


ONE = Shards()


def of_count(count: int, num_envs: int) -> Shards:
    """`Shards` for a lane with `num_envs` environments.

    Raises:
      InputError: if `count` is no whole number of at least 1, or if the environments cannot be split evenly.
    """
    count = arguments.count("shards", count)
    if num_envs % count:
        raise InputError(
            f"shards = {count}: num_envs = {num_envs} environments cannot be split evenly over {count} devices; try "
            f"shards={fitting(num_envs, count)}"
        )
    return Shards(count)


def fitting(num_envs: int, devices: int) -> int:
    """The largest number of shards, at most `devices`, that splits `num_envs` environments evenly."""
    return max(count for count in range(1, max(1, devices) + 1) if num_envs % count == 0)
