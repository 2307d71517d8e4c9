"""The tasks: MuJoCo models simulated by MJX, behind the interface of `brax.envs.Env`. Nothing here knows an algorithm.

env = envs.make("pendulum")
state = env.reset(jax.random.PRNGKey(0))
state = env.step(state, action)
"""

from eairl_jax.envs.mjx_task import TaskError
from eairl_jax.envs.registry import TASKS, UnknownTask, make

__all__ = ["TASKS", "TaskError", "UnknownTask", "make"]
