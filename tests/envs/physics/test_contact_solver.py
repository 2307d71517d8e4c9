"""Contacts and joint limits against the C engine, in double precision."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from eairl_jax import envs
from eairl_jax.envs.mjx_task import Physics, mjx
from eairl_jax.envs.physics.contact_solver import ConstraintRows, FloorConstraints, newton
from eairl_jax.envs.physics.tree_solver import tree_solver

# Two legs of the crippled ant are sound, so its constraints are a test of the ant's too.
TASKS = ("crippled_ant", "half_cheetah", "swimmer")


def fallen(model, count=100):
    """States `(qpos, qvel)` at and after a fall from any orientation with random velocities, by the C engine."""
    rng, data, states = np.random.default_rng(0), mujoco.MjData(model), []
    for i in range(count):
        if i % 10 == 0:
            mujoco.mj_resetData(model, data)
            data.qvel[:] = rng.normal(size=model.nv)
            if model.nq == 15:
                data.qpos[3:7] = rng.normal(size=4)
                data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
            else:
                data.qpos[2] = rng.uniform(-3, 3)
        data.ctrl[:] = rng.uniform(-1, 1, model.nu)
        mujoco.mj_step(model, data, nstep=15)
        states.append((data.qpos.copy(), data.qvel.copy(), data.qacc_warmstart.copy(), data.ctrl.copy()))
    return [np.array(column) for column in zip(*states, strict=True)]


@pytest.mark.parametrize("task", TASKS)
def test_accelerations_are_the_c_engines(task):
    with jax.enable_x64(True):
        env = envs.make(task, fidelity="exact")
        states = fallen(env.model)

        def acceleration(qpos, qvel, warmstart, ctrl):
            return env._acceleration(Physics(qpos, qvel, warmstart), ctrl)

        qacc, inertia = jax.tree.map(np.asarray, jax.jit(jax.vmap(acceleration))(*map(jnp.asarray, states)))
    data, contacts, limits = mujoco.MjData(env.model), 0, 0
    full = np.zeros((env.model.nv, env.model.nv))
    for i, (qpos, qvel, warmstart, ctrl) in enumerate(zip(*states, strict=True)):
        data.qpos[:], data.qvel[:], data.qacc_warmstart[:], data.ctrl[:] = qpos, qvel, warmstart, ctrl
        mujoco.mj_forward(env.model, data)
        contacts, limits = contacts + data.ncon, limits + data.nl
        mujoco.mj_fullM(env.model, data, full)
        np.testing.assert_allclose(inertia[i], full, atol=1e-5)
        np.testing.assert_allclose(qacc[i], data.qacc, atol=1e-3 * (1 + np.abs(data.qacc).max()))
    assert limits > 20
    assert contacts > 50 or task == "swimmer"


POINTS = """
<mujoco>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body pos="0 0 0.1">
      <joint type="slide" axis="0 0 1" limited="true" range="-1 1" {limit}/>
      <geom type="sphere" size="0.11"/>
      <geom type="sphere" size="0.14" pos="1 0 0"/>
      <geom type="capsule" size="0.1" fromto="2 0 -0.02 3 0 0.5"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize(("contacts", "depths"), [(10, [0.01, 0.04, 0.02]), (2, [0.04, 0.02]), (1, [0.04])])
def test_the_deepest_points_get_rows(contacts, depths):
    model = mujoco.MjModel.from_xml_string(POINTS.format(limit=""))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    by_depth = {round(-depth, 6): stiffness for depth, stiffness in zip(data.efc_pos, data.efc_D, strict=True)}
    mjx_model = mjx.put_model(model)
    blank, constraints = mjx.make_data(mjx_model), FloorConstraints(model, contacts)
    rows = jax.jit(lambda data: constraints.rows(mjx.com_pos(mjx_model, mjx.kinematics(mjx_model, data))))(blank)
    touching = np.asarray(rows.stiffness)[np.asarray(rows.stiffness) > 0]
    np.testing.assert_allclose(np.sort(touching), np.sort(np.repeat([by_depth[d] for d in depths], 4)), rtol=1e-4)
    np.testing.assert_array_equal(rows.jacobian[: len(depths)], np.ones((len(depths), 1)))


def test_constraints_of_two_kinds_are_refused():
    constraints = FloorConstraints(
        mujoco.MjModel.from_xml_string(POINTS.format(limit='solimplimit="0.9 0.95 0.001 0.4 2"')), 2
    )
    with pytest.raises(ValueError, match="one solref and one solimp"):
        constraints.rows(mjx.make_data(constraints.model))


def test_contacts_of_two_kinds_are_refused():
    mjcf = POINTS.replace('<geom type="sphere" size="0.14"', '<geom type="sphere" size="0.14" solref="0.03 1"')
    with pytest.raises(ValueError, match="one solref and one solimp"):
        FloorConstraints(mujoco.MjModel.from_xml_string(mjcf.format(limit="")), 2)


def test_a_body_without_joint_limits_has_none_to_keep():
    model = mujoco.MjModel.from_xml_string(POINTS.format(limit="").replace('limited="true" range="-1 1"', ""))
    mjx_model, blank = mjx.put_model(model), mjx.make_data(model)
    rows = jax.jit(lambda data: FloorConstraints(model, 1).rows(mjx.com_pos(mjx_model, data)))(blank)
    np.testing.assert_array_equal(rows.limit_stiffness, [0])


def test_newton_minimises_by_hand():
    # 2 a^2 / 2 - 4 a alone is least at a = 2; a row that asks for a >= 3 with stiffness 6 pulls it to (4 + 18) / 8,
    # and a limit that asks for a <= 1 with stiffness 2 instead, to (4 + 2) / 4.
    def solve(stiffness, limit_stiffness):
        rows = ConstraintRows(*(jnp.array(x, float) for x in ([[1]], [stiffness], [3], [-1], [limit_stiffness], [-1])))
        one, force, start = tree_solver([-1]), jnp.array([4.0]), jnp.array([50.0])
        return newton(one, jnp.array([[2.0]]), force, rows, start, steps=4, line_search_steps=3)

    np.testing.assert_allclose([solve(0, 0)[0], solve(6, 0)[0], solve(0, 2)[0]], [2.0, 22 / 8, 6 / 4], rtol=1e-5)
