"""What all tasks share: the model, the clipped action, the physics steps of one action, and the state between steps."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import io
from collections.abc import Hashable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

with contextlib.redirect_stdout(io.StringIO()):  # both print a line about an optional package that is not needed here
    from brax.envs.base import Env, State
    from mujoco import mjx

from eairl_jax.envs.names import TaskError
from eairl_jax.envs.visuals import dress


class Camera(NamedTuple):
    """The point of view of a task's pictures.

    Attributes:
      azimuth, elevation: direction of the line of sight, degrees.
      distance: from the camera to the point that it looks at, m.
      follows: True: the camera looks at the first body and moves with the body. False: it looks at the model's centre.
    """

    azimuth: float
    elevation: float
    distance: float
    follows: bool

    def offset(self) -> np.ndarray:
        """The vector `[3]`, m, to the camera from the point that the camera looks at."""
        a, e = np.radians([self.azimuth, self.elevation])
        return -self.distance * np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


class GymnasiumTask(NamedTuple):
    """The environment of Gymnasium that is the same task.

    Attributes:
      name: the environment's id, for example "Ant-v5".
      settings: keyword arguments of `gymnasium.make` that make the two tasks the same.
      bonus: reward that Gymnasium pays at every step and the task does not pay.
      simulates_model: True for Gymnasium's MuJoCo environments, which simulate the task's model. False for Pendulum-v1,
        which integrates its equations without a model.
    """

    name: str
    settings: Mapping[str, Any] = MappingProxyType({})
    bonus: float = 0.0
    simulates_model: bool = True


@struct.dataclass
class Physics:
    """All that one physics step passes to the next step. The rest of `mjx.Data` follows from these arrays.

    Attributes:
      qpos: `[nq]` positions (m, rad).
      qvel: `[nv]` velocities (m/s, rad/s).
      qacc_warmstart: `[nv]` accelerations from which the constraint solver starts (m/s^2, rad/s^2).
    """

    qpos: jax.Array
    qvel: jax.Array
    qacc_warmstart: jax.Array


class Task(Env):
    """What the commands ask of an environment, beside `reset`, `step`, `observation_size` and `action_size`.

    `MjxTask` is such a task with a model of this package. `foreign.ForeignTask` makes such a task of any environment.

    Attributes:
      episode_length: steps of an episode. The caller ends the episode there.
      action_limit: actions are clipped to [-action_limit, action_limit] before they are executed.
      ends: whether the task itself can end an episode, before the time limit.
      model: the compiled model, for pictures; None if the task has no MuJoCo model.
      camera: the point of view of pictures.
      dt: seconds between two observations; None if unknown.
      gymnasium: the environment of Gymnasium that is the same task; None if Gymnasium has no such environment.
      dynamics: equal for two tasks that differ in their rewards alone, so that one simulation serves both by
        `MjxTask.rewarded`; None if that is not known of any other task.
    """

    episode_length: int
    action_limit: float = 1.0
    ends: bool = True
    model: mujoco.MjModel | None = None
    camera: Camera = Camera(azimuth=90.0, elevation=-20.0, distance=4.0, follows=False)
    gymnasium: GymnasiumTask | None = None
    dynamics: Hashable | None = None

    def qpos(self, state: Any) -> jax.Array | None:
        """The positions `[nq]` of the model in a state of the task; None if the state does not hold them."""
        raise NotImplementedError

    @property
    def dt(self) -> float | None:
        """Seconds between two observations; None if unknown."""
        return None


class MjxTask(Task):
    """A brax environment over one MuJoCo model. `done` is always 0: only the caller's time limit ends an episode.

    To write a task, derive a class from this one. `pendulum.py` is the smallest example. The class

    1. calls `super().__init__(spec, frame_skip)` with its `mujoco.MjSpec`;
    2. defines `initial` (draws the start of an episode), `observe` (reads the observation from a physics state) and
       `reward` (scores an action that led from one physics state to the next);
    3. sets the attributes `episode_length`, `camera`, `obs_mean` and `obs_std`, and where they differ from the
       defaults below, `action_limit` and `gymnasium`;
    4. has a docstring with tables of the observation and of the action, like the docstrings of the other tasks.

    Then add the class to `TASKS` in `registry.py`. The three functions must be pure: JAX traces, vectorises and
    compiles them. All motors of the model must have the control range [-action_limit, action_limit].

    Args:
      spec: the model. It gets a floor, a sky and colours (`visuals.dress`) before it is compiled.
      frame_skip: physics steps for each action; a physics step takes `model.opt.timestep` seconds.

    Attributes:
      spec, model: the `mujoco.MjSpec` and the compiled model, for the C engine and for pictures.
      ends: whether the task itself can end an episode: never.
      episode_length: steps of an episode. The caller ends the episode there.
      action_limit: actions are clipped to [-action_limit, action_limit] before they are executed.
      camera: the point of view of pictures.
      obs_mean, obs_std: `[obs]` centre and scale of observations over the *whole* state space of the task, not only
        over the states that an expert visits.
      gymnasium: the environment of Gymnasium that is the same task; None if Gymnasium has no such environment.
    """

    ends = False
    model: mujoco.MjModel
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
        """Draws the positions `[nq]` and velocities `[nv]` at the start of an episode."""
        raise NotImplementedError

    def observe(self, physics: Physics) -> jax.Array:
        """Returns the observation `[obs]` of a physics state."""
        raise NotImplementedError

    def reward(self, physics: Physics, action: jax.Array, after: Physics) -> jax.Array:
        """Returns the reward, a scalar, of the clipped action `[act]` that led from `physics` to `after`."""
        raise NotImplementedError

    def substep(self, physics: Physics, ctrl: jax.Array) -> Physics:
        """One physics step of `model.opt.timestep` seconds under the controls `[act]`, by `mjx.step`."""
        data = self._blank.replace(
            qpos=physics.qpos, qvel=physics.qvel, qacc_warmstart=physics.qacc_warmstart, ctrl=ctrl
        )
        data = mjx.step(self._mjx_model, data)
        return Physics(data.qpos, data.qvel, data.qacc_warmstart)

    def reset(self, rng: jax.Array) -> State:
        """Starts an episode. A reset computes no physics, so resets inside a rollout cost almost nothing."""
        return self._start(*self.initial(rng))

    def _start(self, qpos: jax.Array, qvel: jax.Array) -> State:
        physics = Physics(qpos, qvel, jnp.zeros(self.model.nv))
        zero = jnp.zeros(())
        return State(pipeline_state=cast(Any, physics), obs=self.observe(physics), reward=zero, done=zero)

    def step(self, state: State, action: jax.Array) -> State:
        """Clips the action `[act]`, advances `frame_skip` physics steps and computes the reward.

        A NaN in the action makes observation and reward NaN until the next reset.

        Raises:
          TaskError: if the shape of the action is not `[act]`.
        """
        if jnp.shape(action) != (self.action_size,):
            raise TaskError(
                f"action has shape {jnp.shape(action)}: expected ({self.action_size},), one number for each motor; "
                "step a batch of environments with jax.vmap(env.step)"
            )
        return self._advance(state, action)

    @functools.partial(jax.jit, static_argnums=0)  # so that JAX traces the physics once, for all programs of a process
    def _advance(self, state: State, action: jax.Array) -> State:
        action = self._executed(action)
        before = cast(Physics, state.pipeline_state)
        # A scan, not an unrolled loop: XLA compiles the physics once instead of frame_skip times.
        after, _ = jax.lax.scan(
            lambda physics, _: (self.substep(physics, action), None), before, length=self.frame_skip
        )
        shown = dataclasses.replace(state, pipeline_state=after, obs=self.observe(after))
        return self.rewarded(state, action, shown)

    def rewarded(self, before: State, action: jax.Array, after: State) -> State:
        """The state `after` with this task's reward for the action `[act]` that led to it from `before`."""
        first, last = cast(Physics, before.pipeline_state), cast(Physics, after.pipeline_state)
        return dataclasses.replace(after, reward=self.reward(first, self._executed(action), last))

    def _executed(self, action: jax.Array) -> jax.Array:
        return jnp.clip(action, -self.action_limit, self.action_limit)

    def qpos(self, state: Any) -> jax.Array:
        return state.pipeline_state.qpos

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
