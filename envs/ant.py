"""Gymnasium's Ant with weaker motors, and variants of it with crippled legs."""

from __future__ import annotations

from collections.abc import Collection

import jax.numpy as jnp
import mujoco

from eairl_jax.envs.locomotion import Locomotion
from eairl_jax.envs.mjx_task import Camera, GymnasiumTask, TaskError

# Gymnasium's names of the legs, and the signs of x and y of each foot. The first leg has the joints `hip_1` and
# `ankle_1`, and so on.
LEGS = {"front_left_leg": (1, 1), "front_right_leg": (-1, 1), "back_leg": (-1, -1), "right_back_leg": (1, -1)}
# Gymnasium's order of the motors, which starts with the last leg.
MOTORS = [f"{joint}_{leg}" for leg in (4, 1, 2, 3) for joint in ("hip", "ankle")]
GEAR = 30.0  # N m; with Gymnasium's 150 N m the ant throws itself on its back

MJCF = """
<mujoco>
  <compiler angle="degree"/>
  <option timestep="0.01" integrator="RK4"/>
  <default>
    <geom type="capsule" size="0.08" density="5" contype="1" conaffinity="0" margin="0.01" friction="1 0.5 0.5"/>
    <joint armature="1" damping="1" limited="true"/>
    <motor ctrllimited="true" ctrlrange="-1 1" gear="{gear}"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="40 40 40" conaffinity="1"/>
    <body name="torso" pos="0 0 0.75">
      <joint name="root" type="free" armature="0" damping="0" limited="false" margin="0.01"/>
      <geom name="torso" type="sphere" size="0.25"/>
      {legs}
    </body>
  </worldbody>
  <actuator>
    {motors}
  </actuator>
</mujoco>
"""

# Each leg is a chain of three capsules: the first is fixed to the torso, the hip turns the second sideways, and the
# ankle lifts the third.
LEG = """
<body name="{name}">
  <geom name="{name}" fromto="0 0 0 {x} {y} 0"/>
  <body name="thigh_{number}" pos="{x} {y} 0">
    <joint name="hip_{number}" axis="0 0 1" range="-30 30"/>
    <geom name="thigh_{number}" fromto="0 0 0 {x} {y} 0"/>
    <body name="shin_{number}" pos="{x} {y} 0">
      <joint name="ankle_{number}" axis="{ankle_axis} 1 0" range="{ankle_range}"/>
      <geom name="shin_{number}" fromto="0 0 0 {twice_x} {twice_y} 0"/>
    </body>
  </body>
</body>
"""


def ant_spec() -> mujoco.MjSpec:
    """The model of the ant with four sound legs, with the integrator of Gymnasium's model."""
    legs = [
        LEG.format(
            name=name,
            number=number,
            x=0.2 * x,
            y=0.2 * y,
            twice_x=0.4 * x,
            twice_y=0.4 * y,
            ankle_axis=-x * y,
            ankle_range="30 70" if x > 0 else "-70 -30",
        )
        for number, (name, (x, y)) in enumerate(LEGS.items(), start=1)
    ]
    motors = [f'<motor name="{joint}" joint="{joint}"/>' for joint in MOTORS]
    return mujoco.MjSpec.from_string(MJCF.format(gear=GEAR, legs="".join(legs), motors="".join(motors)))


def cripple(spec: mujoco.MjSpec, leg: str, length: float, gear: float) -> None:
    """Makes the two moving segments of a leg `length` times as long and sets the gear of their motors (N m)."""
    number = list(LEGS).index(leg) + 1
    for segment in ("thigh", "shin"):
        geom = spec.geom(f"{segment}_{number}")
        geom.fromto = geom.fromto * length
    shin = spec.body(f"shin_{number}")
    shin.pos = shin.pos * length
    for joint in ("hip", "ankle"):
        spec.actuator(f"{joint}_{number}").gear[0] = gear


class Ant(Locomotion):
    """Gymnasium's Ant-v5 with motors of 30 N m, no reward for being alive and no early end; legs may be crippled.

    Observation (27):

    | index | quantity                             | unit  | range           |
    |-------|--------------------------------------|-------|-----------------|
    | 0     | height of the torso                  | m     | any             |
    | 1     | quaternion of the torso, w           | -     | [-1, 1]         |
    | 2     | quaternion of the torso, x           | -     | [-1, 1]         |
    | 3     | quaternion of the torso, y           | -     | [-1, 1]         |
    | 4     | quaternion of the torso, z           | -     | [-1, 1]         |
    | 5     | angle of hip_1                       | rad   | [-0.524, 0.524] |
    | 6     | angle of ankle_1                     | rad   | [0.524, 1.22]   |
    | 7     | angle of hip_2                       | rad   | [-0.524, 0.524] |
    | 8     | angle of ankle_2                     | rad   | [-1.22, -0.524] |
    | 9     | angle of hip_3                       | rad   | [-0.524, 0.524] |
    | 10    | angle of ankle_3                     | rad   | [-1.22, -0.524] |
    | 11    | angle of hip_4                       | rad   | [-0.524, 0.524] |
    | 12    | angle of ankle_4                     | rad   | [0.524, 1.22]   |
    | 13    | velocity of the torso along x        | m/s   | any             |
    | 14    | velocity of the torso along y        | m/s   | any             |
    | 15    | velocity of the torso along z        | m/s   | any             |
    | 16    | angular velocity about the torso's x | rad/s | any             |
    | 17    | angular velocity about the torso's y | rad/s | any             |
    | 18    | angular velocity about the torso's z | rad/s | any             |
    | 19    | angular velocity of hip_1            | rad/s | any             |
    | 20    | angular velocity of ankle_1          | rad/s | any             |
    | 21    | angular velocity of hip_2            | rad/s | any             |
    | 22    | angular velocity of ankle_2          | rad/s | any             |
    | 23    | angular velocity of hip_3            | rad/s | any             |
    | 24    | angular velocity of ankle_3          | rad/s | any             |
    | 25    | angular velocity of hip_4            | rad/s | any             |
    | 26    | angular velocity of ankle_4          | rad/s | any             |

    Action (8): one number a motor, clipped to [-1, 1].

    | index | motor             | unit   | range   |
    |-------|-------------------|--------|---------|
    | 0     | torque at hip_4   | 30 N m | [-1, 1] |
    | 1     | torque at ankle_4 | 30 N m | [-1, 1] |
    | 2     | torque at hip_1   | 30 N m | [-1, 1] |
    | 3     | torque at ankle_1 | 30 N m | [-1, 1] |
    | 4     | torque at hip_2   | 30 N m | [-1, 1] |
    | 5     | torque at ankle_2 | 30 N m | [-1, 1] |
    | 6     | torque at hip_3   | 30 N m | [-1, 1] |
    | 7     | torque at ankle_3 | 30 N m | [-1, 1] |

    Reward: `forward velocity - 0.01 |action|^2 - (1 while the torso is below 0.2 m)`, the velocity being the torso's
    displacement along x over the time of the step (m/s), and the height being the height after the step.

    Start: positions uniform within 0.1 (m, rad) of the model's, the quaternion then normalised; velocities normal with
    std 0.1 (m/s, rad/s).

    End: none before the time limit of 500 steps of 0.05 s.

    Differences from Gymnasium: motors of 30 N m instead of 150; control cost 0.01 instead of 0.5; no contact cost and
    no contact forces in the observation; 500 steps instead of 1000; a low torso costs 1 and does not end the episode;
    no reward for being alive. Gymnasium reads the x of the torso one physics step late; this task does not.

    The legs have Gymnasium's names. The signs of x and y of each foot are in `LEGS`: front_left_leg (joints hip_1 and
    ankle_1), front_right_leg (2), back_leg (3), right_back_leg (4). In the crippled ant of the reward-transfer
    experiments the two legs on the side of -y are crippled. Body and reward are symmetric in y, so crippling the two
    legs of the other side makes an equivalent task. The order of the actions does not depend on the crippled legs.

    Args:
      crippled: names of the crippled legs; a single name may be a string.
      length: length of the two moving segments of a crippled leg, as a share of the length in a sound leg.
      gear: gear of the two motors of a crippled leg, N m.
      fidelity: "fast" (Euler steps) or "exact" (Gymnasium's Runge-Kutta steps); see `locomotion.py`. The integrator
        matters: a policy trained on "fast" for a million steps returned 418 on "fast" and 545 on "exact".

    Raises:
      TaskError: for an unknown leg, or an impossible length, gear or fidelity.
    """

    first_observed = 2
    camera = Camera(90, -20, 4, follows=True)
    control_cost = 0.01
    # With these settings Gymnasium pays 1 while the torso is above 0.2 m and never ends an episode. Minus the bonus of
    # 1, Gymnasium's reward is that of this task.
    gymnasium = GymnasiumTask(
        "Ant-v5",
        dict(
            ctrl_cost_weight=0.01,
            contact_cost_weight=0.0,
            healthy_reward=1.0,
            healthy_z_range=(0.2, float("inf")),
            terminate_when_unhealthy=False,
            include_cfrc_ext_in_observation=False,
        ),
        bonus=1.0,
    )
    obs_mean = (0.5, *(0.0,) * 4, *(0.0, 0.9, 0.0, -0.9, 0.0, -0.9, 0.0, 0.9), *(0.0,) * 14)
    obs_std = (0.3, *(0.5,) * 4, *(0.3,) * 8, *(1.0,) * 3, *(2.0,) * 3, *(3.0,) * 8)

    def __init__(
        self,
        crippled: Collection[str] = (),
        length: float = 0.5,
        gear: float = 1.0,
        fidelity: str = "fast",
    ):
        crippled = (crippled,) if isinstance(crippled, str) else tuple(crippled)
        unknown = sorted(set(crippled) - set(LEGS))
        if unknown:
            raise TaskError(f"crippled = {', '.join(unknown)}: unknown leg; expected names from {', '.join(LEGS)}")
        if not 0.01 <= length <= 10:
            raise TaskError(f"length = {length}: expected a share of a sound leg's length, from 0.01 to 10 (half: 0.5)")
        if not 0 <= gear <= 1000:
            raise TaskError(f"gear = {gear}: expected N m, from 0 to 1000 (a sound leg's motors have {GEAR:g})")
        spec = ant_spec()
        for leg in dict.fromkeys(crippled):
            cripple(spec, leg, length, gear)
        super().__init__(spec, frame_skip=5, fidelity=fidelity)

    def initial(self, rng):
        qpos, qvel = super().initial(rng)
        return qpos.at[3:7].set(qpos[3:7] / jnp.linalg.norm(qpos[3:7])), qvel

    def reward(self, physics, action, after):
        return super().reward(physics, action, after) - (after.qpos[2] < 0.2)
