"""The tasks: MuJoCo models simulated by MJX, behind the interface of `brax.envs.Env`. Nothing here knows an algorithm.

env = envs.make("pendulum")  # or "brax:hopper", "playground:CheetahRun", "my_tasks.py:make_env"
state = env.reset(jax.random.PRNGKey(0))
state = env.step(state, action)
"""

from eairl_jax.envs.foreign import ForeignTask, UnfitEnvironment, adapt
from eairl_jax.envs.mjx_task import Task, TaskError
from eairl_jax.envs.registry import TASKS, UnknownTask, make

__all__ = ["TASKS", "ForeignTask", "Task", "TaskError", "UnfitEnvironment", "UnknownTask", "adapt", "make"]
