"""Steps of the walkers and the swimmer, compared with Gymnasium's environments and with the C engine."""

import contextlib
import re
from pathlib import Path
from types import SimpleNamespace

import gymnasium
import jax
import mujoco
import numpy as np
import pytest

from eairl_jax import envs
from eairl_jax.envs import c_engine

STEPS, EPISODE = 400, 40
TASKS = ("ant", "crippled_ant", "half_cheetah", "swimmer")
# Two legs of the crippled ant are sound, so its steps are a test of the ant's too, and of one program less.
STEPPED = ("crippled_ant", "half_cheetah", "swimmer")


def gymnasiums(task, folder):
    """Gymnasium's environment of a task, with Gymnasium's model; for the ants, whose motors differ, with the task's."""
    if "ant" not in task:
        with contextlib.chdir(folder):  # mujoco 4 logs there that the cheetah's model is of an old style
            return gymnasium.make({"half_cheetah": "HalfCheetah-v5", "swimmer": "Swimmer-v5"}[task]).unwrapped
    return c_engine.make(envs.make(task, fidelity="exact")).env


@pytest.fixture(scope="module", params=STEPPED)
def played(request, tmp_path_factory):
    """Episodes of random actions in Gymnasium's environment, every fourth from any orientation or angle."""
    env = gymnasiums(request.param, tmp_path_factory.mktemp("log"))
    rng, run = np.random.default_rng(0), []
    for t in range(STEPS):
        if t % EPISODE == 0:
            env.reset(seed=t)
            if t // EPISODE % 4 == 3:
                turned, qpos = rng.normal(size=4 if "ant" in request.param else 1), env.data.qpos.copy()
                if len(turned) == 4:
                    qpos[3:7] = turned / np.linalg.norm(turned)
                else:
                    qpos[2:3] = turned
                env.set_state(qpos, env.data.qvel)
        if t % 3 == 0:
            action = rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        before = [x.copy() for x in (env.data.qpos, env.data.qvel, env.data.qacc_warmstart)]
        obs, reward, terminated, truncated, info = env.step(action)
        assert (terminated, truncated) == (False, False)
        if "ant" in request.param:
            # Gymnasium reads the torso's x a physics step late; the displacement itself is of positions.
            forward = (env.data.qpos[0] - before[0][0]) / env.dt
            reward = forward + info["reward_ctrl"] + info["reward_survive"] - 1.0
        run.append((*before, action, obs, reward))
    names = ("qpos", "qvel", "warmstart", "action", "obs", "reward")
    columns = {name: np.array(column) for name, column in zip(names, zip(*run, strict=True), strict=True)}
    return SimpleNamespace(task=request.param, dt=env.dt, **columns)


def test_exact_steps_and_rewards_are_gymnasiums(played, compiled_step):
    step = compiled_step(played.task, "exact")
    np.testing.assert_allclose(step.env.dt, played.dt)
    after = step(played.qpos, played.qvel, played.warmstart, played.action)
    error = np.abs(after.obs - played.obs).max(axis=-1)
    # Measured: 1.5e-5 and 3e-4. A float32 on the other side of a contact's margin turns a few steps of the ants.
    assert np.median(error) < 1e-4
    assert np.quantile(error, 0.99) < 0.01
    assert np.quantile(np.abs(after.reward - played.reward), 0.99) < 1e-3
    if "ant" not in played.task:
        assert error.max() < 0.01


def experts(env, task):
    """`(qpos, qvel, warmstart, action)` of 200 moments of the shipped expert's episodes, x and y put at 0."""
    with np.load(Path(envs.__file__).parent.parent / "experiments" / "data" / f"{task}.npz") as demos:
        obs, action = demos["obs"], np.clip(demos["action"], -1, 1)
    observed, data, run = env.model.nq - env.first_observed, mujoco.MjData(env.model), []
    for episode, t in np.ndindex(len(obs), 10):
        t = 50 * t
        # The step to the moment, for the warm start that it leaves.
        mujoco.mj_resetData(env.model, data)
        data.qpos[env.first_observed :], data.qvel[:] = np.split(obs[episode, t], [observed])
        data.ctrl[:] = action[episode, t]
        mujoco.mj_step(env.model, data, nstep=env.frame_skip)
        run.append([x.copy() for x in (data.qpos, data.qvel, data.qacc_warmstart, action[episode, t + 1])])
    return [np.array(column) for column in zip(*run, strict=True)]


def test_fast_steps_are_the_c_engines_on_the_same_model(played, compiled_step):
    step = compiled_step(played.task)
    env = step.env
    drawn = (played.qpos, played.qvel, played.warmstart, played.action)
    states = [np.concatenate(pair) for pair in zip(drawn, experts(env, played.task), strict=True)]
    obs = step(*states).obs
    data, expected, contacts = mujoco.MjData(env.model), [], 0
    assert (env.model.opt.iterations, env.model.opt.tolerance) == (100, 1e-8)
    for qpos, qvel, warmstart, action in zip(*states, strict=True):
        data.qpos[:], data.qvel[:], data.qacc_warmstart[:], data.ctrl[:] = qpos, qvel, warmstart, action
        mujoco.mj_step(env.model, data, nstep=env.frame_skip)
        expected.append(np.concatenate([data.qpos[env.first_observed :], data.qvel]))
        contacts = max(contacts, data.ncon)
    expected = np.array(expected)
    error = (np.abs(obs - expected) / expected.std(axis=0)).max(axis=-1)
    # In standard deviations of the worst observation. Measured: medians 2e-6; 95 % of the ants' 0.14, others' 1e-5.
    for errors in (error[:STEPS], error[STEPS:]):  # of random actions, of the expert
        assert np.median(errors) < 1e-4
        assert np.quantile(errors, 0.95) < (0.3 if "ant" in played.task else 1e-3)
    assert contacts <= env.fidelity.max_contacts  # every contact got its rows


@pytest.mark.parametrize("task", TASKS)
def test_models_are_gymnasiums_but_for_the_ants_motors(task, tmp_path):
    theirs = gymnasiums(task, tmp_path).model
    if task == "ant":
        theirs = mujoco.MjModel.from_xml_path(str(Path(gymnasium.__file__).parent / "envs/mujoco/assets/ant.xml"))
    ours = envs.make(task, fidelity="exact").model
    theirs.geom_size[theirs.geom_type == mujoco.mjtGeom.mjGEOM_PLANE, :2] = 0  # how far it is drawn
    skipped = {"geom_matid", "geom_rgba", "geom_user", "geom_condim" if task == "swimmer" else ""}
    if task == "ant":
        np.testing.assert_array_equal(ours.actuator_gear * 5, theirs.actuator_gear)
        skipped |= {"actuator_gear", "actuator_acc0"}
    kinds = ("body", "jnt", "dof", "geom", "actuator")
    fields = [f for f in dir(ours) if f.split("_")[0] in kinds and isinstance(getattr(ours, f), np.ndarray)]
    assert len(fields) > 80
    for field in set(fields) - skipped:
        np.testing.assert_allclose(getattr(ours, field), getattr(theirs, field), rtol=1e-4, atol=1e-6, err_msg=field)
    for option in ("timestep", "integrator", "solver", "cone", "density", "viscosity", "gravity", "iterations"):
        np.testing.assert_array_equal(getattr(ours.opt, option), getattr(theirs.opt, option), err_msg=option)


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("fidelity", ["fast", "exact"])
def test_the_docstrings_tables_are_the_models(task, fidelity):
    env = envs.make(task, fidelity=fidelity)
    model, rows = (
        env.model,
        re.findall(r"^ *\| (\d+) +\| (.*?) *\| (.*?) *\| (.*?) *\|$", type(env).__doc__, re.MULTILINE),
    )
    observed, motors = rows[: env.observation_size], rows[env.observation_size :]
    positions = model.nq - env.first_observed
    for joint in range(model.njnt):
        name = model.joint(joint).name
        angle, speed = (
            observed[i] if i >= 0 else None
            for i in (model.jnt_qposadr[joint] - env.first_observed, positions + model.jnt_dofadr[joint])
        )
        if model.jnt_type[joint] in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            hinge = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
            assert speed[1:3] == (f"{'angular ' * hinge}velocity of {name}", "rad/s" if hinge else "m/s")
            if angle:
                limits = "[{:.3g}, {:.3g}]".format(*model.jnt_range[joint]) if model.jnt_limited[joint] else "any"
                assert angle[1:] == (f"{'angle' if hinge else 'position'} of {name}", "rad" if hinge else "m", limits)
    for i, motor in enumerate(motors):
        joint = model.joint(model.actuator_trnid[i, 0]).name
        gear = model.actuator_gear[i, 0]
        assert motor[1] == f"torque at {joint}"
        assert motor[2] == f"{gear:g} N m" or gear == 1.0  # a crippled leg's


@pytest.mark.parametrize("task", ["ant", "half_cheetah"])
def test_resets_are_spread_as_gymnasiums(task):
    env = envs.make(task)
    state = jax.vmap(env.reset)(jax.random.split(jax.random.PRNGKey(0), 2000)).pipeline_state
    moved, qvel = np.asarray(state.qpos) - env.model.qpos0, np.asarray(state.qvel)
    if task == "ant":  # whose quaternion is made one again
        np.testing.assert_allclose(np.linalg.norm(state.qpos[:, 3:7], axis=1), 1, atol=1e-5)
        moved = np.delete(moved, np.s_[3:7], axis=1)
    np.testing.assert_allclose([moved.min(), moved.max()], [-0.1, 0.1], atol=1e-3)
    np.testing.assert_allclose(moved.std(axis=0), 0.1 / np.sqrt(3), rtol=0.1)
    np.testing.assert_allclose(qvel.std(axis=0), 0.1, rtol=0.1)
    assert np.abs(qvel).max() > 0.3  # normal, not uniform


@pytest.mark.parametrize("task", TASKS)
def test_an_unknown_fidelity_is_answered_with_the_known(task):
    with pytest.raises(envs.TaskError, match="fidelity = 'quick': expected one of fast, exact"):
        envs.make(task, fidelity="quick")
