"""The pendulum against Gymnasium's, step for step."""

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import envs
from eairl_jax.envs.mjx_task import Physics

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
def pendulum():
    return envs.make("pendulum")


@pytest.fixture(scope="module")
def step(pendulum):
    """`(angle and speed [2], torque [1]) -> (angle and speed [2], obs, reward)`."""

    def run(state, torque):
        blank = pendulum.reset(jax.random.PRNGKey(0))
        after = pendulum.step(blank.replace(pipeline_state=Physics(state[:1], state[1:], jnp.zeros(1))), torque)
        return jnp.concatenate([after.pipeline_state.qpos, after.pipeline_state.qvel]), after.obs, after.reward

    return run


def test_every_step_is_gymnasiums(step, gymnasiums):
    before, obs, reward = gymnasiums
    actions = np.stack([torques(i) for i in range(len(STARTS))])
    _, ours, our_reward = jax.jit(jax.vmap(jax.vmap(step)))(jnp.asarray(before, jnp.float32), actions)
    np.testing.assert_allclose(ours, obs, atol=1e-4)
    np.testing.assert_allclose(our_reward, reward, atol=1e-3)
    assert np.abs(obs[..., 2]).max() == 8.0  # the limit was met


def test_whole_episodes_are_gymnasiums(step, gymnasiums):
    _, obs, reward = gymnasiums
    actions = jnp.asarray(np.stack([torques(i) for i in range(len(STARTS))]))

    def carry_on(state, torque):
        state, *seen = step(state, torque)
        return state, seen

    episode = jax.jit(jax.vmap(lambda start, actions: jax.lax.scan(carry_on, start, actions)[1]))
    ours, our_reward = episode(jnp.asarray(STARTS, jnp.float32), actions)
    # A single step is off by the rounding of a float32, which grows where the rod passes close to upright.
    np.testing.assert_allclose(ours, obs, atol=0.02)
    np.testing.assert_allclose(our_reward, reward, atol=0.05)
    assert np.quantile(np.abs(ours - obs), 0.95) < 1e-3


def test_resets_are_spread_as_gymnasiums(pendulum):
    obs = np.asarray(jax.vmap(pendulum.reset)(jax.random.split(jax.random.PRNGKey(0), 4000)).obs)
    angle, speed = np.arctan2(obs[:, 1], obs[:, 0]), obs[:, 2]
    np.testing.assert_allclose([angle.min(), angle.max()], [-np.pi, np.pi], atol=0.02)
    np.testing.assert_allclose([speed.min(), speed.max()], [-1, 1], atol=0.02)
    np.testing.assert_allclose([angle.std(), speed.std()], [np.pi / np.sqrt(3), 1 / np.sqrt(3)], rtol=0.05)
