"""The table of tasks. A new task is a file in this folder and a row here."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from functools import partial
from types import MappingProxyType

from envs.mjx_task import MjxTask
from envs.pendulum import Pendulum
from envs.point_maze import PointMaze

TASKS: MappingProxyType[str, Callable[..., MjxTask]] = MappingProxyType(
    {
        "pendulum": Pendulum,
        "point_maze_left": partial(PointMaze, passage="left"),
        "point_maze_right": partial(PointMaze, passage="right"),
    }
)


class UnknownTask(ValueError):
    """Raised for a name that is not in `TASKS`; the message gives the nearest ones."""


def make(name: str, **settings) -> MjxTask:
    """Builds a task by name.

    Args:
      name: a key of `TASKS`.
      **settings: passed to the task (for example `solver_iterations=100`).

    Raises:
      UnknownTask: if there is no such task.
    """
    if name not in TASKS:
        nearest = difflib.get_close_matches(name, TASKS, n=3, cutoff=0.3) or list(TASKS)
        raise UnknownTask(f"unknown task {name!r}; did you mean {', '.join(nearest)}? All tasks: {', '.join(TASKS)}")
    return TASKS[name](**settings)
