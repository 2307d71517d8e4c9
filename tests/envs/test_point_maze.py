"""The maze against MuJoCo's C engine at full precision, and its passages."""

from types import SimpleNamespace

import jax
import mujoco
import numpy as np
import pytest

from eairl_jax import envs
from eairl_jax.envs.point_maze import GOAL, START

LENGTH = 300
PUSHES, RANDOM = slice(0, 8), slice(8, 14)  # the scripts below that push steadily, and those drawn at random


def scripts():
    """Forces `[script, LENGTH, 2]`: into every wall, two corners, the barrier, along the barrier, and at random."""
    rng, t = np.random.default_rng(0), np.arange(LENGTH)
    pushes = np.array([(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1)], np.float32)
    steady = [np.tile(push, (LENGTH, 1)) for push in pushes]
    sliding = [np.stack([sign * 0.6 * np.sin(t / 20), np.full(LENGTH, 0.7)], axis=-1) for sign in (-1, 1)]
    held = [np.repeat(rng.uniform(-1.5, 1.5, size=(LENGTH // 15, 2)), 15, axis=0) for _ in range(6)]
    return np.stack(steady + sliding + held).astype(np.float32)


def c_engine(env, forces):
    """Positions `[LENGTH, 2]` by MuJoCo's C engine, from the start at rest."""
    data = mujoco.MjData(env.model)
    data.qpos[:] = START
    positions = []
    for force in forces:
        data.ctrl[:] = force(data) if callable(force) else force
        mujoco.mj_step(env.model, data, nstep=env.frame_skip)
        positions.append(data.qpos.copy())
    return np.array(positions)


@pytest.fixture(scope="module", params=["left", "right"])
def played(request, compiled_step):
    """The scripts played in one maze: by MJX `position`, `reward`; by the C engine at full precision `exact`."""
    step, forces = compiled_step(f"point_maze_{request.param}"), scripts()
    qpos = np.tile(START, (len(forces), 1))
    qvel, warmstart = np.zeros_like(qpos), np.zeros_like(qpos)
    positions, rewards = [], []
    for force in forces.swapaxes(0, 1):
        state = step(qpos, qvel, warmstart, force)
        physics = state.pipeline_state
        qpos, qvel, warmstart = physics.qpos, physics.qvel, physics.qacc_warmstart
        positions.append(state.obs)
        rewards.append(state.reward)
    position, reward = np.stack(positions, axis=1), np.stack(rewards, axis=1)
    full = envs.make(f"point_maze_{request.param}", solver_iterations=100, line_search_iterations=50)
    assert (full.model.opt.iterations, full.model.opt.ls_iterations) == (100, 50)
    exact = np.stack([c_engine(full, forces) for forces in scripts()])
    return SimpleNamespace(position=position, reward=reward, exact=exact)


def test_positions_are_the_c_engines(played):
    error = np.linalg.norm(played.position - played.exact, axis=-1)
    assert error[PUSHES].max() < 0.002
    # Thrown at random into walls and barrier at full speed, one Newton step leaves a third of the radius at most.
    assert error[RANDOM].max() < 0.01
    assert (error[RANDOM] > 0.002).mean() < 0.1
    assert np.median(error) < 1e-5


def test_walls_and_barrier_hold(played):
    # The point's radius is 0.03, and a wall gives way a little when it is hit.
    assert played.position.min() > -0.1 + 0.02
    assert played.position.max() < 0.6 - 0.02
    west, east, south, north = played.position[:4, -1]
    np.testing.assert_allclose([west[0], east[0], south[1]], [-0.07, 0.57, -0.07], atol=0.001)
    # Straight ahead stands the barrier, of radius 0.02, in both mazes.
    np.testing.assert_allclose(north[1], 0.3 - 0.02 - 0.03, atol=0.001)


def test_reward_is_of_the_position_before_and_the_clipped_action(played):
    forces = scripts()
    assert np.abs(forces).max() > 1.4
    start = np.broadcast_to(np.array(START, np.float32), (len(forces), 1, 2))
    before = np.concatenate([start, played.position[:, :-1]], axis=1)
    expected = -np.linalg.norm(before - [0.3, 0.5], axis=-1) - 0.001 * (np.clip(forces, -1, 1) ** 2).sum(axis=-1)
    np.testing.assert_allclose(played.reward, expected, atol=1e-5)


@pytest.mark.parametrize(
    ("passage", "way", "passes"),
    [
        ("left", "left", True),
        ("left", "right", False),
        ("right", "left", False),
        ("right", "right", True),
        ("middle", "left", False),
        ("middle", "middle", True),
        ("middle", "right", False),
        ("double", "left", False),
        ("double", "right", False),
        ("double", "both", True),
    ],
)
def test_the_barrier_can_be_passed_where_its_name_says_and_nowhere_else(passage, way, passes):
    x, further = {"left": (0.05, 0.05), "right": (0.5, 0.5), "middle": (0.25, 0.25), "both": (0.05, 0.5)}[way]
    waypoints = np.repeat([(x, 0.1), (x, 0.285), (further, 0.285), (further, 0.5), GOAL], 30, axis=0)
    # A spring to the waypoint and a brake; the engine clips the force.
    steer = [lambda data, w=w: 20 * (w - data.qpos) - 2 * data.qvel for w in waypoints]
    path = c_engine(envs.make(f"point_maze_{passage}"), steer)
    if passes:
        np.testing.assert_allclose(path[-1], GOAL, atol=0.02)
    else:
        # Where the passage is in the middle, the point comes to it along the barrier as soon as it heads for the goal.
        path = path[:-30] if passage == "middle" else path
        assert path[:, 1].max() < {"double": 0.33}.get(passage, 0.26)


def test_episodes_start_in_the_middle_almost_at_rest():
    env = envs.make("point_maze_left")
    state = jax.vmap(env.reset)(jax.random.split(jax.random.PRNGKey(0), 500))
    np.testing.assert_allclose(state.obs, np.tile([0.3, 0.0], (500, 1)), atol=1e-7)
    speed = np.asarray(state.pipeline_state.qvel)
    np.testing.assert_allclose([speed.min(), speed.max()], [-0.01, 0.01], atol=0.001)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (dict(passage="top"), "passage = 'top': expected left or right or middle or double"),
        (dict(solver_iterations=0), "solver_iterations = 0, .* expected at least 1 of each"),
    ],
)
def test_impossible_settings_are_refused(settings, message):
    with pytest.raises(envs.TaskError, match=message):
        envs.make("point_maze_left", **settings)
