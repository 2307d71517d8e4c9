"""PPO learns what the reward says, its own or another."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import HParams, InputError, make_rl, rl, scan


def towards(data, batch):
    """A reward that wants the actions at `data`."""
    return -((batch.action - data) ** 2).sum(axis=-1)


@pytest.mark.parametrize(("reward", "wanted"), [(None, 0.5), (towards, -0.5)], ids=["true reward", "learned reward"])
def test_the_policy_goes_where_the_reward_is(toy, tiny, reward, wanted):
    config = tiny(num_envs=32, rollout_length=10, iterations=60, ppo_epochs=4, ppo_minibatches=4,
                  policy_hidden=(32, 32), value_hidden=(32, 32), activation="tanh")  # fmt: skip
    algorithm = make_rl(toy(), config, reward) if reward else make_rl(toy(), config)
    hparams = HParams(policy_lr=3e-3)
    run = jax.jit(functools.partial(scan, algorithm, length=60))
    state, metrics = run(algorithm.init(jax.random.PRNGKey(0), hparams), hparams, np.float32(wanted))
    assert state.agent.iteration == 60
    obs = state.agent.rollout.env.obs
    np.testing.assert_allclose(algorithm.act(state, obs, None), np.full((32, 2), wanted), atol=0.15)
    assert np.std(algorithm.act(state, obs, jax.random.PRNGKey(1)) - wanted) > 0.01
    assert metrics["policy_reward"][-1] > 0.3 * metrics["policy_reward"][0]
    # The score is the environment's own return over five steps, whatever was trained on.
    np.testing.assert_allclose(metrics["true_return"][-1], -5 * 2 * (wanted - 0.5) ** 2, atol=1.0)


def test_with_a_temperature_the_policy_is_the_maximum_entropy_one(toy, tiny):
    config = tiny(num_envs=32, rollout_length=10, iterations=80, ppo_epochs=4, ppo_minibatches=4)
    algorithm, run = (
        make_rl(toy(), config, towards),
        functools.partial(scan, make_rl(toy(), config, towards), length=80),
    )
    temperature = 1.6
    hparams = HParams(gamma=0.0, policy_lr=5e-3, policy_lr_final_fraction=0.1, temperature=temperature)
    run = jax.jit(functools.partial(scan, algorithm, length=80))
    state, metrics = run(algorithm.init(jax.random.PRNGKey(0), hparams), hparams, np.float32(0.3))
    actions = algorithm.act(state, jnp.broadcast_to(state.agent.rollout.env.obs[:1], (4000, 4)), jax.random.PRNGKey(1))
    # exp(-(a - 0.3)^2 / temperature), normalised
    np.testing.assert_allclose(actions.mean(axis=0), 0.3, atol=0.15)
    np.testing.assert_allclose(actions.var(axis=0), temperature / 2, rtol=0.2)
    # What is reported is the reward alone, here two of the variances just met.
    np.testing.assert_allclose(metrics["policy_reward"][-1], -temperature, rtol=0.2)


def test_observations_that_are_not_flat_are_refused(toy, tiny):
    env = toy()
    env.observation_size = {"state": 4}
    with pytest.raises(InputError, match="flat vector"):
        make_rl(env, tiny()).init(jax.random.PRNGKey(0), HParams())


def test_an_end_is_paid_for_all_absorbing_steps_and_the_temperature_for_none(toy, tiny, monkeypatch):
    """The reward is 1 there, so an endless stay is worth 1 / (1 - 0.99); `-temperature log pi` is added elsewhere."""
    make = rl.make_optimizer

    def recording(env, config, _shards):
        def update(_key, policy, batch, *_more):
            return policy, {"reward": batch.reward, "log_prob": batch.log_prob, "absorbed": batch.obs[..., -1],
                            "terminated": batch.terminated}  # fmt: skip

        return make(env, config)._replace(update=update)

    monkeypatch.setattr(rl, "make_optimizer", recording)
    config = tiny(horizon="absorbing", normalize_obs="none")
    algorithm = make_rl(toy(ends_at=3), config, lambda _data, batch: batch.obs[..., -1])
    hparams = HParams(temperature=0.7)
    _, seen = jax.jit(algorithm.step)(algorithm.init(jax.random.PRNGKey(0), hparams), hparams, ())
    assert 0 < seen["absorbed"].mean() < 1
    expected = np.where(seen["absorbed"] > 0, 100.0, -0.7 * seen["log_prob"])
    np.testing.assert_allclose(seen["reward"], expected, rtol=1e-5)
    np.testing.assert_array_equal(seen["terminated"], seen["absorbed"])
