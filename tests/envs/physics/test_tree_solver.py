"""Linear systems with a tree in them, beside NumPy's solver."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eairl_jax import envs
from eairl_jax.envs.physics.contact_solver import deepest
from eairl_jax.envs.physics.tree_solver import tree_solver


def matrices(parents, batch, seed):
    """Well-conditioned matrices `[batch, n, n]` with the tree's zeros."""
    n, rng = len(parents), np.random.default_rng(seed)
    lower = np.eye(n)[None] + np.zeros((batch, 1, 1))
    for k in range(n):
        i = parents[k]
        while i >= 0:
            lower[:, k, i] = rng.normal(size=batch)
            i = parents[i]
    scale = rng.uniform(0.5, 2.0, size=(batch, n, 1))
    return np.swapaxes(lower, 1, 2) @ (scale * lower)


@st.composite
def trees(draw):
    n = draw(st.integers(1, 7))
    return [draw(st.integers(-1, k - 1)) for k in range(n)]


@settings(max_examples=15, deadline=None)
@given(parents=trees(), seed=st.integers(0, 1000))
def test_any_tree(parents, seed):
    matrix = matrices(parents, 3, seed)
    vector = np.random.default_rng(seed).normal(size=(3, len(parents)))
    expected = np.linalg.solve(matrix, vector[..., None])[..., 0]
    solution = jax.vmap(tree_solver(parents))(jnp.asarray(matrix), jnp.asarray(vector))
    np.testing.assert_allclose(solution, expected, rtol=2e-3, atol=2e-3)


def test_one_system_many_and_many_in_many():
    parents = [-1, 0, 1, 1, 0]
    matrix, vector = jnp.asarray(matrices(parents, 4, 0)), jnp.arange(20.0).reshape(4, 5)
    solve = tree_solver(parents)
    each = jnp.stack([solve(m, v) for m, v in zip(matrix, vector, strict=True)])
    np.testing.assert_allclose(jax.vmap(solve)(matrix, vector), each, rtol=1e-5)
    nested = jax.vmap(jax.vmap(solve))(matrix.reshape(2, 2, 5, 5), vector.reshape(2, 2, 5))
    np.testing.assert_allclose(nested.reshape(4, 5), each, rtol=1e-5)
    shared = jax.vmap(solve, in_axes=(None, 0))(matrix[0], vector)
    np.testing.assert_allclose(shared, jax.vmap(lambda v: solve(matrix[0], v))(vector), rtol=1e-5)


@pytest.mark.parametrize("task", ["ant", "half_cheetah"])
def test_what_touches_the_floor_adds_no_entries_to_a_walkers_tree(task):
    env = envs.make(task)
    model = env.model
    joined = np.eye(model.nv, dtype=bool)
    for k in range(model.nv):
        i = model.dof_parentid[k]
        while i >= 0:
            joined[k, i] = joined[i, k] = True
            i = model.dof_parentid[i]
    assert len(env._constraints.moved_by) > 0
    for moved_by in env._constraints.moved_by > 0:
        assert joined[np.ix_(moved_by, moved_by)].all()


def test_the_deepest_are_top_ks():
    depth = jnp.array([0.1, -1.0, 0.5, 0.5, 0.3])
    chosen = deepest(depth, 3)
    np.testing.assert_array_equal(chosen.argmax(axis=1), jax.lax.top_k(depth, 3)[1])
    np.testing.assert_array_equal(chosen.sum(axis=1), 1)
