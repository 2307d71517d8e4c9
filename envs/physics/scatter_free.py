"""Functions rewritten without scatters, so that XLA compiles a loop around them into one kernel.

Problem: on a CPU XLA compiles a loop into one kernel only if nothing in the loop calls XLA's runtime, and a scatter
does. MJX sums over the children of a body, and inserts into vectors, by scatters. (How large such a loop may be is set
by `eairl_jax.experiments.cli.configure_jax`.) A physics step of many small operations is then one call instead of
hundreds.

Idea: nearly all scatters write to places that do not depend on the arguments. Then it is clear while tracing which
update each element gets, and a gather does the same.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core

# The primitives that call a function, and the parameter of each primitive that holds the function.
CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "custom_jvp_call": "call_jaxpr"}


def without_scatters(function: Callable) -> Callable:
    """Returns the same function of pytrees of arrays, with gathers in place of its scatters.

    A scatter stays if its indices depend on the arguments.
    """

    @functools.wraps(function)
    def rewritten(*args):
        jaxpr, shape = jax.make_jaxpr(function, return_shape=True)(*args)
        # The indices do not depend on the arguments. They are computed now, even while an outer function is traced.
        indices = iter(jax.device_get(jax.jit(lambda: _indices(jaxpr)).lower().compile()()))
        leaves = _evaluate(jaxpr, jax.tree.leaves(args), indices)
        return jax.tree.unflatten(jax.tree.structure(shape), leaves)

    return rewritten


class _Unknown:
    """Stands for a value that depends on the arguments."""


UNKNOWN = _Unknown()


def _indices(jaxpr: core.ClosedJaxpr) -> list[jax.Array]:
    """The indices of each scatter whose indices do not depend on the arguments, in the order of evaluation."""
    indices: list[jax.Array] = []

    def run(jaxpr: core.ClosedJaxpr, args: list) -> list:
        def equation(eqn, inputs):
            inner = _called(eqn)
            if inner is not None:
                return run(inner, inputs)
            if _is_static_scatter(eqn, inputs):
                indices.append(inputs[1])
            if any(value is UNKNOWN for value in inputs):
                return [UNKNOWN] * len(eqn.outvars)
            return _bind(eqn, inputs)

        return _walk(jaxpr, args, equation)

    run(jaxpr, [UNKNOWN] * len(jaxpr.jaxpr.invars))
    return indices


def _evaluate(jaxpr: core.ClosedJaxpr, args: list, indices: Iterator[np.ndarray]) -> list:
    """The outputs of a function, with a gather for each scatter whose indices are listed in `indices`.

    Each value is a pair: the value, and whether the value is known, that is, does not depend on the arguments. The same
    rule as in `_indices` decides, so both walks meet the same scatters in the same order.
    """
    marks = {True: True, False: UNKNOWN}

    def run(jaxpr: core.ClosedJaxpr, args: list[tuple[Any, bool]]) -> list[tuple[Any, bool]]:
        def equation(eqn, inputs):
            inner = _called(eqn)
            if inner is not None:
                return run(inner, inputs)
            values, is_known = [value for value, _ in inputs], [each for _, each in inputs]
            if _is_static_scatter(eqn, [marks[each] for each in is_known]):
                return [(_gather(eqn, values, next(indices)), all(is_known))]
            return [(value, all(is_known)) for value in _bind(eqn, values)]

        return _walk(jaxpr, args, equation, lambda constant: (constant, True))

    return [value for value, _ in run(jaxpr, [(arg, False) for arg in args])]


def _walk(jaxpr: core.ClosedJaxpr, args: list, equation: Callable, constant: Callable = lambda value: value) -> list:
    """Evaluates a function: `equation(eqn, inputs)` gives the outputs of each of its equations."""
    values = dict(zip(jaxpr.jaxpr.constvars, map(constant, jaxpr.consts), strict=True))
    values |= dict(zip(jaxpr.jaxpr.invars, args, strict=True))

    def read(variable):
        return constant(variable.val) if isinstance(variable, core.Literal) else values[variable]

    for eqn in jaxpr.jaxpr.eqns:
        outputs = equation(eqn, [read(variable) for variable in eqn.invars])
        values |= dict(zip(eqn.outvars, outputs, strict=True))
    return [read(variable) for variable in jaxpr.jaxpr.outvars]


def _called(eqn) -> core.ClosedJaxpr | None:
    """The function that an equation calls, if it calls one."""
    return eqn.params[CALLS[eqn.primitive.name]] if eqn.primitive.name in CALLS else None


def _bind(eqn, inputs: list) -> list:
    outputs = eqn.primitive.bind(*inputs, **eqn.primitive.get_bind_params(eqn.params))
    return outputs if eqn.primitive.multiple_results else [outputs]


def _is_static_scatter(eqn, inputs: list) -> bool:
    """Whether an equation is a scatter with known indices into, or of, values that depend on the arguments."""
    if eqn.primitive.name not in ("scatter", "scatter-add"):
        return False
    # If operand, indices and updates are all known, the result is a constant, which the compiler moves out of the loop.
    return inputs[1] is not UNKNOWN and any(value is UNKNOWN for value in inputs)


def _targets(eqn, indices: np.ndarray) -> np.ndarray:
    """The place in the flat operand of each element of the flat updates, `[updates]`.

    See "Scatter" in https://openxla.org/xla/operation_semantics for the dimension numbers.
    """
    operand, _, updates = (variable.aval for variable in eqn.invars)
    numbers = eqn.params["dimension_numbers"]
    element = np.indices(updates.shape)
    batch = [element[d] for d in range(updates.ndim) if d not in numbers.update_window_dims]
    place = [np.zeros(updates.shape, int) for _ in operand.shape]
    for column, dim in enumerate(numbers.scatter_dims_to_operand_dims):
        place[dim] = indices[(*batch, column)]
    for dim, indices_dim in zip(numbers.operand_batching_dims, numbers.scatter_indices_batching_dims, strict=True):
        place[dim] = batch[indices_dim]
    not_in_window = {*numbers.inserted_window_dims, *numbers.operand_batching_dims}
    window = [dim for dim in range(operand.ndim) if dim not in not_in_window]
    for dim, updates_dim in zip(window, numbers.update_window_dims, strict=True):
        place[dim] = place[dim] + element[updates_dim]
    return np.ravel_multi_index(tuple(place), operand.shape).ravel()


def _gather(eqn, values: list, indices: np.ndarray) -> jax.Array:
    """The output of a scatter at known indices, by a gather."""
    operand, _, updates = values
    targets = _targets(eqn, indices)
    if eqn.primitive.name == "scatter":
        source = np.arange(operand.size)
        source[targets] = operand.size + np.arange(updates.size)
        return jnp.concatenate([operand.ravel(), updates.ravel()])[source].reshape(operand.shape)
    # Row k holds the index of the k-th update of each element, or the index of an appended 0.
    updates_of = [[u for u, target in enumerate(targets) if target == place] for place in range(operand.size)]
    most = max(map(len, updates_of))
    source = np.array([each + [updates.size] * (most - len(each)) for each in updates_of]).T
    flat = jnp.append(updates.ravel(), jnp.zeros((), operand.dtype))
    return operand + flat[source].sum(axis=0).reshape(operand.shape)
