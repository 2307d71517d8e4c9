"""Whole trajectories are cut only from rollouts and demonstrations of whole episodes. `test_irl.py` has the samples."""

import pytest

from eairl_jax import InputError, methods
from eairl_jax.discriminator_data import check_segments


@pytest.mark.parametrize(
    "rollout, demonstrations, name", [(7, 10, "rollout_length = 7"), (10, 12, "demonstrations = 12")]
)
def test_lengths_that_would_cut_an_episode_are_refused(tiny, rollout, demonstrations, name):
    config = methods.with_method_defaults(tiny(method="gan_gcl", rollout_length=rollout, ppo_minibatches=1))
    with pytest.raises(InputError, match=f"{name} must be a multiple of episode_length = 5"):
        check_segments(config, demonstrations)


@pytest.mark.parametrize("method, rollout", [("gan_gcl", 10), ("gail", 7)])
def test_whole_episodes_and_single_transitions_are_accepted(tiny, method, rollout):
    config = methods.with_method_defaults(tiny(method=method, rollout_length=rollout, ppo_minibatches=1))
    check_segments(config, 10)
    check_segments(config)
