"""The point mazes of the reward-transfer experiments (Fu et al. 2018; EAIRL, section 5.1), and two more."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco

from eairl_jax.envs.mjx_task import Camera, MjxTask, State, TaskError

SIDE = 0.6  # m, L in the paper's release
START = (SIDE / 2, 0.0)
GOAL = (SIDE / 2, SIDE - 0.1)
WEST = -0.1  # m, x of the west wall; the east wall is at SIDE
# The barriers by where they can be passed, each `(x of one end, x of the other end, y)`, m.
BARRIERS = {
    "left": [(SIDE / 3, SIDE, SIDE / 2)],
    "right": [(WEST, 2 * SIDE / 3, SIDE / 2)],
    "middle": [(WEST, 0.1, SIDE / 2), (0.4, SIDE, SIDE / 2)],
    "double": [(SIDE / 3, SIDE, 0.2), (WEST, 2 * SIDE / 3, 0.37)],
}
CAPSULE = '<geom name="{name}" type="capsule" size="0.02" fromto="{left} {y} 0 {right} {y} 0"/>'

MJCF = """
<mujoco>
  <option timestep="0.01" gravity="0 0 0" integrator="Euler" solver="Newton" jacobian="sparse"
          iterations="{iterations}" ls_iterations="{line_search}">
    <flag eulerdamp="disable"/>
  </option>
  <default>
    <geom condim="1" contype="0" conaffinity="1"/>
    <default class="look"> <!-- visible, without contacts -->
      <geom type="box" contype="0" conaffinity="0"/>
    </default>
    <joint type="slide" damping="1"/>
    <motor ctrllimited="true" ctrlrange="-1 1"/>
  </default>
  <worldbody>
    <body name="point">
      <joint name="x" axis="1 0 0"/>
      <joint name="y" axis="0 1 0"/>
      <geom name="point" type="sphere" size="0.03" density="1000" contype="1" conaffinity="0"/>
    </body>
    <geom name="wall_west" type="plane" pos="-0.1 0 0" zaxis="1 0 0" size="1 1 0.1" rgba="0 0 0 0"/>
    <geom name="wall_east" type="plane" pos="{side} 0 0" zaxis="-1 0 0" size="1 1 0.1" rgba="0 0 0 0"/>
    <geom name="wall_south" type="plane" pos="0 -0.1 0" zaxis="0 1 0" size="1 1 0.1" rgba="0 0 0 0"/>
    <geom name="wall_north" type="plane" pos="0 {side} 0" zaxis="0 -1 0" size="1 1 0.1" rgba="0 0 0 0"/>
    <geom class="look" name="ground" pos="{centre} {centre} -0.05" size="{half} {half} 0.01" rgba="0.92 0.93 0.95 1"/>
    <geom class="look" name="west" pos="-0.11 {centre} 0" size="0.01 {half} 0.04"/>
    <geom class="look" name="east" pos="{beyond} {centre} 0" size="0.01 {half} 0.04"/>
    <geom class="look" name="south" pos="{centre} -0.11 0" size="{half} 0.01 0.04"/>
    <geom class="look" name="north" pos="{centre} {beyond} 0" size="{half} 0.01 0.04"/>
    <geom class="look" name="goal" type="cylinder" pos="{goal[0]} {goal[1]} -0.039" size="0.03 0.001"
          rgba="0.2 0.7 0.3 1"/>
    {barriers}
  </worldbody>
  <actuator>
    <motor name="x" joint="x"/>
    <motor name="y" joint="y"/>
  </actuator>
</mujoco>
"""


class PointMaze(MjxTask):
    """A point in a square arena whose barrier leaves one passage: on the left, on the right or in the middle.

    "double" has two barriers. The first can be passed on the left, the second on the right.

    Observation (2):

    | index | quantity       | unit | range       |
    |-------|----------------|------|-------------|
    | 0     | x of the point | m    | [-0.1, 0.6] |
    | 1     | y of the point | m    | [-0.1, 0.6] |

    Action (2): force along x and y, N, clipped to [-1, 1].

    Reward: `-|point - goal| - 0.001 |action|^2`, the point being the position before the step (m).

    Start: at (0.3, 0) m, each velocity uniform in [-0.01, 0.01) m/s.

    End: none before the time limit of 100 steps of 0.05 s.

    Gymnasium has no such task; the C engine simulates the same model. Contacts have no friction, so each contact is one
    constraint.

    Args:
      passage: "left", "right", "middle" or "double": where the point can pass the barrier.
      solver_iterations, line_search_iterations: Newton steps of MJX's constraint solver for each physics step, and
        line-search steps for each Newton step. With one Newton step positions stay within 2 mm of the C engine's
        (100 iterations) while the point leans on walls. After an impact at full speed the difference reaches 7 mm for
        a moment. `tests/envs/test_point_maze.py` checks both figures.

    Raises:
      TaskError: for another passage, or for less than one iteration.
    """

    episode_length = 100
    camera = Camera(90, -89, 1.1, follows=False)
    # The arena [-0.1, 0.6]^2 becomes [-1, 1]^2, both passages included.
    obs_mean = (0.25, 0.25)
    obs_std = (0.35, 0.35)

    def __init__(self, passage: str, solver_iterations: int = 1, line_search_iterations: int = 4):
        if passage not in BARRIERS:
            raise TaskError(f"passage = {passage!r}: expected {' or '.join(BARRIERS)}")
        if solver_iterations < 1 or line_search_iterations < 1:
            raise TaskError(
                f"solver_iterations = {solver_iterations}, line_search_iterations = {line_search_iterations}: "
                "expected at least 1 of each"
            )
        barriers = [
            CAPSULE.format(name=f"barrier{n or ''}", left=left, right=right, y=y)
            for n, (left, right, y) in enumerate(BARRIERS[passage])
        ]
        mjcf = MJCF.format(
            iterations=solver_iterations,
            line_search=line_search_iterations,
            side=SIDE,
            barriers="\n    ".join(barriers),
            centre=(SIDE - 0.1) / 2,
            half=(SIDE + 0.1) / 2,
            beyond=SIDE + 0.01,
            goal=GOAL,
        )
        super().__init__(mujoco.MjSpec.from_string(mjcf), frame_skip=5)

    def initial(self, rng):
        return jnp.array(START), jax.random.uniform(rng, (2,), minval=-0.01, maxval=0.01)

    def at_rest(self, obs: jax.Array) -> State:
        """The state in which the point rests at the observation `[2]`, m. Inside a wall the wall pushes it out."""
        return self._start(obs, jnp.zeros(2))

    def observe(self, physics):
        return physics.qpos

    def reward(self, physics, action, after):
        to_goal = physics.qpos - jnp.array(GOAL)
        # The small constant keeps the gradient of the norm finite at the goal.
        distance = jnp.sqrt(jnp.sum(to_goal**2) + 1e-12)
        return -distance - 0.001 * jnp.sum(action**2)
