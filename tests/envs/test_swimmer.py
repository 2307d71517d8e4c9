"""How the swimmer starts. Its model and its steps: `test_locomotion.py`."""

import jax
import numpy as np

import envs


def test_resets_are_spread_as_gymnasiums():
    env = envs.make("swimmer")
    state = jax.vmap(env.reset)(jax.random.split(jax.random.PRNGKey(0), 2000)).pipeline_state
    qpos, qvel = np.asarray(state.qpos) - env.model.qpos0, np.asarray(state.qvel)
    np.testing.assert_allclose([qpos.min(), qpos.max()], [-0.1, 0.1], atol=1e-3)
    np.testing.assert_allclose(qpos.std(axis=0), 0.1 / np.sqrt(3), rtol=0.1)
    np.testing.assert_allclose([qvel.min(), qvel.max()], [-0.1, 0.1], atol=1e-3)
    np.testing.assert_allclose(qvel.std(axis=0), 0.1 / np.sqrt(3), rtol=0.1)
