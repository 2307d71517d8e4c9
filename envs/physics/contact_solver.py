"""The constraints of a body over a floor, solved in a few Newton steps: what makes the fast physics fast.

`mjx.step` pays in full for every contact that could ever happen. Of a walker's 16 to 25 possible contacts hardly more
than five happen at a time, so here the deepest few alone get constraint rows; joint limits touch one degree of freedom
each and only add to a diagonal; and the solver evaluates nothing that it throws away. The equations are MuJoCo's
(https://mujoco.readthedocs.io/en/stable/computation, "Constraint model"), its convex problem is the same, and
`tests/envs/test_floor.py` compares accelerations with the C engine's.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from eairl_jax.envs.mjx_task import mjx

SPHERE, CAPSULE = int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtGeom.mjGEOM_CAPSULE)


class Rows(NamedTuple):
    """Constraints in acceleration space: a row's force is `stiffness * max(0, reference - jacobian @ qacc)`.

    Attributes:
      jacobian: `[rows, nv]` of the contacts' friction pyramids, four rows a contact.
      stiffness: `[rows]`, D in MuJoCo's notation; 0 for a contact that does not touch.
      reference: `[rows]` acceleration that the constraint asks for, a_ref.
      limit_sign: `[nv]` the only entry of each joint limit's Jacobian: 1 at the lower limit, -1 at the upper.
      limit_stiffness, limit_reference: `[nv]` as above; stiffness 0 for a joint within its range or without one.
    """

    jacobian: jax.Array
    stiffness: jax.Array
    reference: jax.Array
    limit_sign: jax.Array
    limit_stiffness: jax.Array
    limit_reference: jax.Array


class Floor:
    """The points of a model that can touch its floor, and its joint limits.

    The model is one tree of bodies over one horizontal plane at height 0. Spheres and capsules touch it, a capsule at
    the two spheres of its ends; pyramids approximate friction cones; all contacts are equally soft, as are all limits.

    Args:
      model: the model.
      contacts: how many points, the deepest, get constraint rows.
    """

    def __init__(self, model: mujoco.MjModel, contacts: int):
        plane = int(np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)[0])
        touching = np.flatnonzero((model.geom_contype & model.geom_conaffinity[plane]) > 0)
        points = [(g, end) for g in touching if g != plane for end in _ends(model, g)]
        self.model = model
        self.geom = np.array([g for g, _ in points], dtype=int)
        self.end = np.array([end for _, end in points])
        self.is_capsule = model.geom_type[self.geom] == CAPSULE
        self.contacts = min(contacts, len(points))
        if not points:
            return
        body = model.geom_bodyid[self.geom]
        friction = np.maximum(model.geom_friction[self.geom, 0], model.geom_friction[plane, 0])
        weight = model.body_invweight0[body, 0] * (1 + friction**2) * 2 * friction**2 / model.opt.impratio
        self.radius = model.geom_size[self.geom, 0]
        self.margin = model.geom_margin[self.geom] + model.geom_margin[plane]
        # What a chosen point takes with it: the joints that move it, its friction, its inverse weight.
        self.table = np.concatenate([_movers(model)[body], friction[:, None], weight[:, None]], 1)
        self.softness = _shared(model.geom_solref[touching], model.geom_solimp[touching])

    def rows(self, data: mjx.Data) -> Rows:
        """The constraints at the positions and velocities of `data`, after `mjx.com_pos`."""
        limits = self._limits(data)
        if not self.contacts:
            nothing = jnp.zeros(0)
            return Rows(jnp.zeros((0, self.model.nv)), nothing, nothing, *limits)
        axis = data.geom_xmat[self.geom, :, 2]
        centre = data.geom_xpos[self.geom] + self.end[:, None] * axis
        distance = centre[:, 2] - self.radius
        # Friction's first direction: along the capsule, or y for a sphere. (MJX 3.17 takes y for steep capsules too,
        # which turns the friction of an ant's feet by up to 45 degrees against the C engine's.)
        length = jnp.sqrt(axis[:, 0] ** 2 + axis[:, 1] ** 2)
        leans = self.is_capsule & (length > 1e-6)
        along_x = jnp.where(leans, axis[:, 0] / jnp.maximum(length, 1e-6), 0.0)
        along_y = jnp.where(leans, axis[:, 1] / jnp.maximum(length, 1e-6), 1.0)
        found = jnp.stack([centre[:, 0], centre[:, 1], 0.5 * distance, distance - self.margin, along_x, along_y], 1)
        chosen = deepest(self.margin - distance, self.contacts)
        found, table = chosen @ found, chosen @ jnp.asarray(self.table)
        movers, friction, weight = table[:, :-2], table[:, -2], table[:, -1]
        depth, along_x, along_y = found[:, 3], found[:, 4:5], found[:, 5:6]

        ox, oy, oz = jnp.split(found[:, :3] - data.subtree_com[1], 3, axis=1)
        rx, ry, rz, vx, vy, vz = data.cdof.T
        x = (vx + ry * oz - rz * oy) * movers
        y = (vy + rz * ox - rx * oz) * movers
        normal = (vz + rx * oy - ry * ox) * movers
        first = friction[:, None] * (along_x * x + along_y * y)
        second = friction[:, None] * (along_x * y - along_y * x)
        jacobian = jnp.concatenate([normal + first, normal - first, normal + second, normal - second])

        stiffness, spring, damping = _soft(*self.softness, depth, weight, self.model.opt.timestep)
        stiffness, spring = jnp.tile(stiffness * (depth < 0), 4), jnp.tile(spring, 4)
        return Rows(jacobian, stiffness, -damping * (jacobian @ data.qvel) - spring, *limits)

    def _limits(self, data: mjx.Data) -> tuple[jax.Array, jax.Array, jax.Array]:
        """`(sign, stiffness, reference)`, each `[nv]`."""
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
        softness = _shared(model.jnt_solref[joint], model.jnt_solimp[joint])
        stiffness, spring, damping = _soft(*softness, depth, model.dof_invweight0[dof], model.opt.timestep)
        reference = -damping * sign * data.qvel[dof] - spring
        spread = jnp.stack([sign, stiffness * (depth < 0), reference]) @ np.eye(nv)[dof]
        return spread[0], spread[1], spread[2]


def newton(
    solve: Callable[[jax.Array, jax.Array], jax.Array],
    inertia: jax.Array,
    force: jax.Array,
    rows: Rows,
    start: jax.Array,
    steps: int,
    line_search: int,
) -> jax.Array:
    """Minimises `a' M a / 2 - a' f + sum(D min(0, J a - a_ref)^2) / 2` over the acceleration a.

    Args:
      solve: `(matrix, vector) -> matrix^-1 vector` of matrices as sparse as M (`tree_solver`): a contact joins only
        degrees of freedom on one way to the root.
      inertia: `[nv, nv]`, M.
      force: `[nv]`, f: all that acts but the constraints.
      rows: the constraints.
      start: `[nv]` where to start: the acceleration of the step before.
      steps: Newton steps.
      line_search: one-dimensional Newton steps on the length of each.

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
        for _ in range(line_search):
            ahead, limit_ahead = slack + length * towards, limit_slack + length * limit_towards
            push = rows.stiffness * (ahead < 0) * towards
            limit_push = rows.limit_stiffness * (limit_ahead < 0) * limit_towards
            slope = slope_0 + length * curvature_0 + push @ ahead + limit_push @ limit_ahead
            curvature = curvature_0 + push @ towards + limit_push @ limit_towards
            low, high = jnp.where(slope < 0, length, low), jnp.where(slope < 0, high, length)
            proposed = length - slope / jnp.maximum(curvature, 1e-12)
            # `high` is infinite only while the slope leads beyond `low`, to a `proposed` that lies between them.
            length = jnp.where((proposed >= low) & (proposed <= high), proposed, 0.5 * (low + high))
        return acceleration + length * direction

    return jax.lax.fori_loop(0, steps, step, start)


def deepest(depth: jax.Array, count: int) -> jax.Array:
    """`[count, n]`, a 1 a row: which of `depth [n]` are the largest, the first of equals first.

    `jax.lax.top_k` as a product: XLA has no kernel for it that fits in a loop.
    """
    place = np.arange(depth.shape[0])
    before = (depth[None, :] > depth[:, None]) | (
        (depth[None, :] == depth[:, None]) & (place[None, :] < place[:, None])
    )
    return (before.sum(axis=1)[None, :] == np.arange(count)[:, None]).astype(depth.dtype)


def _ends(model: mujoco.MjModel, geom: int) -> tuple[float, ...]:
    """Where along its axis (m) a geom can touch a plane."""
    half = model.geom_size[geom, 1]
    return {SPHERE: (0.0,), CAPSULE: (half, -half)}[int(model.geom_type[geom])]


def _movers(model: mujoco.MjModel) -> np.ndarray:
    """`[nbody, nv]`: 1 where a degree of freedom moves a body."""
    movers = np.zeros((model.nbody, model.nv))
    for body in range(1, model.nbody):
        movers[body] = movers[model.body_parentid[body]]
        first = model.body_dofadr[body]
        movers[body, first : first + model.body_dofnum[body]] = 1
    return movers


def _shared(solref: np.ndarray, solimp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The one softness of many constraints: `(solref [2], solimp [5])`."""
    if np.ptp(solref, axis=0).any() or np.ptp(solimp, axis=0).any() or not np.allclose(solimp[0, 3:], (0.5, 2)):
        raise ValueError(
            "Floor expects one solref and one solimp, of midpoint 0.5 and power 2, for all its constraints"
        )
    return solref[0], solimp[0]


def _soft(
    solref: np.ndarray, solimp: np.ndarray, depth: jax.Array, weight: jax.Array, timestep: float
) -> tuple[jax.Array, jax.Array, float]:
    """MuJoCo's soft constraint: `(D, k * impedance * depth, b)` for a depth (below 0: violated) and inverse weight."""
    timeconst, dampratio = max(solref[0], 2 * timestep), solref[1]
    low, high = np.clip(solimp[:2], 1e-4, 0.9999)
    width = solimp[2]
    at = jnp.minimum(jnp.abs(depth) / width, 1.0)
    shape = jnp.where(at < 0.5, 2 * at**2, 1 - 2 * (1 - at) ** 2)  # midpoint 0.5 and power 2, MuJoCo's defaults
    impedance = low + shape * (high - low)
    stiffness = impedance / jnp.maximum((1 - impedance) * weight, 1e-15)
    return stiffness, impedance * depth / (high * timeconst * dampratio) ** 2, 2 / (high * timeconst)
