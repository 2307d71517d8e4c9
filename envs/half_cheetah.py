"""Gymnasium's HalfCheetah: a torso on a back and a front leg, in the plane of x and z."""

from __future__ import annotations

import mujoco

from eairl_jax.envs.locomotion import Locomotion
from eairl_jax.envs.mjx_task import Camera, GymnasiumTask
from eairl_jax.envs.names import TaskError

# The density (kg/m^3) makes a total mass of 14 kg. Gymnasium's model sets the mass by `settotalmass`, which MuJoCo 4
# deprecates.
MJCF = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.01" integrator="Euler"/>
  <default>
    <geom type="capsule" size="0.046" density="660.884950077" contype="1" conaffinity="0" friction="0.4 0.1 0.1"
          solref="0.02 1" solimp="0 0.8 0.01"/>
    <joint type="hinge" axis="0 1 0" armature="0.1" limited="true" solreflimit="0.02 1" solimplimit="0 0.8 0.03"/>
    <motor ctrllimited="true" ctrlrange="-1 1"/>
    <default class="root">
      <joint armature="0" limited="false"/>
    </default>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="40 40 40" conaffinity="1"/>
    <body name="torso" pos="0 0 0.7">
      <joint class="root" name="rootx" type="slide" axis="1 0 0"/>
      <joint class="root" name="rootz" type="slide" axis="0 0 1"/>
      <joint class="root" name="rooty"/>
      <geom name="torso" fromto="-0.5 0 0 0.5 0 0"/>
      <geom name="head" pos="0.6 0 0.1" axisangle="0 1 0 0.87" size="0.046 0.15"/>
      <body name="bthigh" pos="-0.5 0 0">
        <joint name="bthigh" range="-0.52 1.05" damping="6" stiffness="240"/>
        <geom name="bthigh" pos="0.1 0 -0.13" axisangle="0 1 0 -3.8" size="0.046 0.145"/>
        <body name="bshin" pos="0.16 0 -0.25">
          <joint name="bshin" range="-0.785 0.785" damping="4.5" stiffness="180"/>
          <geom name="bshin" pos="-0.14 0 -0.07" axisangle="0 1 0 -2.03" size="0.046 0.15"/>
          <body name="bfoot" pos="-0.28 0 -0.14">
            <joint name="bfoot" range="-0.4 0.785" damping="3" stiffness="120"/>
            <geom name="bfoot" pos="0.03 0 -0.097" axisangle="0 1 0 -0.27" size="0.046 0.094"/>
          </body>
        </body>
      </body>
      <body name="fthigh" pos="0.5 0 0">
        <joint name="fthigh" range="-1 0.7" damping="4.5" stiffness="180"/>
        <geom name="fthigh" pos="-0.07 0 -0.12" axisangle="0 1 0 0.52" size="0.046 0.133"/>
        <body name="fshin" pos="-0.14 0 -0.24">
          <joint name="fshin" range="-1.2 0.87" damping="3" stiffness="120"/>
          <geom name="fshin" pos="0.065 0 -0.09" axisangle="0 1 0 -0.6" size="0.046 0.106"/>
          <body name="ffoot" pos="0.13 0 -0.18">
            <joint name="ffoot" range="-0.5 0.5" damping="1.5" stiffness="60"/>
            <geom name="ffoot" pos="0.045 0 -0.07" axisangle="0 1 0 -0.6" size="0.046 0.07"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="bthigh" joint="bthigh" gear="120"/>
    <motor name="bshin" joint="bshin" gear="90"/>
    <motor name="bfoot" joint="bfoot" gear="60"/>
    <motor name="fthigh" joint="fthigh" gear="120"/>
    <motor name="fshin" joint="fshin" gear="60"/>
    <motor name="ffoot" joint="ffoot" gear="30"/>
  </actuator>
</mujoco>
"""


class HalfCheetah(Locomotion):
    """Gymnasium's HalfCheetah-v5 for 500 steps: a torso on two legs in the plane of x and z.

    Observation (17):

    | index | quantity                   | unit  | range           |
    |-------|----------------------------|-------|-----------------|
    | 0     | position of rootz          | m     | any             |
    | 1     | angle of rooty             | rad   | any             |
    | 2     | angle of bthigh            | rad   | [-0.52, 1.05]   |
    | 3     | angle of bshin             | rad   | [-0.785, 0.785] |
    | 4     | angle of bfoot             | rad   | [-0.4, 0.785]   |
    | 5     | angle of fthigh            | rad   | [-1, 0.7]       |
    | 6     | angle of fshin             | rad   | [-1.2, 0.87]    |
    | 7     | angle of ffoot             | rad   | [-0.5, 0.5]     |
    | 8     | velocity of rootx          | m/s   | any             |
    | 9     | velocity of rootz          | m/s   | any             |
    | 10    | angular velocity of rooty  | rad/s | any             |
    | 11    | angular velocity of bthigh | rad/s | any             |
    | 12    | angular velocity of bshin  | rad/s | any             |
    | 13    | angular velocity of bfoot  | rad/s | any             |
    | 14    | angular velocity of fthigh | rad/s | any             |
    | 15    | angular velocity of fshin  | rad/s | any             |
    | 16    | angular velocity of ffoot  | rad/s | any             |

    Action (6): one number a motor, clipped to [-1, 1].

    | index | motor            | unit    | range   |
    |-------|------------------|---------|---------|
    | 0     | torque at bthigh | 120 N m | [-1, 1] |
    | 1     | torque at bshin  | 90 N m  | [-1, 1] |
    | 2     | torque at bfoot  | 60 N m  | [-1, 1] |
    | 3     | torque at fthigh | 120 N m | [-1, 1] |
    | 4     | torque at fshin  | 60 N m  | [-1, 1] |
    | 5     | torque at ffoot  | 30 N m  | [-1, 1] |

    Reward: `forward velocity - control_cost |action|^2`, the velocity being the torso's displacement along x over the
    time of the step (m/s).

    Start: positions uniform within 0.1 (m, rad) of the model's, velocities normal with std 0.1 (m/s, rad/s).

    End: none before the time limit of 500 steps of 0.05 s.

    Differences from Gymnasium: 500 steps instead of 1000.

    Args:
      fidelity: "fast" or "exact"; see `locomotion.py`. Both take Euler steps, like Gymnasium.
      control_cost: weight of `|action|^2` in the reward, from 0 to 100. Experts of another weight have another gait.

    Raises:
      TaskError: for an unknown fidelity, or another weight.
    """

    first_observed = 1
    camera = Camera(90, -10, 3.5, follows=True)
    obs_mean = (0.0,) * 17
    obs_std = (0.2, 1.0, *(0.4,) * 6, 4.0, 1.0, 3.0, *(10.0,) * 6)

    def __init__(self, fidelity: str = "fast", control_cost: float = 0.1):
        if not (type(control_cost) in (int, float) and 0 <= control_cost <= 100):
            raise TaskError(f"control_cost = {control_cost!r}: expected a weight of |action|^2, from 0 to 100")
        self.control_cost = float(control_cost)
        self.gymnasium = GymnasiumTask("HalfCheetah-v5", dict(ctrl_cost_weight=self.control_cost))
        super().__init__(mujoco.MjSpec.from_string(MJCF), frame_skip=5, fidelity=fidelity)
