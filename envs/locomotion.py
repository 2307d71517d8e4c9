"""What the ant, the half-cheetah and the swimmer share: Gymnasium's observation and reward, and two fidelities."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from eairl_jax.envs.mjx_task import MjxTask, Physics, TaskError, mjx
from eairl_jax.envs.physics.contact_solver import FloorConstraints, newton
from eairl_jax.envs.physics.scatter_free import without_scatters
from eairl_jax.envs.physics.tree_solver import tree_solver

EULER, RK4 = mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtIntegrator.mjINT_RK4


@dataclass(frozen=True)
class Fidelity:
    """The integrator and the effort of the constraint solver in a physics step.

    Attributes:
      euler: True: semi-implicit Euler steps. False: the integrator that the model names.
      max_contacts: the number of points that can touch the floor at the same time; if more points touch, the deepest
        are used.
      newton_steps: Newton steps of the constraint solver, which starts from the acceleration of the last physics step.
      line_search_steps: one-dimensional Newton steps that find the length of each Newton step.
    """

    euler: bool
    max_contacts: int
    newton_steps: int
    line_search_steps: int


# "exact" is the physics of the C engine: Gymnasium's integrator, every contact, and a converged solver.
# "fast" was chosen by measurement, and `tests/envs/test_locomotion.py` checks the accuracy. With random actions at most
# six points touched the floor in 15,000 steps of ant and half-cheetah. The errors of the ant's worst position are in
# standard deviations of that position. After two Newton steps the error was 0.5 % in the median step and 12 % in one
# step of twenty. After three Newton steps the errors were 0.0001 % and 2.6 %; the third takes a fifth of the time.
FIDELITIES = {"fast": Fidelity(True, 6, 3, 2), "exact": Fidelity(False, 100, 20, 8)}


class Locomotion(MjxTask):
    """A body that is rewarded for its speed along x. Nothing ends an episode before the time limit.

    Observation: the positions from `first_observed` on, then all velocities.

    Reward: `(x after - x before) / dt - control_cost |action|^2`, x being position 0.

    Start: positions uniform within 0.1 (m, rad) of the model's, velocities normal with std 0.1 (m/s, rad/s).

    MJX computes inertia and forces without constraints. `physics/contact_solver.py` adds contacts and joint limits,
    because MJX's constraints take most of the time and differ from the C engine's where a capsule stands steep.

    Args:
      spec: the model. If the model has a free joint, the free joint comes first. The motors drive hinges.
      frame_skip: physics steps for each action.
      fidelity: "fast" or "exact".

    Attributes:
      first_observed: index of the first position that is observed. The positions before the index say where the body
        is in the world.
      control_cost: weight of `|action|^2` in the reward.
      fidelity: the chosen `Fidelity`.
      dynamics: of the class, the model and the fidelity, but not of the cost of actions.
      model: the model for the C engine. The integrator is that of the fidelity; the C engine's solver converges at
        either fidelity.

    Raises:
      TaskError: for an unknown fidelity.
    """

    episode_length = 500
    first_observed: int
    control_cost: float

    def __init__(self, spec: mujoco.MjSpec, frame_skip: int, fidelity: str):
        if fidelity not in FIDELITIES:
            raise TaskError(f"fidelity = {fidelity!r}: expected one of {', '.join(FIDELITIES)}")
        self.fidelity = FIDELITIES[fidelity]
        if self.fidelity.euler:
            spec.option.integrator = EULER
            spec.compiler.fusestatic = True  # fewer bodies with the same masses
        super().__init__(spec, frame_skip)
        model = self.model
        self.dynamics = (type(self), spec.to_xml(), frame_skip, self.fidelity)
        self._constraints = FloorConstraints(model, self.fidelity.max_contacts)
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
        if self._damping.any():  # like the C engine's Euler step: implicit in the force of the dampers
            damped = self._solve(inertia + self._damping, inertia @ qacc)
        qvel = physics.qvel + self.model.opt.timestep * damped
        return Physics(self._move(physics.qpos, qvel, self.model.opt.timestep), qvel, qacc)

    def _acceleration(self, physics: Physics, ctrl: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Returns the acceleration `[nv]` under all forces and constraints, and the inertia matrix `[nv, nv]`."""
        model = self._mjx_model
        data = self._blank.replace(qpos=physics.qpos, qvel=physics.qvel)
        for stage in (mjx.kinematics, mjx.com_pos, mjx.crb, mjx.com_vel, mjx.passive, mjx.rne):
            data = stage(model, data)
        force = data.qfrc_passive - data.qfrc_bias + ctrl @ self._motors
        inertia = mjx.full_m(model, data)
        start, solver = physics.qacc_warmstart, self.fidelity
        rows = self._constraints.rows(data)
        qacc = newton(self._solve, inertia, force, rows, start, solver.newton_steps, solver.line_search_steps)
        return qacc, inertia

    def _runge_kutta(self, physics: Physics, ctrl: jax.Array) -> Physics:
        """One step of the classical fourth-order Runge-Kutta method."""
        h = self.model.opt.timestep

        def stage(carry, tableau):
            ((last_qvel, last_qacc), mean_qvel, mean_qacc), (node, weight) = carry, tableau
            # From the start of the step, with velocity and acceleration of the last stage, to the time `node * h`.
            qvel = physics.qvel + node * h * last_qacc
            qpos = self._move(physics.qpos, last_qvel, node * h)
            qacc, _ = self._acceleration(Physics(qpos, qvel, last_qacc), ctrl)
            return ((qvel, qacc), mean_qvel + weight * qvel, mean_qacc + weight * qacc), None

        first = (physics.qvel, physics.qacc_warmstart)
        zeros = jnp.zeros_like(physics.qvel)
        tableau = jnp.array([0.0, 0.5, 0.5, 1.0]), jnp.array([1.0, 2.0, 2.0, 1.0]) / 6  # nodes, weights
        ((_, qacc), mean_qvel, mean_qacc), _ = jax.lax.scan(stage, (first, zeros, zeros), tableau)
        return Physics(self._move(physics.qpos, mean_qvel, h), physics.qvel + h * mean_qacc, qacc)

    def _move(self, qpos: jax.Array, qvel: jax.Array, seconds: jax.Array | float) -> jax.Array:
        """Positions `[nq]` after `seconds` at the constant velocities `[nv]`.

        A free joint's velocities are three linear ones in the world's frame and three angular ones in the body's frame,
        so its quaternion is multiplied by the rotation of the angular ones (MuJoCo's `mj_integratePos`).
        """
        if not self._floating:
            return qpos + seconds * qvel
        half = 0.5 * seconds * qvel[3:6]  # half of the rotation vector, in the body's frame
        angle = jnp.sqrt(jnp.sum(half**2) + 1e-20)
        w, v = jnp.cos(angle), half * jnp.sin(angle) / angle
        a, b = qpos[3], qpos[4:7]
        quaternion = jnp.concatenate([(a * w - b @ v)[None], a * v + w * b + jnp.cross(b, v)])
        quaternion /= jnp.linalg.norm(quaternion)
        return jnp.concatenate([qpos[:3] + seconds * qvel[:3], quaternion, qpos[7:] + seconds * qvel[6:]])
