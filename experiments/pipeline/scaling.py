"""How the time and the memory of an iteration grow with a setting, and the law that fits them."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from eairl_jax import InputError
from eairl_jax.experiments.pipeline import stages
from eairl_jax.experiments.pipeline.experiment import Experiment

SEEDS = "seeds"
ROUNDS = 3


class Axis(NamedTuple):
    """A number that is varied: `SEEDS`, or a whole number of the settings.

    Attributes:
      name: of the number.
      values: in rising order.
    """

    name: str
    values: tuple[int, ...]


class Point(NamedTuple):
    """What is measured at one value.

    Attributes:
      value: of the axis.
      seconds: an iteration of all seeds, the median over `ROUNDS`.
      env_steps: of all seeds in an iteration.
      states_gb: memory of the states of all seeds, their histories included.
      beside_gb: what the iterations need beside them, by XLA.
      compile_seconds: that compiling took.
    """

    value: int
    seconds: float
    env_steps: int
    states_gb: float
    beside_gb: float
    compile_seconds: float


class Law(NamedTuple):
    """`seconds = fixed + each * value`.

    Attributes:
      fixed, each: at least 0.
      deviation: the largest difference between the law and a measurement, as a share of the measurement.
    """

    fixed: float
    each: float
    deviation: float


def axis(text: str) -> Axis:
    """Reads "num_envs=16,64,256".

    Raises:
      InputError: unless it is a name and at least two different whole numbers above 0.
    """
    name, _, numbers = text.partition("=")
    try:
        values = tuple(sorted({int(number) for number in numbers.split(",")}))
    except ValueError:
        values = ()
    if not name or len(values) < 2 or values[0] < 1:
        raise InputError(
            f"--scale {text}: expected a name and at least two whole numbers, for example num_envs=16,64 or seeds=1,4"
        )
    return Axis(name, values)


def experiments(along: Axis, make: Callable[[Sequence[str]], Experiment]) -> list[Experiment]:
    """The experiment at each value of an axis, everything checked.

    Args:
      make: makes an experiment with more settings, `name=value`.
    """
    if along.name == SEEDS:
        base = make(())
        return [dataclasses.replace(base, seeds=tuple(range(value))) for value in along.values]
    return [dataclasses.replace(make([f"{along.name}={value}"]), seeds=(0,)) for value in along.values]


def measured(value: int, experiment: Experiment, iterations: int) -> Point:
    """Trains an experiment for some iterations, as `eairl imitate` does, on all devices."""
    _, lanes = stages.learner(experiment)
    state = lanes.init()
    compile_seconds = lanes.compile(state, iterations)
    state, _ = lanes.run(state, iterations)  # the first call is slower
    seconds = []
    for _ in range(ROUNDS):
        started = time.perf_counter()
        state, _ = lanes.run(state, iterations)
        seconds.append((time.perf_counter() - started) / iterations)
    needed = lanes.memory(iterations)
    steps = experiment.recipe.config.steps_per_iteration * len(experiment.seeds)
    return Point(value, float(np.median(seconds)), steps, needed.states / 1e9, needed.beside / 1e9, compile_seconds)


def fitted(values: Sequence[float], seconds: Sequence[float]) -> Law:
    """The law whose relative errors have the least squares; neither of its numbers is below 0."""
    x, y = np.array(values, float), np.array(seconds, float)
    (fixed, each), _ = nnls(np.stack([1 / y, x / y], axis=1), np.ones(len(y)))
    return Law(float(fixed), float(each), float(np.abs((fixed + each * x) / y - 1).max()))
