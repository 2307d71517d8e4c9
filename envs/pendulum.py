"""Gymnasium's Pendulum-v1: swing a rod up and hold it there."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco

from eairl_jax.envs.mjx_task import Camera, GymnasiumTask, MjxTask, Physics

MAX_SPEED = 8.0  # rad/s

# A rod of mass m = 1 kg and length l = 1 m turns about one end. Its moment of inertia is m l^2 / 12 about its centre of
# mass (half way up), which is m l^2 / 3 about the hinge. At angle 0 the rod stands upright.
MJCF = """
<mujoco>
  <option timestep="0.05" gravity="0 0 -10" integrator="Euler">
    <flag constraint="disable"/>
  </option>
  <worldbody>
    <body name="rod">
      <joint name="hinge" type="hinge" axis="0 1 0"/>
      <inertial pos="0 0 0.5" mass="1" diaginertia="0.0833333333 0.0833333333 0.0833333333"/>
      <geom name="rod" type="capsule" fromto="0 0 0 0 0 1" size="0.05" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="torque" joint="hinge" ctrllimited="true" ctrlrange="-2 2"/>
  </actuator>
</mujoco>
"""


def wrap_angle(angle: jax.Array) -> jax.Array:
    """Maps an angle (rad) to [-pi, pi)."""
    return (angle + jnp.pi) % (2 * jnp.pi) - jnp.pi


class Pendulum(MjxTask):
    """Gymnasium's Pendulum-v1, step for step: swing a rod up and hold it upright.

    Observation (3):

    | index | quantity          | unit  | range    |
    |-------|-------------------|-------|----------|
    | 0     | cos(angle)        | -     | [-1, 1]  |
    | 1     | sin(angle)        | -     | [-1, 1]  |
    | 2     | angular velocity  | rad/s | [-8, 8]  |

    Action (1): torque at the hinge, N m, clipped to [-2, 2].

    Reward: `-(angle^2 + 0.1 velocity^2 + 0.001 torque^2)` of the state before the step, the angle measured from upright
    in [-pi, pi).

    Start: angle uniform in [-pi, pi) rad, angular velocity uniform in [-1, 1) rad/s.

    End: none before the time limit of 200 steps of 0.05 s.

    Differences from Gymnasium: none but rounding (float32).
    """

    episode_length = 200
    action_limit = 2.0
    camera = Camera(90, 0, 4, follows=False)
    obs_mean = (0.0, 0.0, 0.0)
    obs_std = (1.0, 1.0, 4.0)
    gymnasium = GymnasiumTask("Pendulum-v1", simulates_model=False)

    def __init__(self):
        super().__init__(mujoco.MjSpec.from_string(MJCF), frame_skip=1)

    def initial(self, rng):
        angle_rng, speed_rng = jax.random.split(rng)
        angle = jax.random.uniform(angle_rng, (1,), minval=-jnp.pi, maxval=jnp.pi)
        speed = jax.random.uniform(speed_rng, (1,), minval=-1.0, maxval=1.0)
        return angle, speed

    def observe(self, physics):
        angle, speed = physics.qpos[0], physics.qvel[0]
        return jnp.stack([jnp.cos(angle), jnp.sin(angle), speed])

    def reward(self, physics, action, after):
        angle, speed = wrap_angle(physics.qpos[0]), physics.qvel[0]
        return -(angle**2 + 0.1 * speed**2 + 0.001 * action[0] ** 2)

    def substep(self, physics, ctrl):
        # Like Gymnasium: integrate the speed, clip the speed, then integrate the angle with the clipped speed.
        speed = jnp.clip(super().substep(physics, ctrl).qvel, -MAX_SPEED, MAX_SPEED)
        return Physics(physics.qpos + self.dt * speed, speed, physics.qacc_warmstart)
