"""Contacts with a floor and joint limits, solved in a few Newton steps. This solver makes the fast physics fast.

Problem: `mjx.step` computes every contact that could ever happen. A walker has 16 to 25 possible contacts, of which
rarely more than five happen at the same time.

Idea: only the deepest few contacts get constraint rows. A joint limit touches one degree of freedom, so all limits
together only add to a diagonal. The solver computes nothing that is thrown away.

The equations are MuJoCo's (https://mujoco.readthedocs.io/en/stable/computation, sections "Constraint model" and
"Constraint solver", pyramidal friction cones), and so is the convex problem. The accelerations are compared with the C
engine's in `tests/envs/physics/test_contact_solver.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

if TYPE_CHECKING:
    from mujoco import mjx

SPHERE, CAPSULE = int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtGeom.mjGEOM_CAPSULE)


class ConstraintRows(NamedTuple):
    """Constraints on the acceleration: the force of a row is `stiffness * max(0, reference - jacobian @ qacc)`.

    Attributes:
      jacobian: `[rows, nv]` of the edges of the contacts' friction pyramids, four rows for each contact.
      stiffness: `[rows]`, D in MuJoCo's notation; 0 for a contact that does not touch.
      reference: `[rows]`, a_ref in MuJoCo's notation: the acceleration that the constraint asks for.
      limit_sign: `[nv]`, the only entry of the Jacobian of each joint limit: 1 at the lower limit, -1 at the upper.
      limit_stiffness: `[nv]`, D of the limits; 0 for a joint within its range or without a range.
      limit_reference: `[nv]`, a_ref of the limits.
    """

    jacobian: jax.Array
    stiffness: jax.Array
    reference: jax.Array
    limit_sign: jax.Array
    limit_stiffness: jax.Array
    limit_reference: jax.Array


class FloorConstraints:
    """The points of a model that can touch its floor, and its joint limits.

    The model must be one tree of bodies over one horizontal plane at height 0. Spheres and capsules touch the plane, a
    capsule at the spheres of its two ends. All contacts must have the same softness (`solref`, `solimp`), and so must
    all joint limits.

    Args:
      model: the compiled model.
      max_contacts: how many points get constraint rows; the deepest points are chosen.

    Raises:
      ValueError: if two contacts differ in softness (two joint limits: raised by `rows`).

    Attributes:
      geom: `[points]` the geom of each point that can touch the floor.
    """

    def __init__(self, model: mujoco.MjModel, max_contacts: int):
        plane = int(np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)[0])
        touching = np.flatnonzero((model.geom_contype & model.geom_conaffinity[plane]) > 0)
        points = [(g, offset) for g in touching if g != plane for offset in _touching_offsets(model, g)]
        self.model = model
        self.geom = np.array([g for g, _ in points], dtype=int)
        self._offset = np.array([offset for _, offset in points])
        self._is_capsule = model.geom_type[self.geom] == CAPSULE
        self._contacts = min(max_contacts, len(points))
        if not points:
            return
        body = model.geom_bodyid[self.geom]
        friction = np.maximum(model.geom_friction[self.geom, 0], model.geom_friction[plane, 0])
        weight = model.body_invweight0[body, 0] * (1 + friction**2) * 2 * friction**2 / model.opt.impratio
        self._radius = model.geom_size[self.geom, 0]
        self._margin = model.geom_margin[self.geom] + model.geom_margin[plane]
        self.moved_by = _moved_by(model)[body]
        self._table = np.concatenate([self.moved_by, friction[:, None], weight[:, None]], 1)
        self._softness = _common_softness(model.geom_solref[touching], model.geom_solimp[touching])

    def rows(self, data: mjx.Data) -> ConstraintRows:
        """The constraints at the positions and velocities of `data`, on which `mjx.com_pos` has run."""
        limits = self._limits(data)
        if not self._contacts:
            nothing = jnp.zeros(0)
            return ConstraintRows(jnp.zeros((0, self.model.nv)), nothing, nothing, *limits)
        points, distance = self._points(data)
        chosen = deepest(self._margin - distance, self._contacts)
        points, table = chosen @ points, chosen @ jnp.asarray(self._table)
        moved_by, friction, weight = table[:, :-2], table[:, -2], table[:, -1]
        depth = points[:, 3]
        jacobian = _pyramid_jacobian(data, points, moved_by, friction)

        stiffness, spring, damping = _soft_constraint(*self._softness, depth, weight, self.model.opt.timestep)
        stiffness, spring = jnp.tile(stiffness * (depth < 0), 4), jnp.tile(spring, 4)
        return ConstraintRows(jacobian, stiffness, -damping * (jacobian @ data.qvel) - spring, *limits)

    def _points(self, data: mjx.Data) -> tuple[jax.Array, jax.Array]:
        """The points that can touch the floor, `[points, 6]`, and their distances from the floor, `[points]`, m.

        The columns are the position of the contact (x, y, z), the distance minus the margin, and the first direction of
        friction (x, y).
        """
        axis = data.geom_xmat[self.geom, :, 2]
        centre = data.geom_xpos[self.geom] + self._offset[:, None] * axis
        distance = centre[:, 2] - self._radius
        # The first direction of friction is along the capsule, or y for a sphere. (MJX 3.17 takes y for steep capsules
        # too. Compared with the C engine, the friction of an ant's feet is then turned by up to 45 degrees.)
        length = jnp.sqrt(axis[:, 0] ** 2 + axis[:, 1] ** 2)
        leans = self._is_capsule & (length > 1e-6)
        along_x = jnp.where(leans, axis[:, 0] / jnp.maximum(length, 1e-6), 0.0)
        along_y = jnp.where(leans, axis[:, 1] / jnp.maximum(length, 1e-6), 1.0)
        columns = [centre[:, 0], centre[:, 1], 0.5 * distance, distance - self._margin, along_x, along_y]
        return jnp.stack(columns, 1), distance

    def _limits(self, data: mjx.Data) -> tuple[jax.Array, jax.Array, jax.Array]:
        """The joint limits: sign, stiffness and reference, each `[nv]`, as in `ConstraintRows`."""
        model, nv = self.model, self.model.nv
        joint = np.flatnonzero(model.jnt_limited)
        if not joint.size:
            return jnp.ones(nv), jnp.zeros(nv), jnp.zeros(nv)
        dof = model.jnt_dofadr[joint]
        low, high = model.jnt_range[joint].T
        q = data.qpos[model.jnt_qposadr[joint]]
        below, above = q - low, high - q
        sign = jnp.where(below < above, 1.0, -1.0)
        depth = jnp.minimum(below, above) - model.jnt_margin[joint]
        softness = _common_softness(model.jnt_solref[joint], model.jnt_solimp[joint])
        stiffness, spring, damping = _soft_constraint(*softness, depth, model.dof_invweight0[dof], model.opt.timestep)
        reference = -damping * sign * data.qvel[dof] - spring
        by_dof = jnp.stack([sign, stiffness * (depth < 0), reference]) @ np.eye(nv)[dof]
        return by_dof[0], by_dof[1], by_dof[2]


def _pyramid_jacobian(data: mjx.Data, points: jax.Array, moved_by: jax.Array, friction: jax.Array) -> jax.Array:
    """The Jacobian `[4 * contacts, nv]` of the edges `normal +- friction * tangent` of the friction pyramids.

    Args:
      data: the state, for the motion axes of the degrees of freedom (`cdof`) about the centre of mass.
      points: `[contacts, 6]`, columns as in `FloorConstraints._points`.
      moved_by: `[contacts, nv]`, 1 where a degree of freedom moves the contact's body.
      friction: `[contacts]`, sliding friction.
    """
    along_x, along_y = points[:, 4:5], points[:, 5:6]
    ox, oy, oz = jnp.split(points[:, :3] - data.subtree_com[1], 3, axis=1)
    rx, ry, rz, vx, vy, vz = data.cdof.T
    x = (vx + ry * oz - rz * oy) * moved_by
    y = (vy + rz * ox - rx * oz) * moved_by
    normal = (vz + rx * oy - ry * ox) * moved_by
    first = friction[:, None] * (along_x * x + along_y * y)
    second = friction[:, None] * (along_x * y - along_y * x)
    return jnp.concatenate([normal + first, normal - first, normal + second, normal - second])


def newton(
    solve: Callable[[jax.Array, jax.Array], jax.Array],
    inertia: jax.Array,
    force: jax.Array,
    rows: ConstraintRows,
    start: jax.Array,
    steps: int,
    line_search_steps: int,
) -> jax.Array:
    """Minimises `a' M a / 2 - a' f + sum(D min(0, J a - a_ref)^2) / 2` over the acceleration a, by Newton's method.

    This is MuJoCo's primal problem (documentation, "Computation", section "Constraint solver"). The length of each
    Newton step is found by one-dimensional Newton steps, kept within a bracket of the minimum.

    Args:
      solve: `(matrix [nv, nv], vector [nv]) -> matrix^-1 vector [nv]` for matrices with the zeros of M (`tree_solver`).
        The Hessian has these zeros, because a contact joins only degrees of freedom on one path to the root.
      inertia: `[nv, nv]`, M.
      force: `[nv]`, f: all forces except those of the constraints.
      rows: the constraints (J, D, a_ref).
      start: `[nv]`, the first guess: the acceleration of the last physics step.
      steps: number of Newton steps.
      line_search_steps: number of one-dimensional Newton steps for each Newton step.

    Returns:
      The acceleration `[nv]`.
    """

    def step(_, acceleration):
        slack = rows.jacobian @ acceleration - rows.reference
        limit_slack = rows.limit_sign * acceleration - rows.limit_reference
        pushing = rows.stiffness * (slack < 0)
        limit_pushing = rows.limit_stiffness * (limit_slack < 0)
        unconstrained = inertia @ acceleration - force
        gradient = unconstrained + rows.jacobian.T @ (pushing * slack) + rows.limit_sign * limit_pushing * limit_slack
        hessian = inertia + (rows.jacobian.T * pushing) @ rows.jacobian + jnp.diag(limit_pushing)
        direction = -solve(hessian, gradient)
        towards, limit_towards = rows.jacobian @ direction, rows.limit_sign * direction
        slope_0, curvature_0 = direction @ unconstrained, direction @ (inertia @ direction)

        low, high, length = 0.0, jnp.inf, 1.0
        for _ in range(line_search_steps):
            ahead, limit_ahead = slack + length * towards, limit_slack + length * limit_towards
            push = rows.stiffness * (ahead < 0) * towards
            limit_push = rows.limit_stiffness * (limit_ahead < 0) * limit_towards
            slope = slope_0 + length * curvature_0 + push @ ahead + limit_push @ limit_ahead
            curvature = curvature_0 + push @ towards + limit_push @ limit_towards
            low, high = jnp.where(slope < 0, length, low), jnp.where(slope < 0, high, length)
            proposed = length - slope / jnp.maximum(curvature, 1e-12)
            # While `high` is infinite the slope is negative, so `proposed` lies between `low` and `high`.
            length = jnp.where((proposed >= low) & (proposed <= high), proposed, 0.5 * (low + high))
        return acceleration + length * direction

    return jax.lax.fori_loop(0, steps, step, start)


def deepest(depth: jax.Array, count: int) -> jax.Array:
    """Selects the `count` largest of `depth [n]`: returns `[count, n]`, row k with a 1 at the k-th largest.

    Of equal depths the first comes first. `jax.lax.top_k` selects the same, but XLA cannot fuse its kernel with a loop.
    """
    index = np.arange(depth.shape[0])
    ranks_before = (depth[None, :] > depth[:, None]) | (
        (depth[None, :] == depth[:, None]) & (index[None, :] < index[:, None])
    )
    return (ranks_before.sum(axis=1)[None, :] == np.arange(count)[:, None]).astype(depth.dtype)


def _touching_offsets(model: mujoco.MjModel, geom: int) -> tuple[float, ...]:
    """The offsets (m), along the axis of a geom, of the spheres that can touch a plane."""
    half = model.geom_size[geom, 1]
    return {SPHERE: (0.0,), CAPSULE: (half, -half)}[int(model.geom_type[geom])]


def _moved_by(model: mujoco.MjModel) -> np.ndarray:
    """`[nbody, nv]`, 1 where a degree of freedom moves a body."""
    moved_by = np.zeros((model.nbody, model.nv))
    for body in range(1, model.nbody):
        moved_by[body] = moved_by[model.body_parentid[body]]
        first = model.body_dofadr[body]
        moved_by[body, first : first + model.body_dofnum[body]] = 1
    return moved_by


def _common_softness(solref: np.ndarray, solimp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The softness that all constraints share: `solref [2]` and `solimp [5]`, from `[constraints, 2]` and `[.., 5]`."""
    if np.ptp(solref, axis=0).any() or np.ptp(solimp, axis=0).any() or not np.allclose(solimp[0, 3:], (0.5, 2)):
        raise ValueError(
            "solref or solimp differ between contacts or between joint limits: expected one solref and one solimp for "
            "all contacts, and for all limits, with midpoint 0.5 and power 2; set both in the model's <default>"
        )
    return solref[0], solimp[0]


def _soft_constraint(
    solref: np.ndarray, solimp: np.ndarray, depth: jax.Array, weight: jax.Array, timestep: float
) -> tuple[jax.Array, jax.Array, float]:
    """MuJoCo's soft constraint (documentation, "Modeling", section "Solver parameters").

    Args:
      solref: `[2]`, time constant (s) and damping ratio.
      solimp: `[5]`, least and greatest impedance, width (m or rad), midpoint, power.
      depth: `[n]`, distance to the constraint (m or rad); below 0 the constraint is violated.
      weight: `[n]`, approximate diagonal of `J M^-1 J'`.
      timestep: s.

    Returns:
      The stiffness D `[n]`, the spring term `k * impedance * depth` `[n]` and the damping b, so that the reference
      acceleration is `a_ref = -b * velocity - k * impedance * depth`.
    """
    timeconst, dampratio = max(solref[0], 2 * timestep), solref[1]
    low, high = np.clip(solimp[:2], 1e-4, 0.9999)
    width = solimp[2]
    x = jnp.minimum(jnp.abs(depth) / width, 1.0)
    sigmoid = jnp.where(x < 0.5, 2 * x**2, 1 - 2 * (1 - x) ** 2)  # for midpoint 0.5 and power 2, MuJoCo's defaults
    impedance = low + sigmoid * (high - low)
    stiffness = impedance / jnp.maximum((1 - impedance) * weight, 1e-15)
    return stiffness, impedance * depth / (high * timeconst * dampratio) ** 2, 2 / (high * timeconst)
