"""The policy's update against plain policy gradients and NumPy."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from scipy import stats

from eairl_jax import HParams, train_state
from eairl_jax.actor_critic import scale_rewards
from eairl_jax.gae import gae
from eairl_jax.ppo import ppo

HPARAMS = HParams(max_grad_norm=1e9, entropy_weight=0.0)
ONE_STEP = {"ppo_epochs": 1, "ppo_minibatches": 1}


def cost(pi, log_prob, weights):
    """A penalty with a weight on log pi(a|s) and another on the mean of the first action, for each transition."""
    return weights[0] * log_prob + weights[1] * pi.mean[..., 0]


@pytest.fixture(scope="module")
def program(tiny):
    """`(optimizer, init, update)` of a configuration, compiled once: `update(policy, batch, hparams, weights)`."""

    @functools.cache
    def make(**changes):
        optimizer = ppo(4, 2, tiny(**changes))

        def update(policy, batch, hparams, weights):
            return optimizer.update(jax.random.PRNGKey(1), policy, batch, cost, weights, hparams)

        return optimizer, jax.jit(optimizer.init), jax.jit(update)

    return make


@pytest.fixture
def problem(program, transitions):
    """`(optimizer, policy, batch, update)`: random transitions whose actions the policy drew."""

    def make(**changes):
        optimizer, init, update = program(**changes)
        policy = init(jax.random.PRNGKey(0))
        batch = jax.tree.map(jnp.asarray, transitions())
        pi = optimizer.distribution(policy, batch.obs)
        action = pi.sample(batch.action)
        batch = batch._replace(action=action, log_prob=pi.log_prob(action))
        none = jnp.zeros_like(batch.reward)

        def run(policy=policy, batch=batch, hparams=HPARAMS, on_log_prob=none, on_mean=none):
            hparams = jax.tree.map(jnp.float32, hparams)
            return update(policy, batch, hparams, (on_log_prob, on_mean))

        return optimizer, policy, batch, run

    return make


def test_distribution_is_a_gaussian_of_the_actors_network(problem, mlp):
    optimizer, policy, batch, _ = problem()
    pi = optimizer.distribution(policy, batch.obs)
    np.testing.assert_allclose(pi.mean, mlp(policy.nets.params["actor"], batch.obs), atol=1e-5)


def test_the_first_step_is_the_plain_policy_gradient(problem, mlp):
    """At ratio 1 PPO's objective has REINFORCE's gradient, and Adam's first step is lr times its sign."""
    optimizer, policy, batch, update = problem(**ONE_STEP)
    after, _ = update()
    critic = policy.nets.params["critic"]
    value, next_value = (mlp(critic, x)[..., 0].astype(np.float32) for x in (batch.obs, batch.next_obs))
    _, reward = scale_rewards(policy, batch.reward, batch.terminated + batch.truncated, HPARAMS.gamma)
    advantage, target = gae(reward, value, next_value, batch.terminated, batch.truncated, 0.99, 0.95)
    advantage = (advantage - advantage.mean()) / advantage.std()

    def reinforce(nets):
        params = policy.nets.params | nets
        pi = optimizer.distribution(policy.replace(nets=train_state.init(params)), batch.obs)
        return -(advantage * pi.log_prob(batch.action)).mean()

    gradient = jax.grad(reinforce)({"actor": policy.nets.params["actor"]})["actor"]
    moved = jax.tree.map(lambda a, b: (a - b) / -1e-3, after.nets.params["actor"], policy.nets.params["actor"])
    compared = 0
    for g, step in zip(jax.tree.leaves(gradient), jax.tree.leaves(moved), strict=True):
        clear = np.abs(g) > 1e-5
        compared += clear.sum()
        np.testing.assert_allclose(step[clear], np.sign(g)[clear], atol=0.02)
    assert compared > 30
    bias = after.nets.params["critic"]["params"]["MLP_0"]["Dense_1"]["bias"]
    np.testing.assert_allclose(bias[0] / 1e-3, np.sign((target - value).mean()), atol=0.02)


def test_the_gradient_is_clipped_at_its_norm(problem):
    """After its first step Adam's first moment is a tenth of the gradient that it was given."""
    _, _, _, update = problem(**ONE_STEP)
    free, clipped = (
        optax.tree.norm(update(hparams=HPARAMS.replace(max_grad_norm=limit))[0].nets.adam.mu) for limit in (1e9, 0.05)
    )
    assert free > 2 * 0.1 * 0.05
    np.testing.assert_allclose(clipped, 0.1 * 0.05, rtol=1e-4)


def test_the_ratio_is_clipped(problem):
    """Where the ratio has left the trust region in its advantage's direction, no gradient pulls it further."""
    _, _, batch, update = problem(**ONE_STEP)
    gone = batch._replace(log_prob=batch.log_prob - 1.0)  # every ratio is e
    loose, tight = (update(batch=gone, hparams=HPARAMS.replace(clip_eps=eps))[1]["policy_loss"] for eps in (1e6, 0.2))
    # With advantages of mean 0, mean(e A) = 0 unclipped, and min(e A, 1.2 A) = 1.2 A where A > 0, e A where A < 0.
    np.testing.assert_allclose(loose, 0.0, atol=1e-5)
    one_half = (tight - loose) / (np.e - 1.2)  # mean of A's positive part
    assert 0.2 < one_half < 0.6  # 0.4 for a Gaussian; 0.5 at most at std 1


def test_the_metrics_are_what_their_names_say(problem):
    optimizer, policy, batch, update = problem()
    after, metrics = update(hparams=HPARAMS.replace(policy_lr=0.01))
    p, q = (optimizer.distribution(x, batch.obs) for x in (policy, after))
    ratio = np.exp(p.log_std - q.log_std)
    kl = (0.5 * (ratio**2 + ((p.mean - q.mean) / np.exp(q.log_std)) ** 2 - 1) - np.log(ratio)).sum(-1).mean()
    assert kl > 1e-4
    np.testing.assert_allclose(metrics["kl"], kl, rtol=1e-2)
    still, metrics = update(hparams=HPARAMS.replace(policy_lr=0.0))
    entropy = stats.norm.entropy(scale=np.exp(p.log_std)).sum(-1).mean()
    np.testing.assert_allclose(metrics["entropy"], entropy, rtol=1e-5)
    np.testing.assert_allclose(metrics["kl"], 0.0, atol=1e-6)
    np.testing.assert_allclose(metrics["policy_loss"], 0.0, atol=1e-5)
    jax.tree.map(np.testing.assert_array_equal, still.nets.params, policy.nets.params)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_entropy_bonus_reaches_the_policy(problem, sign):
    _, _, _, update = problem()
    after, _ = update(hparams=HPARAMS.replace(entropy_weight=10.0 * sign))
    assert (sign * after.nets.params["actor"]["params"]["raw_log_std"] > 1e-3).all()


def test_the_penalty_is_a_cost_on_log_pi(problem):
    """What costs becomes less likely: actions that point one way cost, those that point the other way earn."""
    optimizer, policy, batch, update = problem()
    weight = 10.0 * jnp.sign(batch.action[..., 0])
    before, after = (optimizer.distribution(p, batch.obs) for p in (policy, update(on_log_prob=weight)[0]))
    assert (after.mean[..., 0] < before.mean[..., 0]).all()
    assert (weight * (after.log_prob(batch.action) - before.log_prob(batch.action))).mean() < 0


def test_penalty_data_stays_with_its_transition(problem):
    optimizer, policy, batch, _ = problem(ppo_epochs=3, ppo_minibatches=4)
    seen = []

    def penalty(pi, log_prob, data):
        own, action = data
        jax.debug.callback(lambda *x: seen.append(x), log_prob, pi.log_prob(action), own)
        return jnp.zeros_like(log_prob)

    hparams, data = HPARAMS.replace(policy_lr=0.0), (batch.log_prob, batch.action)
    jax.block_until_ready(
        jax.jit(lambda p: optimizer.update(jax.random.PRNGKey(1), p, batch, penalty, data, hparams))(policy)
    )
    jax.effects_barrier()
    assert len(seen) == 12
    for log_prob, by_pi, own in seen:
        np.testing.assert_allclose(log_prob, own, atol=1e-5)
        np.testing.assert_allclose(by_pi, own, atol=1e-5)


def test_the_penalty_reaches_the_policy_through_pi_too(problem):
    """A cost on pi's mean, whatever action was taken: what l_I on actions drawn anew needs."""
    optimizer, policy, batch, update = problem()

    weight = jnp.full_like(batch.log_prob, 100.0)
    before, after = (optimizer.distribution(p, batch.obs) for p in (policy, update(on_mean=weight)[0]))
    assert (after.mean[..., 0] < before.mean[..., 0]).all()


def test_the_stds_schedule_is_a_factor_on_what_the_network_says(problem):
    optimizer, policy, batch, update = problem()
    hparams = HPARAMS.replace(std_final_fraction=0.3, entropy_weight=1.0)
    after, _ = update(hparams=hparams)
    net = optimizer.distribution(policy.replace(nets=after.nets), batch.obs)
    assert np.abs(net.log_std + 0.5).max() > 1e-3  # the network moved too
    pi = optimizer.distribution(after, batch.obs)
    np.testing.assert_allclose(np.exp(pi.log_std), 0.3 * np.exp(net.log_std), rtol=1e-5)
    np.testing.assert_array_equal(pi.mean, net.mean)
