"""The C engine says of a step what MJX says of it."""

import jax
import numpy as np
import pytest

from eairl_jax import envs

STEPS = 20


def play(task, change):
    """`(obs, rewards)` of MJX and of the referee, `[STEPS, obs]` and `[STEPS]`, from a start that `change` has made."""
    env = envs.make(task)
    referee, step, rng = env.referee(), jax.jit(env.step), np.random.default_rng(0)
    state = env.reset(jax.random.PRNGKey(1))
    physics = change(state.pipeline_state)
    state = state.replace(pipeline_state=physics, obs=env.observe(physics))
    first = referee.start(np.asarray(physics.qpos), np.asarray(physics.qvel))
    np.testing.assert_allclose(first, state.obs, atol=1e-6)
    ours, theirs = [], []
    for _ in range(STEPS):
        action = rng.uniform(-env.action_limit, env.action_limit, env.action_size).astype(np.float32)
        state = step(state, action)
        ours.append((np.asarray(state.obs), float(state.reward)))
        theirs.append(referee.step(action))
    return [[np.array(column) for column in zip(*steps, strict=True)] for steps in (ours, theirs)]


@pytest.mark.parametrize("task", envs.TASKS)
def test_episodes_agree(task):
    (obs, reward), (their_obs, their_reward) = play(task, lambda physics: physics)
    np.testing.assert_allclose(their_obs[:3], obs[:3], atol=1e-3 * (1 + np.abs(obs[:3]).max()))
    assert np.std(reward) > 0
    if "ant" not in task:  # Gymnasium's ant reads the torso's x a physics step late
        np.testing.assert_allclose(their_reward[:3], reward[:3], atol=1e-3 * (1 + np.abs(reward).max()))


def test_an_ants_reward_is_its_way_and_its_cost():
    (_, reward), (_, theirs) = play("ant", lambda physics: physics.replace(qvel=physics.qvel.at[0].set(4.0)))
    assert reward.sum() > 5
    np.testing.assert_allclose(theirs.sum(), reward.sum(), rtol=0.1)


def test_an_ant_near_the_ground_pays_for_it():
    (_, reward), (_, theirs) = play("ant", lambda physics: physics.replace(qvel=physics.qvel.at[2].set(-20.0)))
    assert reward[0] < -0.5
    assert theirs[0] < -0.5


def test_an_episode_can_begin_anew():
    referee = envs.make("point_maze_left").referee()
    returns = []
    for _ in range(2):
        referee.start(np.array([0.3, 0.0]), np.zeros(2))
        returns.append([referee.step(np.array([0.5, 1.0])) for _ in range(4)])
    for (obs, reward), (again, reward_again) in zip(*returns, strict=True):
        np.testing.assert_array_equal(obs, again)
        assert reward == reward_again
