"""What the walkers and the swimmer share: Gymnasium's observation and reward, and physics in two fidelities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from eairl_jax.envs.c_engine import GymnasiumCEngine
from eairl_jax.envs.mjx_task import MjxTask, Physics, TaskError, mjx
from eairl_jax.envs.physics.contact_solver import Floor, newton
from eairl_jax.envs.physics.scatter_free import without_scatters
from eairl_jax.envs.physics.tree_solver import tree_solver

EULER, RK4 = mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtIntegrator.mjINT_RK4


@dataclass(frozen=True)
class Fidelity:
    """What the constraints of a step are solved with.

    Attributes:
      euler: whether steps are semi-implicit Euler's, whatever integrator the model names.
      contacts: most points that touch the floor at a time; the deepest count.
      newton_steps: of the constraint solver, from the acceleration of the step before.
      line_search: one-dimensional steps on the length of each.
    """

    euler: bool
    contacts: int
    newton_steps: int
    line_search: int


# "exact" is the C engine's physics: the integrator that Gymnasium chose, every contact, a solver that has converged.
# "fast" is chosen by measurement, and `tests/envs/test_locomotion.py` holds it to that. Random actions put at most six
# points on the floor in 15,000 steps of ant or half-cheetah. After two Newton steps the worst position of an ant is
# off by 0.5 % of its spread in the median step and by 12 % in one of twenty, after three by 0.0001 % and 2.6 %, for a
# fifth of the time.
FIDELITIES = {"fast": Fidelity(True, 6, 3, 2), "exact": Fidelity(False, 100, 20, 8)}


class Locomotion(MjxTask):
    """A body that is paid for its speed along x. Every episode runs its whole length: nothing ends it early.

    Observation: the positions from `first_observed` on, then all velocities.

    Reward: `(x after - x before) / dt - control_cost |action|^2`, x being position 0.

    Start: positions uniform within 0.1 of the model's, velocities normal with std 0.1.

    MJX computes what the bodies do without constraints; `envs.floor` adds contacts and joint limits, since MJX's own
    take most of the time and differ from the C engine's where a capsule stands steep.

    Args:
      spec: Gymnasium's model. A free joint, if any, comes first; the motors drive hinges.
      frame_skip: physics steps an action.
      fidelity: "fast" or "exact".

    Attributes:
      first_observed: the positions before this one say where the body is in the world and are not observed.
      control_cost: price of `|action|^2`.
      gymnasium: name of Gymnasium's environment and the settings with which it is the same task.
      model: for the C engine; it has the integrator of the fidelity, and a solver that converges in both.
    """

    episode_length = 500
    first_observed: int
    control_cost: float
    gymnasium: tuple[str, dict[str, Any]]

    def __init__(self, spec: mujoco.MjSpec, frame_skip: int, fidelity: str):
        if fidelity not in FIDELITIES:
            raise TaskError(f"fidelity = {fidelity!r}: expected one of {', '.join(FIDELITIES)}")
        self.fidelity = FIDELITIES[fidelity]
        if self.fidelity.euler:
            spec.option.integrator = EULER
            spec.compiler.fusestatic = True  # the same masses in fewer bodies
        super().__init__(spec, frame_skip)
        model = self.model
        self._floor = Floor(model, self.fidelity.contacts)
        self._solve = tree_solver(model.dof_parentid)
        self._floating = model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
        self._damping = np.diag(model.opt.timestep * model.dof_damping)
        self._motors = np.zeros((model.nu, model.nv))
        self._motors[np.arange(model.nu), model.jnt_dofadr[model.actuator_trnid[:, 0]]] = model.actuator_gear[:, 0]

    def initial(self, rng):
        position_rng, velocity_rng = jax.random.split(rng)
        start = jnp.asarray(self.model.qpos0)
        qpos = start + jax.random.uniform(position_rng, start.shape, minval=-0.1, maxval=0.1)
        return qpos, 0.1 * jax.random.normal(velocity_rng, (self.model.nv,))

    def referee(self):
        name, settings = self.gymnasium
        return GymnasiumCEngine(name, self.spec, frame_skip=self.frame_skip, **settings)

    def observe(self, physics):
        return jnp.concatenate([physics.qpos[self.first_observed :], physics.qvel])

    def reward(self, physics, action, after):
        velocity = (after.qpos[0] - physics.qpos[0]) / self.dt
        return velocity - self.control_cost * jnp.sum(action**2)

    def substep(self, physics, ctrl):
        return without_scatters(self._substep)(physics, ctrl)

    def _substep(self, physics: Physics, ctrl: jax.Array) -> Physics:
        if self.model.opt.integrator == RK4:
            return self._runge_kutta(physics, ctrl)
        qacc, inertia = self._acceleration(physics, ctrl)
        damped = qacc
        if self._damping.any():  # implicit in the dampers' force, as the C engine's Euler is
            damped = self._solve(inertia + self._damping, inertia @ qacc)
        qvel = physics.qvel + self.model.opt.timestep * damped
        return Physics(self._move(physics.qpos, qvel, self.model.opt.timestep), qvel, qacc)

    def _acceleration(self, physics: Physics, ctrl: jax.Array) -> tuple[jax.Array, jax.Array]:
        """`(qacc [nv], inertia [nv, nv])` under all forces and constraints."""
        model = self._mjx_model
        data = self._blank.replace(qpos=physics.qpos, qvel=physics.qvel)
        for stage in (mjx.kinematics, mjx.com_pos, mjx.crb, mjx.com_vel, mjx.passive, mjx.rne):
            data = stage(model, data)
        force = data.qfrc_passive - data.qfrc_bias + ctrl @ self._motors
        inertia = mjx.full_m(model, data)
        start, solver = physics.qacc_warmstart, self.fidelity
        rows = self._floor.rows(data)
        return newton(self._solve, inertia, force, rows, start, solver.newton_steps, solver.line_search), inertia

    def _runge_kutta(self, physics: Physics, ctrl: jax.Array) -> Physics:
        """The classical fourth-order step."""
        h = self.model.opt.timestep

        def stage(carry, tableau):
            ((last_speed, last_qacc), moved, pushed), (ahead, weight) = carry, tableau
            # Where the speed and the acceleration of the stage before lead.
            speed = physics.qvel + ahead * h * last_qacc
            place = self._move(physics.qpos, last_speed, ahead * h)
            found, _ = self._acceleration(Physics(place, speed, last_qacc), ctrl)
            return ((speed, found), moved + weight * speed, pushed + weight * found), None

        first = (physics.qvel, physics.qacc_warmstart)
        still = jnp.zeros_like(physics.qvel)
        tableau = jnp.array([0.0, 0.5, 0.5, 1.0]), jnp.array([1.0, 2.0, 2.0, 1.0]) / 6
        ((_, qacc), mean_speed, mean_qacc), _ = jax.lax.scan(stage, (first, still, still), tableau)
        return Physics(self._move(physics.qpos, mean_speed, h), physics.qvel + h * mean_qacc, qacc)

    def _move(self, qpos: jax.Array, qvel: jax.Array, seconds: jax.Array | float) -> jax.Array:
        """Positions `[nq]` after some time at constant velocities `[nv]`."""
        if not self._floating:
            return qpos + seconds * qvel
        half = 0.5 * seconds * qvel[3:6]  # of a rotation vector in the body's own frame
        angle = jnp.sqrt(jnp.sum(half**2) + 1e-20)
        w, v = jnp.cos(angle), half * jnp.sin(angle) / angle
        a, b = qpos[3], qpos[4:7]
        quaternion = jnp.concatenate([(a * w - b @ v)[None], a * v + w * b + jnp.cross(b, v)])
        quaternion /= jnp.linalg.norm(quaternion)
        return jnp.concatenate([qpos[:3] + seconds * qvel[:3], quaternion, qpos[7:] + seconds * qvel[6:]])
