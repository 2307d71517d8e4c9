"""The table of tasks. A new task is a file in this folder and a row here."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable
from functools import partial
from types import MappingProxyType

from eairl_jax.envs.ant import Ant
from eairl_jax.envs.half_cheetah import HalfCheetah
from eairl_jax.envs.mjx_task import MjxTask, TaskError
from eairl_jax.envs.pendulum import Pendulum
from eairl_jax.envs.point_maze import PointMaze
from eairl_jax.envs.swimmer import Swimmer

TASKS: MappingProxyType[str, Callable[..., MjxTask]] = MappingProxyType(
    {
        "pendulum": Pendulum,
        "point_maze_left": partial(PointMaze, passage="left"),
        "point_maze_right": partial(PointMaze, passage="right"),
        "ant": Ant,
        "crippled_ant": partial(Ant, crippled=("back_leg", "right_back_leg")),
        "half_cheetah": HalfCheetah,
        "swimmer": Swimmer,
    }
)


class UnknownTask(TaskError):
    """Raised for a name that is not in `TASKS`; the message gives the nearest ones."""


def make(name: str, **settings) -> MjxTask:
    """Builds a task by name.

    Args:
      name: a key of `TASKS`.
      **settings: passed to the task (for example `fidelity="exact"`).

    Raises:
      UnknownTask: if there is no such task.
      TaskError: if the task has no such setting, or cannot have that value.
    """
    if name not in TASKS:
        nearest = difflib.get_close_matches(name, TASKS, n=3, cutoff=0.3) or list(TASKS)
        raise UnknownTask(f"unknown task {name!r}; did you mean {', '.join(nearest)}? All tasks: {', '.join(TASKS)}")
    known = inspect.signature(TASKS[name]).parameters
    unknown = set(settings) - set(known)
    if unknown:
        raise TaskError(f"{name}: no such setting: {', '.join(sorted(unknown))}; it has {', '.join(known) or 'none'}")
    return TASKS[name](**settings)
