"""Several tasks as one, from which one reward is learned: each episode is of one of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import jax
import jax.numpy as jnp
from flax import struct

from eairl_jax.envs.mjx_task import MjxTask, Task
from eairl_jax.envs.names import TaskError


@struct.dataclass
class SeveralState:
    """The state of an episode.

    Attributes:
      inner: a state for each dynamics that the tasks have. That of the episode's task is in use.
      which: `[]` the number of the episode's task.
      obs: `[obs + tasks]` the task's observation, then 1 for the episode's task and 0 for the others.
      reward, done: `[]` of the episode's task.
    """

    inner: tuple[Any, ...]
    which: jax.Array
    obs: jax.Array
    reward: jax.Array
    done: jax.Array


class SeveralTasks(Task):
    """Tasks of the same sizes as one task. Every reset draws one of them at random, each as often as the others.

    The last entries of an observation name the episode's task. So a policy, a value function and a potential can differ
    from task to task. A reward that is learned does not see these entries (`context_size`). All tasks are simulated at
    every step, and that of the episode is shown. Tasks that differ in their rewards alone (`Task.dynamics`) are
    simulated once.

    Args:
      tasks: two or more.

    Attributes:
      context_size: how many entries at the end of an observation name the task: as many as there are tasks.

    Raises:
      TaskError: if sizes of observations or actions, bounds of actions, or lengths of episodes differ.
    """

    def __init__(self, tasks: Sequence[Task]):
        for name in ("observation_size", "action_size", "action_limit", "episode_length"):
            values = [getattr(task, name) for task in tasks]
            if len(set(values)) > 1:
                raise TaskError(
                    f"several tasks as one need the same {name}, and these have {', '.join(map(str, values))}"
                )
        self.tasks = tuple(tasks)
        kinds = [getattr(task, "dynamics", None) or object() for task in tasks]
        distinct = list(dict.fromkeys(kinds))
        self._simulated = [kinds.index(kind) for kind in distinct]
        self._inner_of = [distinct.index(kind) for kind in kinds]
        self.context_size = len(tasks)
        self.action_limit, self.episode_length = tasks[0].action_limit, tasks[0].episode_length
        self.ends = any(task.ends for task in tasks)
        if all(hasattr(task, "obs_mean") and hasattr(task, "obs_std") for task in tasks):
            self.obs_mean = (*_mean([task.obs_mean for task in tasks]), *[0.0] * len(tasks))
            self.obs_std = (*_mean([task.obs_std for task in tasks]), *[1.0] * len(tasks))

    def reset(self, rng: jax.Array) -> Any:
        """Starts an episode of a task that is drawn at random."""
        which = jax.random.randint(jax.random.fold_in(rng, 1), (), 0, len(self.tasks))
        inner = tuple(self.tasks[number].reset(rng) for number in self._simulated)
        return self._shown(inner, which, [inner[place] for place in self._inner_of])

    def step(self, state: Any, action: jax.Array) -> Any:
        """Steps all tasks with the action `[act]`, and shows that of the episode."""
        tasks = [self.tasks[number] for number in self._simulated]
        inner = tuple(task.step(each, action) for task, each in zip(tasks, state.inner, strict=True))

        def shown(number: int) -> Any:
            before, after = (each[self._inner_of[number]] for each in (state.inner, inner))
            if number in self._simulated:
                return after
            return cast(MjxTask, self.tasks[number]).rewarded(before, action, after)

        return self._shown(inner, state.which, [shown(number) for number in range(len(self.tasks))])

    def qpos(self, state: Any) -> None:
        """None: there is no one model."""

    @property
    def observation_size(self) -> int:
        return cast(int, self.tasks[0].observation_size) + self.context_size

    @property
    def action_size(self) -> int:
        return self.tasks[0].action_size

    @property
    def backend(self) -> str:
        return self.tasks[0].backend

    @property
    def dt(self) -> float | None:
        """Seconds between two observations; None if the tasks differ in that."""
        (first, *others) = (task.dt for task in self.tasks)
        return first if all(each == first for each in others) else None

    def _shown(self, inner: tuple[Any, ...], which: jax.Array, states: Sequence[Any]) -> SeveralState:
        """`inner`, and what the episode's task shows.

        Args:
          states: of every task.
        """

        def of_task(name: str) -> jax.Array:
            return jnp.stack([jnp.asarray(getattr(each, name), jnp.float32) for each in states])[which]

        obs = jnp.concatenate([of_task("obs"), jax.nn.one_hot(which, len(states))])
        return SeveralState(inner, which, obs, of_task("reward"), of_task("done"))


def _mean(rows: Sequence[Sequence[float]]) -> list[float]:
    return [sum(map(float, column)) / len(rows) for column in zip(*rows, strict=True)]
