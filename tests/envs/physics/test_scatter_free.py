"""Scatters as gathers: the same numbers, and no scatter is left where the indices are known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax.envs.physics.scatter_free import without_scatters

x = jnp.arange(12.0).reshape(3, 4)

CASES = {
    "an element": lambda v: v.at[1, 2].set(7.0),
    "a row": lambda v: v.at[1].set(v[0] * 2),
    "a window": lambda v: v.at[1:3, 1:3].set(-v[:2, :2]),
    "listed columns": lambda v: v.at[:, np.array([3, 0])].set(v[:, :2]),
    "a sum": lambda v: v.at[np.array([0, 2, 0])].add(v),
    "a segment sum": lambda v: jax.ops.segment_sum(v, np.array([1, 1, 0]), 3),
    "an insertion": lambda v: jnp.insert(v[0], 2, 9.0),
    "in a vmap": lambda v: jax.vmap(lambda row: row.at[2].set(row[0]))(v),
    "in a jit": jax.jit(lambda v: v.at[0].add(v[1])),
    "a constant one": lambda v: v * jnp.zeros((3, 4)).at[1, 2].set(7.0),
    "none": lambda v: jnp.sin(v) @ v.T,
}


@pytest.mark.parametrize("case", CASES)
def test_the_same_numbers(case):
    function = CASES[case]
    program = jax.jit(without_scatters(function)).lower(x).compile()
    np.testing.assert_allclose(program(x), function(x), rtol=1e-6)
    # The compiler computes what does not depend on the arguments, as in "a constant one".
    assert "scatter(" not in program.as_text()


def test_places_that_depend_on_the_arguments_stay_scatters():
    function = lambda v: v.at[v[0, 1].astype(int)].set(0.0)  # noqa: E731
    rewritten = without_scatters(function)
    np.testing.assert_array_equal(rewritten(x), function(x))
    assert "scatter" in str(jax.make_jaxpr(rewritten)(x))


def test_it_works_on_trees_and_under_a_vmap_of_arguments():
    function = lambda tree, y: {"a": tree["a"].at[0].set(y), "b": tree["b"].at[1].add(y)}  # noqa: E731
    tree, y = {"a": jnp.ones((5, 3)), "b": jnp.zeros((5, 3))}, jnp.arange(5.0)
    rewritten = jax.vmap(without_scatters(function))(tree, y)
    for name, expected in jax.vmap(function)(tree, y).items():
        np.testing.assert_array_equal(rewritten[name], expected)


@pytest.mark.parametrize("task", ["ant", "half_cheetah", "swimmer"])
def test_a_walkers_step_needs_nothing_of_xlas_runtime(task, compiled_step):
    text = compiled_step(task).program.as_text()
    assert "while(" in text
    for operation in ("custom-call(", "scatter(", "sort("):
        assert operation not in text
