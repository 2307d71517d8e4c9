"""The tasks outside of JAX, mostly in MuJoCo's C engine: a second opinion on the return of a policy in MJX."""

from __future__ import annotations

import copy
import tempfile
from pathlib import Path
from typing import Any, Protocol, cast

import gymnasium
import jax
import mujoco
import numpy as np

from eairl_jax.envs.mjx_task import MjxTask, Physics


class CEngine(Protocol):
    """One environment of a task, computed outside of JAX."""

    def start(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Begins an episode at positions `[nq]` and velocities `[nv]`; returns the first observation `[obs]`."""
        ...

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float]:
        """Executes an action `[act]` within the action limit; returns the next observation `[obs]` and the reward."""
        ...


def make(task: MjxTask) -> CEngine:
    """Builds the engine of one environment of `task`.

    The engine is Gymnasium's environment if the task declares one (`task.gymnasium`). Otherwise the C engine simulates
    the task's model, and the task computes observation and reward.
    """
    if task.gymnasium is None:
        return MujocoCEngine(task)
    return (GymnasiumMujoco if task.gymnasium.simulates_model else GymnasiumPendulum)(task)


class MujocoCEngine:
    """`mujoco.mj_step` on the model of a task, with enough solver iterations to converge.

    The task computes observation and reward.
    """

    def __init__(self, task: MjxTask):
        self._task = task
        self._model = copy.copy(task.model)
        self._model.opt.iterations, self._model.opt.ls_iterations, self._model.opt.tolerance = 100, 50, 1e-8
        self._data = mujoco.MjData(self._model)

    def start(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:], self._data.qvel[:] = qpos, qvel
        return np.asarray(self._task.observe(self._physics()))

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float]:
        before = self._physics()
        self._data.ctrl[:] = action
        mujoco.mj_step(self._model, self._data, nstep=self._task.frame_skip)
        after = self._physics()
        return np.asarray(self._task.observe(after)), float(self._task.reward(before, cast(jax.Array, action), after))

    def _physics(self) -> Physics:
        data = self._data
        # NumPy arrays of float64: the task's functions take them as they take JAX's arrays.
        return Physics(*(cast(jax.Array, x.copy()) for x in (data.qpos, data.qvel, data.qacc_warmstart)))


class GymnasiumMujoco:
    """One of Gymnasium's MuJoCo environments, simulating the task's model.

    Gymnasium computes observation and reward. `bonus`, which only Gymnasium pays, is subtracted from the reward.
    """

    def __init__(self, task: MjxTask):
        assert task.gymnasium is not None
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "model.xml"
            path.write_text(task.spec.to_xml(), encoding="utf-8")
            settings = dict(xml_file=str(path), frame_skip=task.frame_skip, **task.gymnasium.settings)
            self.env: Any = gymnasium.make(task.gymnasium.name, **settings).unwrapped
        self._bonus = task.gymnasium.bonus

    def start(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        self.env.reset()
        self.env.set_state(np.asarray(qpos, float), np.asarray(qvel, float))
        return self.env._get_obs()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float]:
        obs, reward, *_ = self.env.step(np.asarray(action))
        return obs, float(reward) - self._bonus


class GymnasiumPendulum:
    """Gymnasium's Pendulum-v1, which integrates its equations in NumPy without MuJoCo."""

    def __init__(self, task: MjxTask):
        assert task.gymnasium is not None
        self.env: Any = gymnasium.make(task.gymnasium.name, **task.gymnasium.settings).unwrapped

    def start(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        self.env.reset()
        self.env.state = np.concatenate([np.asarray(qpos, float), np.asarray(qvel, float)])
        return self.env._get_obs()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float]:
        obs, reward, *_ = self.env.step(np.asarray(action))
        return obs, float(reward)
