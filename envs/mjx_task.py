"""What every MJX task shares: the model, the frame skip and the little state that physics carries."""

from __future__ import annotations

import contextlib
import io
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

with contextlib.redirect_stdout(io.StringIO()):  # both print about an optional package that we do not use
    from brax.envs.base import Env, State
    from mujoco import mjx

from eairl_jax.envs.visuals import dress

if TYPE_CHECKING:
    from eairl_jax.envs.c_engine import CEngine


class Camera(NamedTuple):
    """From where a task is looked at.

    Attributes:
      azimuth, elevation: of the line of sight, degrees.
      distance: from what is looked at, m.
      follows: whether that is the first body, or the middle of the model.
    """

    azimuth: float
    elevation: float
    distance: float
    follows: bool

    def offset(self) -> np.ndarray:
        """From what is looked at to the camera, `[3]`, m."""
        a, e = np.radians([self.azimuth, self.elevation])
        return -self.distance * np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


@struct.dataclass
class Physics:
    """All that one physics step hands to the next; the rest of `mjx.Data` is derived from it.

    Attributes:
      qpos: `[nq]` positions (m, rad).
      qvel: `[nv]` velocities (m/s, rad/s).
      qacc_warmstart: `[nv]` the constraint solver's starting point (m/s^2, rad/s^2).
    """

    qpos: jax.Array
    qvel: jax.Array
    qacc_warmstart: jax.Array


class TaskError(ValueError):
    """Raised for a task that cannot be made as asked; the message says what can be."""


class MjxTask(Env):
    """A brax environment over one MuJoCo model that never ends before its time limit.

    A task gives a model and three functions: `initial` draws the first physics state, `observe` reads a
    physics state, `reward` scores the action executed in one physics state that led to another.

    Attributes:
      spec, model: the `mujoco.MjSpec` and the model that it compiles to, for the C engine and for viewers.
      episode_length: steps in an episode; the caller enforces it (`done` is always 0).
      action_limit: actions are clipped to [-action_limit, action_limit] before they are executed.
      camera: from where to look at it.
      obs_mean, obs_std: `[obs]` centre and scale of the task's *whole* state space, wherever an expert goes.
    """

    episode_length: int
    action_limit: float = 1.0
    camera: Camera
    obs_mean: tuple[float, ...]
    obs_std: tuple[float, ...]

    def __init__(self, spec: mujoco.MjSpec, frame_skip: int):
        dress(spec)
        self.spec = spec
        self.model = spec.compile()
        self.frame_skip = frame_skip
        self._mjx_model = mjx.put_model(self.model)
        self._blank = mjx.make_data(self._mjx_model)

    def initial(self, rng: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Draws `(qpos [nq], qvel [nv])` of a new episode."""
        raise NotImplementedError

    def observe(self, physics: Physics) -> jax.Array:
        """Reads the observation `[obs]` of a physics state."""
        raise NotImplementedError

    def reward(self, physics: Physics, action: jax.Array, after: Physics) -> jax.Array:
        """Scores the (clipped) action `[act]` executed in `physics`, a step before `after`; a scalar."""
        raise NotImplementedError

    def substep(self, physics: Physics, ctrl: jax.Array) -> Physics:
        """One `mjx.step` of `model.opt.timestep` seconds."""
        data = self._blank.replace(
            qpos=physics.qpos, qvel=physics.qvel, qacc_warmstart=physics.qacc_warmstart, ctrl=ctrl
        )
        data = mjx.step(self._mjx_model, data)
        return Physics(data.qpos, data.qvel, data.qacc_warmstart)

    def referee(self) -> CEngine:
        """One environment of this task in the C engine, with every iteration that its solver needs."""
        from eairl_jax.envs.c_engine import MujocoCEngine  # which builds on this module

        return MujocoCEngine(self)

    def reset(self, rng: jax.Array) -> State:
        """Starts an episode. No physics is computed, so a reset costs next to nothing inside a rollout."""
        qpos, qvel = self.initial(rng)
        physics = Physics(qpos, qvel, jnp.zeros(self.model.nv))
        zero = jnp.zeros(())
        return State(pipeline_state=physics, obs=self.observe(physics), reward=zero, done=zero)  # pyright: ignore

    def step(self, state: State, action: jax.Array) -> State:
        """Clips the action, advances `frame_skip` physics steps and scores them."""
        action = jnp.clip(action, -self.action_limit, self.action_limit)
        before: Physics = state.pipeline_state  # pyright: ignore
        # A scan, not an unrolled loop: the physics is compiled once instead of frame_skip times.
        after, _ = jax.lax.scan(
            lambda physics, _: (self.substep(physics, action), None), before, length=self.frame_skip
        )
        reward = self.reward(before, action, after)
        return state.replace(pipeline_state=after, obs=self.observe(after), reward=reward)  # pyright: ignore

    @property
    def observation_size(self) -> int:
        return len(self.obs_mean)

    @property
    def action_size(self) -> int:
        return self.model.nu

    @property
    def backend(self) -> str:
        return "mjx"

    @property
    def dt(self) -> float:
        """Seconds between two observations."""
        return self.model.opt.timestep * self.frame_skip
