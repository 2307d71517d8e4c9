"""The pendulum against Gymnasium's, step for step."""

import gymnasium
import jax
import numpy as np
import pytest

from eairl_jax import envs

LENGTH = 200
# angle, speed: hanging, upright, spinning either way at and beyond the limit of 8 rad/s, far from [-pi, pi].
STARTS = np.array([[3.0, 0.0], [0.1, 0.0], [-2.0, 8.0], [1.0, -8.0], [0.5, 7.9], [-1.0, -1.0], [9.0, 0.5]])


def torques(start):
    """Random ones, half of them beyond the limits of 2 N m."""
    return np.random.default_rng(start).uniform(-4, 4, size=(LENGTH, 1)).astype(np.float32)


@pytest.fixture(scope="module")
def gymnasiums():
    """`(states before [S, T, 2], obs after [S, T, 3], reward [S, T])` of Gymnasium's Pendulum-v1."""
    runs = []
    env = gymnasium.make("Pendulum-v1").unwrapped
    for i, start in enumerate(STARTS):
        env.reset(seed=0)
        env.state, run = start.copy(), []
        for torque in torques(i):
            before = env.state.copy()
            obs, reward, *_ = env.step(torque)
            run.append((before, obs, reward))
        runs.append([np.array(column) for column in zip(*run, strict=True)])
    return [np.stack(column) for column in zip(*runs, strict=True)]


@pytest.fixture(scope="module")
def step(compiled_step):
    """`(angle and speed [n, 2], torque [n, 1]) -> the states after one step`."""

    def run(state, torque):
        return compiled_step("pendulum")(state[:, :1], state[:, 1:], np.zeros((len(state), 1)), torque)

    return run


def test_every_step_is_gymnasiums(step, gymnasiums):
    before, obs, reward = gymnasiums
    actions = np.concatenate([torques(i) for i in range(len(STARTS))])
    after = step(before.reshape(-1, 2), actions)
    np.testing.assert_allclose(after.obs, obs.reshape(-1, 3), atol=1e-4)
    np.testing.assert_allclose(after.reward, reward.ravel(), atol=1e-3)
    assert np.abs(obs[..., 2]).max() == 8.0  # the limit was met


def test_whole_episodes_are_gymnasiums(step, gymnasiums):
    _, obs, reward = gymnasiums
    state, states = STARTS, []
    for torque in np.stack([torques(i) for i in range(len(STARTS))], axis=1):
        states.append(step(state, torque))
        physics = states[-1].pipeline_state
        state = np.concatenate([physics.qpos, physics.qvel], axis=1)
    episodes = np.stack([state.obs for state in states], axis=1)
    # A single step is off by the rounding of a float32, which grows where the rod passes close to upright.
    np.testing.assert_allclose(episodes, obs, atol=0.02)
    np.testing.assert_allclose(np.stack([state.reward for state in states], axis=1), reward, atol=0.05)
    assert np.quantile(np.abs(episodes - obs), 0.95) < 1e-3


def test_resets_are_spread_as_gymnasiums():
    pendulum = envs.make("pendulum")
    obs = np.asarray(jax.vmap(pendulum.reset)(jax.random.split(jax.random.PRNGKey(0), 4000)).obs)
    angle, speed = np.arctan2(obs[:, 1], obs[:, 0]), obs[:, 2]
    np.testing.assert_allclose([angle.min(), angle.max()], [-np.pi, np.pi], atol=0.02)
    np.testing.assert_allclose([speed.min(), speed.max()], [-1, 1], atol=0.02)
    np.testing.assert_allclose([angle.std(), speed.std()], [np.pi / np.sqrt(3), 1 / np.sqrt(3)], rtol=0.05)
