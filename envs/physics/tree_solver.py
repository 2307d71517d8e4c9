"""Linear systems whose matrix has a body's tree in it, as inertia has, and what touches one plane adds to it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap


def tree_solver(parents: Sequence[int]) -> Callable[[jax.Array, jax.Array], jax.Array]:
    """`(matrix [n, n], vector [n]) -> matrix^-1 vector [n]`, without LAPACK, whose calls XLA compiles no loop around.

    By L'DL from the leaves to the root (Featherstone 2008, section 6.5), which adds no entries to those of the tree.
    Everything is done element by element; of a batch, whose axis is moved to the end, an element is a vector.

    Args:
      parents: of every degree of freedom the one before it on the way to the root, -1 for none. The matrix is
        symmetric, positive definite, and 0 wherever neither of two is on the other's way to the root.
    """
    above: list[tuple[int, ...]] = []
    for parent in parents:
        above.append(() if parent < 0 else (*above[parent], int(parent)))

    def elements(matrix: jax.Array, vector: jax.Array) -> jax.Array:
        h = {(k, i): matrix[k, i] for k in range(len(above)) for i in (*above[k], k)}
        x = [vector[k] for k in range(len(above))]
        for k in reversed(range(len(above))):
            inverse = 1.0 / h[k, k]
            for i in above[k]:
                share = h[k, i] * inverse
                for j in (*above[i], i):
                    h[i, j] = h[i, j] - share * h[k, j]
                x[i] = x[i] - share * x[k]
            for i in above[k]:
                h[k, i] = h[k, i] * inverse  # of L
            x[k] = x[k] * inverse
        for k in range(len(above)):
            for i in above[k]:
                x[k] = x[k] - h[k, i] * x[i]
        return jnp.stack(x)

    solve = custom_vmap(elements)

    @solve.def_vmap
    def _(size: int, batched: list[bool], matrix: jax.Array, vector: jax.Array):
        matrix, vector = (value if own else jnp.broadcast_to(value, (size, *value.shape))
                          for value, own in zip((matrix, vector), batched, strict=True))  # fmt: skip
        return elements(jnp.moveaxis(matrix, 0, -1), jnp.moveaxis(vector, 0, -1)).T, True

    return solve
