"""The tasks in the C engine: a second opinion on what a policy scores in MJX."""

from __future__ import annotations

import copy
import tempfile
from pathlib import Path
from typing import Any, Protocol

import mujoco
import numpy as np

from eairl_jax.envs.mjx_task import MjxTask, Physics


class CEngine(Protocol):
    """One environment of a task outside of jax."""

    def start(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Begins an episode at positions `[nq]` and velocities `[nv]`; returns the observation `[obs]`."""
        ...

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float]:
        """Executes an action `[act]` within its limits; returns the observation `[obs]` after it and the reward."""
        ...


class MujocoCEngine:
    """`mujoco.mj_step` on a task's own model, its solver run until it converges; observation and reward the task's."""

    def __init__(self, task: MjxTask):
        self._task = task
        self._model = copy.copy(task.model)
        self._model.opt.iterations, self._model.opt.ls_iterations, self._model.opt.tolerance = 100, 50, 1e-8
        self._data = mujoco.MjData(self._model)

    def start(self, qpos, qvel):
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:], self._data.qvel[:] = qpos, qvel
        return np.asarray(self._task.observe(self._physics()))

    def step(self, action):
        before = self._physics()
        self._data.ctrl[:] = action
        mujoco.mj_step(self._model, self._data, nstep=self._task.frame_skip)
        after = self._physics()
        return np.asarray(self._task.observe(after)), float(self._task.reward(before, action, after))

    def _physics(self):
        data = self._data
        return Physics(data.qpos.copy(), data.qvel.copy(), data.qacc_warmstart.copy())  # pyright: ignore


class GymnasiumCEngine:
    """One of Gymnasium's MuJoCo environments on a model of ours; observation and reward are Gymnasium's own.

    Args:
      name: of the environment, for example "Ant-v5".
      spec: the compiled model.
      bonus: what Gymnasium pays at every step and the task does not.
      **settings: of the environment.
    """

    def __init__(self, name: str, spec: mujoco.MjSpec, bonus: float = 0.0, **settings: Any):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "model.xml"
            path.write_text(spec.to_xml(), encoding="utf-8")
            self._make(name, bonus, xml_file=str(path), **settings)

    def _make(self, name: str, bonus: float = 0.0, **settings: Any) -> None:
        import gymnasium

        self._env: Any = gymnasium.make(name, **settings).unwrapped
        self._bonus = bonus

    def start(self, qpos, qvel):
        self._env.reset()
        self._put(np.asarray(qpos, float), np.asarray(qvel, float))
        return self._env._get_obs()

    def _put(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        self._env.set_state(qpos, qvel)

    def step(self, action):
        obs, reward, *_ = self._env.step(np.asarray(action))
        return obs, float(reward) - self._bonus


class PendulumCEngine(GymnasiumCEngine):
    """Gymnasium's Pendulum-v1, which integrates its equations itself."""

    def __init__(self):
        self._make("Pendulum-v1")

    def _put(self, qpos, qvel):
        self._env.state = np.concatenate([qpos, qvel])
