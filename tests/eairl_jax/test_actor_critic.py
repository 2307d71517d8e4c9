"""What the policy optimisers share: reward scale, advantages, minibatches."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import HParams
from eairl_jax.actor_critic import ActorCritic, PolicyState, scale_rewards, shuffle
from eairl_jax.gae import gae


def test_shuffle_takes_every_row_once_an_epoch_in_a_new_order():
    rows = [np.asarray(shuffle(jax.random.PRNGKey(seed), 24, 3, 4)) for seed in (0, 1)]
    epochs = np.stack(rows).reshape(6, 24)
    assert rows[0].shape == (12, 6)
    np.testing.assert_array_equal(np.sort(epochs), np.tile(np.arange(24), (6, 1)))
    assert len({tuple(epoch) for epoch in (*epochs, range(24))}) == 7


def test_rewards_are_divided_by_the_running_std_of_the_discounted_return(transitions):
    policy, expected_var = PolicyState((), *jnp.zeros((3,))), 0.0
    for i in range(1, 14):
        x = transitions(seed=i)
        done = x.terminated + x.truncated
        policy, scaled = scale_rewards(policy, jnp.asarray(x.reward), jnp.asarray(done), 0.9)
        total, totals = np.zeros(4), np.zeros((6, 4))
        for t in range(6):
            totals[t] = total = x.reward[t] + 0.9 * total
            total = np.where(done[t] > 0, 0.0, total)
        # A plain mean over the first ten iterations, then a memory of ten.
        weight = 1 / min(i, 10)
        expected_var = (1 - weight) * expected_var + weight * totals.var()
        np.testing.assert_allclose(scaled, x.reward / np.sqrt(expected_var), rtol=1e-4)


def test_advantages_are_standardised_and_the_value_functions_share_is_reported(tiny, transitions, mlp):
    nets, batch = ActorCritic.build(2, tiny()), jax.tree.map(jnp.asarray, transitions())
    policy, hparams = nets.init(jax.random.PRNGKey(0), 4), HParams(gamma=0.9, gae_lambda=0.8)
    data = batch.log_prob + 1.0
    after, prepared, explained = nets.prepare(policy, batch, data, hparams)
    value, next_value = (mlp(policy.nets.params["critic"], x)[..., 0] for x in (batch.obs, batch.next_obs))
    scaled = batch.reward / np.sqrt(after.return_var)
    advantage, target = gae(scaled, value, next_value, batch.terminated, batch.truncated, 0.9, 0.8)
    np.testing.assert_allclose(prepared.advantage, (advantage - advantage.mean()) / advantage.std(), atol=1e-4)
    np.testing.assert_allclose(prepared.value_target, target, atol=1e-4)
    np.testing.assert_allclose(explained, 1 - np.var(target - value) / np.var(target), atol=1e-4)
    np.testing.assert_array_equal(prepared.penalty_data, data)


@pytest.mark.parametrize("ends", ["terminated", "truncated"])
def test_the_return_behind_the_reward_scale_starts_anew_where_an_episode_ends(tiny, transitions, ends):
    """By the task or by the time limit: after either, the next step of the batch belongs to another episode."""
    nets, x = ActorCritic.build(2, tiny()), jax.tree.map(jnp.asarray, transitions())
    done = jnp.zeros((6, 4)).at[2].set(1.0)
    x = x._replace(reward=jnp.ones((6, 4)), terminated=0 * done, truncated=0 * done)._replace(**{ends: done})
    policy, _, _ = nets.prepare(nets.init(jax.random.PRNGKey(0), 4), x, (), HParams(gamma=0.5))
    np.testing.assert_allclose(policy.return_var, np.var([1.0, 1.5, 1.75, 1.0, 1.5, 1.75]), rtol=1e-5)
