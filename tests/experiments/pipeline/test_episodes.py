"""Episodes of trained policies, to be drawn."""

import numpy as np

from eairl_jax.experiments.pipeline import policies
from eairl_jax.experiments.pipeline.episodes import play


def test_an_episode_of_each_policy(finished):
    """Each lane plays its seed's episode, whichever lanes are asked for."""
    trained = policies.load(finished)
    assert (trained.task, trained.seeds) == ("pendulum", [0, 1])
    both, second = play(trained), play(trained, [1])
    assert both.qpos.shape == (2, 201, 1)
    assert both.returns.shape == (2,)
    np.testing.assert_allclose(second.qpos[0], both.qpos[1], rtol=1e-3, atol=1e-4)
