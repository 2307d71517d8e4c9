"""The table of tasks by name. A new task is a file in this folder and an entry in `TASKS`."""

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
    """Raised for a name that is not in `TASKS`; the message lists the nearest names and all names."""


def make(name: str, **settings) -> MjxTask:
    """Builds a task by name.

    Args:
      name: a key of `TASKS`.
      **settings: arguments of the task's class (for example `fidelity="exact"`).

    Raises:
      UnknownTask: if `name` is not in `TASKS`.
      TaskError: if the task has no such setting, or refuses the value of a setting.
    """
    if name not in TASKS:
        nearest = difflib.get_close_matches(str(name), TASKS, n=3, cutoff=0.3) or list(TASKS)
        raise UnknownTask(f"unknown task {name!r}; did you mean {', '.join(nearest)}? All tasks: {', '.join(TASKS)}")
    accepted = list(inspect.signature(TASKS[name]).parameters)
    unknown = sorted(set(settings) - set(accepted))
    if unknown:
        choices = f"the settings of {name} are {', '.join(accepted)}" if accepted else f"{name} has no settings"
        raise TaskError(f"unknown setting of task {name}: {', '.join(unknown)}; {choices}")
    return TASKS[name](**settings)
