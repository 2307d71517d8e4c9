"""Functions rewritten so that XLA compiles a loop around them into one kernel.

On a CPU it does so only if nothing in the loop needs its runtime (`eairl_jax.experiments.cli.configure_jax` sets how large such a
loop may be): then a physics step of many small operations is one call instead of hundreds. MJX sums over a body's
children, and inserts into vectors, by scatters.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core

# Parameters that hold what a call is made of, and of which calls.
CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "custom_jvp_call": "call_jaxpr"}


def without_scatters(function: Callable) -> Callable:
    """The same function of arrays, with gathers for its scatters; one at places that depend on the arguments stays."""

    @functools.wraps(function)
    def rewritten(*args):
        jaxpr, shape = jax.make_jaxpr(function, return_shape=True)(*args)
        # What does not depend on the arguments is computed here and now, in whatever this is traced.
        indices = iter(jax.device_get(jax.jit(lambda: _indices(jaxpr)).lower().compile()()))
        leaves = _evaluate(jaxpr, jax.tree.leaves(args), indices)
        return jax.tree.unflatten(jax.tree.structure(shape), leaves)

    return rewritten


class _Unknown:
    """Stands for a value that depends on the arguments."""


UNKNOWN = _Unknown()


def _indices(jaxpr: core.ClosedJaxpr) -> list[jax.Array]:
    """The indices of each scatter at known places, in the order of evaluation."""
    found: list[jax.Array] = []

    def run(jaxpr: core.ClosedJaxpr, args: list) -> list:
        def equation(eqn, inputs):
            inner = _called(eqn)
            if inner is not None:
                return run(inner, inputs)
            if _is_static_scatter(eqn, inputs):
                found.append(inputs[1])
            if any(value is UNKNOWN for value in inputs):
                return [UNKNOWN] * len(eqn.outvars)
            return _bind(eqn, inputs)

        return _walk(jaxpr, args, equation)

    run(jaxpr, [UNKNOWN] * len(jaxpr.jaxpr.invars))
    return found


def _evaluate(jaxpr: core.ClosedJaxpr, args: list, indices: Iterator[np.ndarray]) -> list:
    """The outputs of a function, given the indices of each scatter at known places."""
    # Which values are known is found out again, so that both walks agree.
    known = {True: True, False: UNKNOWN}

    def run(jaxpr: core.ClosedJaxpr, args: list[tuple[Any, bool]]) -> list[tuple[Any, bool]]:
        def equation(eqn, inputs):
            inner = _called(eqn)
            if inner is not None:
                return run(inner, inputs)
            values, is_known = [value for value, _ in inputs], [each for _, each in inputs]
            if _is_static_scatter(eqn, [known[each] for each in is_known]):
                return [(_apply(eqn, values, next(indices)), all(is_known))]
            return [(value, all(is_known)) for value in _bind(eqn, values)]

        return _walk(jaxpr, args, equation, lambda constant: (constant, True))

    return [value for value, _ in run(jaxpr, [(arg, False) for arg in args])]


def _walk(jaxpr: core.ClosedJaxpr, args: list, equation: Callable, constant: Callable = lambda value: value) -> list:
    """Evaluates a function equation by equation."""
    values = dict(zip(jaxpr.jaxpr.constvars, map(constant, jaxpr.consts), strict=True))
    values |= dict(zip(jaxpr.jaxpr.invars, args, strict=True))

    def read(variable):
        return constant(variable.val) if isinstance(variable, core.Literal) else values[variable]

    for eqn in jaxpr.jaxpr.eqns:
        outputs = equation(eqn, [read(variable) for variable in eqn.invars])
        values |= dict(zip(eqn.outvars, outputs, strict=True))
    return [read(variable) for variable in jaxpr.jaxpr.outvars]


def _called(eqn) -> core.ClosedJaxpr | None:
    return eqn.params[CALLS[eqn.primitive.name]] if eqn.primitive.name in CALLS else None


def _bind(eqn, inputs: list) -> list:
    outputs = eqn.primitive.bind(*inputs, **eqn.primitive.get_bind_params(eqn.params))
    return outputs if eqn.primitive.multiple_results else [outputs]


def _is_static_scatter(eqn, inputs: list) -> bool:
    if eqn.primitive.name not in ("scatter", "scatter-add"):
        return False
    # One that is known altogether is a constant, which the compiler takes out of the loop.
    return inputs[1] is not UNKNOWN and any(value is UNKNOWN for value in inputs)


def _targets(eqn, indices: np.ndarray) -> np.ndarray:
    """Where in the flat operand each element of the flat updates goes, `[updates]`."""
    operand, _, updates = (variable.aval for variable in eqn.invars)
    numbers = eqn.params["dimension_numbers"]
    element = np.indices(updates.shape)
    batch = [element[d] for d in range(updates.ndim) if d not in numbers.update_window_dims]
    place = [np.zeros(updates.shape, int) for _ in operand.shape]
    for column, dim in enumerate(numbers.scatter_dims_to_operand_dims):
        place[dim] = indices[(*batch, column)]
    for dim, of_indices in zip(numbers.operand_batching_dims, numbers.scatter_indices_batching_dims, strict=True):
        place[dim] = batch[of_indices]
    gone = {*numbers.inserted_window_dims, *numbers.operand_batching_dims}
    window = [dim for dim in range(operand.ndim) if dim not in gone]
    for dim, of_updates in zip(window, numbers.update_window_dims, strict=True):
        place[dim] = place[dim] + element[of_updates]
    return np.ravel_multi_index(tuple(place), operand.shape).ravel()


def _apply(eqn, values: list, indices: np.ndarray) -> jax.Array:
    operand, _, updates = values
    targets = _targets(eqn, indices)
    if eqn.primitive.name == "scatter":
        source = np.arange(operand.size)
        source[targets] = operand.size + np.arange(updates.size)
        return jnp.concatenate([operand.ravel(), updates.ravel()])[source].reshape(operand.shape)
    # The first of the updates that each element gets, the second, ...; a 0 where there is none any more.
    order = [[u for u, target in enumerate(targets) if target == place] for place in range(operand.size)]
    most = max(map(len, order))
    source = np.array([own + [updates.size] * (most - len(own)) for own in order]).T
    flat = jnp.append(updates.ravel(), jnp.zeros((), operand.dtype))
    return operand + flat[source].sum(axis=0).reshape(operand.shape)
