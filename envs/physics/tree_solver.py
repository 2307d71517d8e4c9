"""Linear systems whose matrix has the zeros of a tree of bodies, like the inertia matrix.

Problem: the constraint solver solves such a system in every Newton step, and the kernels of LAPACK keep XLA from
compiling the loop around them into one kernel.

Idea: the factorisation L'DL from the leaves to the root (Featherstone 2008, "Rigid Body Dynamics Algorithms",
section 6.5) creates no entries outside the tree, so the few entries are computed one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap


def tree_solver(parents: Sequence[int]) -> Callable[[jax.Array, jax.Array], jax.Array]:
    """Returns a function `(matrix [n, n], vector [n]) -> matrix^-1 vector [n]`.

    The matrix must be symmetric and positive definite. An entry must be 0 unless one of its two degrees of freedom is
    on the other's path to the root. Under `jax.vmap` the batch axis is moved to the end, so that an entry is a vector.

    Args:
      parents: `[n]`, for every degree of freedom the next one on the path to the root, or -1 at the root. A parent has
        a lower index than its children.
    """
    ancestors: list[tuple[int, ...]] = []
    for parent in parents:
        ancestors.append(() if parent < 0 else (*ancestors[parent], int(parent)))

    def by_entries(matrix: jax.Array, vector: jax.Array) -> jax.Array:
        n = len(ancestors)
        h = {(k, i): matrix[k, i] for k in range(n) for i in (*ancestors[k], k)}
        x = [vector[k] for k in range(n)]
        for k in reversed(range(n)):
            inverse = 1.0 / h[k, k]
            for i in ancestors[k]:
                ratio = h[k, i] * inverse
                for j in (*ancestors[i], i):
                    h[i, j] = h[i, j] - ratio * h[k, j]
                x[i] = x[i] - ratio * x[k]
            for i in ancestors[k]:
                h[k, i] = h[k, i] * inverse  # an entry of L
            x[k] = x[k] * inverse
        for k in range(n):
            for i in ancestors[k]:
                x[k] = x[k] - h[k, i] * x[i]
        return jnp.stack(x)

    solve = custom_vmap(by_entries)

    @solve.def_vmap
    def _(size: int, is_batched: list[bool], matrix: jax.Array, vector: jax.Array):
        if not is_batched[0]:
            matrix = jnp.broadcast_to(matrix, (size, *matrix.shape))
        if not is_batched[1]:
            vector = jnp.broadcast_to(vector, (size, *vector.shape))
        return by_entries(jnp.moveaxis(matrix, 0, -1), jnp.moveaxis(vector, 0, -1)).T, True

    return solve
