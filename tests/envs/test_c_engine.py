"""The C engine says of a step what MJX says of it."""

import jax
import numpy as np
import pytest

from eairl_jax import envs
from eairl_jax.envs import c_engine

STEPS = 20


@pytest.fixture
def play(compiled_step):
    """Plays a task from a start made by `change`: `(obs [STEPS, obs], rewards [STEPS])` of MJX and the C engine."""

    def run(task, change):
        step = compiled_step(task)
        env, engine, rng = step.env, c_engine.make(step.env), np.random.default_rng(0)
        physics = change(env.reset(jax.random.PRNGKey(1)).pipeline_state)
        first = engine.start(np.asarray(physics.qpos), np.asarray(physics.qvel))
        np.testing.assert_allclose(first, env.observe(physics), atol=1e-6)
        physics, mjx, c = jax.tree.map(lambda x: x[None], physics), [], []
        for _ in range(STEPS):
            action = rng.uniform(-env.action_limit, env.action_limit, env.action_size).astype(np.float32)
            state = step(physics.qpos, physics.qvel, physics.qacc_warmstart, action[None])
            physics = state.pipeline_state
            mjx.append((state.obs[0], float(state.reward[0])))
            c.append(engine.step(action))
        return [[np.array(column) for column in zip(*steps, strict=True)] for steps in (mjx, c)]

    return run


@pytest.mark.parametrize("task", envs.TASKS)
def test_episodes_agree(task, play):
    (obs, reward), (c_obs, c_reward) = play(task, lambda physics: physics)
    np.testing.assert_allclose(c_obs[:3], obs[:3], atol=1e-3 * (1 + np.abs(obs[:3]).max()))
    assert np.std(reward) > 0
    if "ant" not in task:  # Gymnasium's ant reads the torso's x a physics step late
        np.testing.assert_allclose(c_reward[:3], reward[:3], atol=1e-3 * (1 + np.abs(reward).max()))


def test_an_ants_reward_is_its_way_and_its_cost(play):
    (_, reward), (_, c_reward) = play("ant", lambda physics: physics.replace(qvel=physics.qvel.at[0].set(4.0)))
    assert reward.sum() > 5
    np.testing.assert_allclose(c_reward.sum(), reward.sum(), rtol=0.1)


def test_an_ant_near_the_ground_pays_for_it(play):
    (_, reward), (_, c_reward) = play("ant", lambda physics: physics.replace(qvel=physics.qvel.at[2].set(-20.0)))
    assert reward[0] < -0.5
    assert c_reward[0] < -0.5


def test_an_episode_can_begin_anew():
    engine = c_engine.make(envs.make("point_maze_left"))
    returns = []
    for _ in range(2):
        engine.start(np.array([0.3, 0.0]), np.zeros(2))
        returns.append([engine.step(np.array([0.5, 1.0])) for _ in range(4)])
    for (obs, reward), (again, reward_again) in zip(*returns, strict=True):
        np.testing.assert_array_equal(obs, again)
        assert reward == reward_again


def test_gymnasium_computes_a_task_that_declares_an_environment_and_mujoco_the_others():
    kinds = {task: type(c_engine.make(envs.make(task))) for task in ("pendulum", "point_maze_right", "swimmer")}
    expected = (c_engine.GymnasiumPendulum, c_engine.MujocoCEngine, c_engine.GymnasiumMujoco)
    assert tuple(kinds.values()) == expected
