"""The C engine says of a step what MJX says of it."""

import jax
import numpy as np
import pytest

import envs


@pytest.mark.parametrize("task", envs.TASKS)
def test_first_steps_agree(task):
    env = envs.make(task)
    referee, step, rng = env.referee(), jax.jit(env.step), np.random.default_rng(0)
    state = env.reset(jax.random.PRNGKey(1))
    obs = referee.start(np.asarray(state.pipeline_state.qpos), np.asarray(state.pipeline_state.qvel))
    np.testing.assert_allclose(obs, state.obs, atol=1e-6)
    rewards = []
    for _ in range(3):
        action = rng.uniform(-env.action_limit, env.action_limit, env.action_size).astype(np.float32)
        state = step(state, action)
        obs, reward = referee.step(action)
        # Gymnasium's ant reads the torso's x a physics step late.
        np.testing.assert_allclose(reward, state.reward, atol=0.2 if "ant" in task else 1e-3)
        np.testing.assert_allclose(obs, state.obs, atol=1e-3 * (1 + np.abs(obs).max()))
        rewards.append(reward)
    assert np.std(rewards) > 0


def test_an_episode_can_begin_anew():
    referee = envs.make("point_maze_left").referee()
    returns = []
    for _ in range(2):
        referee.start(np.array([0.3, 0.0]), np.zeros(2))
        returns.append([referee.step(np.array([0.5, 1.0])) for _ in range(4)])
    for (obs, reward), (again, reward_again) in zip(*returns, strict=True):
        np.testing.assert_array_equal(obs, again)
        assert reward == reward_again
