"""The swimmer's steps and starts."""

import jax
import numpy as np

from eairl_jax import envs


def test_a_step_is_clipped_scored_and_never_the_last(compiled_step):
    step = compiled_step("swimmer")
    physics = step.env.reset(jax.random.PRNGKey(0)).pipeline_state
    start = [np.tile(x, (2, 1)) for x in (physics.qpos, physics.qvel, physics.qacc_warmstart)]
    after = step(*start, np.array([[1.0, -1.0], [5.0, -9.0]]))
    np.testing.assert_array_equal(after.obs[0], after.obs[1])
    np.testing.assert_array_equal(after.reward[0], after.reward[1])
    moved = after.pipeline_state.qpos[0, 0] - physics.qpos[0]
    np.testing.assert_allclose(after.reward[0], moved / 0.04 - 1e-4 * 2, atol=1e-6)
    assert (step.env.episode_length, after.done[0]) == (500, 0.0)


def test_starts_are_spread_as_gymnasiums():
    env = envs.make("swimmer")
    qpos, qvel = map(np.asarray, jax.vmap(env.initial)(jax.random.split(jax.random.PRNGKey(0), 2000)))
    for start in (qpos - env.model.qpos0, qvel):
        np.testing.assert_allclose([start.min(), start.max()], [-0.1, 0.1], atol=1e-3)
        np.testing.assert_allclose(start.std(axis=0), 0.1 / np.sqrt(3), rtol=0.1)
