"""Whole trajectories are cut only from rollouts and demonstrations of whole episodes. `test_irl.py` has the samples."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import HParams, InputError, horizon, methods
from eairl_jax.discriminator_data import check_segments, for_loss, for_policy_reward
from eairl_jax.gaussian import Gaussian
from eairl_jax.normalize import ObsStats


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


def test_in_the_absorbing_state_the_discriminator_sees_no_action_and_no_log_pi(tiny, transitions):
    config, raw = methods.with_method_defaults(tiny(method="airl_sa", horizon="absorbing")), transitions()
    ended = np.zeros((6, 4), np.float32)
    ended[3:, :2] = 1.0
    raw = raw._replace(obs=horizon.absorb(jnp.asarray(raw.obs), jnp.asarray(ended)))
    raw = raw._replace(next_obs=raw.obs, terminated=ended)
    acting = SimpleNamespace(obs_stats=ObsStats(jnp.zeros(5), jnp.ones(5), jnp.zeros(())))
    narrow = Gaussian(jnp.zeros((6, 4, 2)), jnp.full((6, 4, 2), -1.0))
    for samples, log_prob in (
        (for_policy_reward(raw, None, (), acting, HParams(), config), raw.log_prob),
        (for_loss(raw, lambda _obs: narrow, None, (), acting, HParams(), config), narrow.log_prob(raw.action)),
    ):
        np.testing.assert_allclose(samples.log_prob, np.where(ended > 0, 0.0, log_prob), rtol=1e-6)
        np.testing.assert_array_equal(samples.action, np.where(ended[..., None] > 0, 0.0, raw.action))
        assert not samples.terminated.any()  # the shaping of the absorbing state is that of a state which goes on
