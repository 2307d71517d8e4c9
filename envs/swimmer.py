"""Gymnasium's Swimmer: three links that swim in a plane of viscous fluid."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco

from eairl_jax.envs.locomotion import Locomotion
from eairl_jax.envs.mjx_task import Camera, GymnasiumTask

MJCF = """
<mujoco>
  <compiler angle="degree"/>
  <option timestep="0.01" integrator="RK4" density="4000" viscosity="0.1"/>
  <default>
    <geom type="capsule" size="0.1" density="1000" contype="0" conaffinity="0"/>
    <joint type="hinge" axis="0 0 1" armature="0.1"/>
    <motor ctrllimited="true" ctrlrange="-1 1" gear="150"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" pos="0 0 -0.1" size="40 40 0.1"/>
    <body name="front">
      <joint name="slider1" type="slide" axis="1 0 0"/>
      <joint name="slider2" type="slide" axis="0 1 0"/>
      <joint name="free_body_rot"/>
      <geom name="front" fromto="1.5 0 0 0.5 0 0"/>
      <body name="middle" pos="0.5 0 0">
        <joint name="motor1_rot" limited="true" range="-100 100"/>
        <geom name="middle" fromto="0 0 0 -1 0 0"/>
        <body name="back" pos="-1 0 0">
          <joint name="motor2_rot" limited="true" range="-100 100"/>
          <geom name="back" fromto="0 0 0 -1 0 0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="motor1_rot" joint="motor1_rot"/>
    <motor name="motor2_rot" joint="motor2_rot"/>
  </actuator>
</mujoco>
"""


class Swimmer(Locomotion):
    """Gymnasium's Swimmer-v5 for 500 steps: three links of 1 m swim by bending their two joints.

    Observation (8):

    | index | quantity                          | unit  | range         |
    |-------|-----------------------------------|-------|---------------|
    | 0     | angle of free_body_rot            | rad   | any           |
    | 1     | angle of motor1_rot               | rad   | [-1.75, 1.75] |
    | 2     | angle of motor2_rot               | rad   | [-1.75, 1.75] |
    | 3     | velocity of slider1               | m/s   | any           |
    | 4     | velocity of slider2               | m/s   | any           |
    | 5     | angular velocity of free_body_rot | rad/s | any           |
    | 6     | angular velocity of motor1_rot    | rad/s | any           |
    | 7     | angular velocity of motor2_rot    | rad/s | any           |

    Action (2): one number a motor, clipped to [-1, 1].

    | index | motor                | unit    | range   |
    |-------|----------------------|---------|---------|
    | 0     | torque at motor1_rot | 150 N m | [-1, 1] |
    | 1     | torque at motor2_rot | 150 N m | [-1, 1] |

    Reward: `forward velocity - 0.0001 |action|^2`, the velocity being the front's displacement along x over the time
    of the step (m/s).

    Start: positions and velocities uniform within 0.1 (m, rad, m/s, rad/s) of the model at rest.

    End: none before the time limit of 500 steps of 0.04 s.

    Differences from Gymnasium: 500 steps instead of 1000, and the integrator of fidelity "fast".

    Args:
      fidelity: "fast" (Euler steps) or "exact" (Gymnasium's Runge-Kutta steps); see `locomotion.py`.

    Raises:
      TaskError: for an unknown fidelity.
    """

    first_observed = 2
    camera = Camera(90, -50, 6, follows=True)
    control_cost = 1e-4
    gymnasium = GymnasiumTask("Swimmer-v5")
    obs_mean = (0.0,) * 8
    obs_std = (1.0, 1.0, 1.0, 0.5, 0.5, 2.0, 2.0, 2.0)

    def __init__(self, fidelity: str = "fast"):
        super().__init__(mujoco.MjSpec.from_string(MJCF), frame_skip=4, fidelity=fidelity)

    def initial(self, rng):
        noise = jax.random.uniform(rng, (self.model.nq + self.model.nv,), minval=-0.1, maxval=0.1)
        return jnp.asarray(self.model.qpos0) + noise[: self.model.nq], noise[self.model.nq :]
