"""THE loop, a step at a time, recomputed in NumPy from what it leaves behind."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import envs
from eairl_jax import Demonstrations, HParams, InputError, RewardParams, learned_reward, make_irl, reward_function
from eairl_jax.methods import METHODS
from eairl_jax.normalize import ObsStats
from eairl_jax.ppo import ppo

GAMMA = 0.9
HPARAMS = HParams(gamma=GAMMA, discriminator_lr=0.05, phi_lr=0.05, inverse_lr=0.05)


@pytest.fixture
def numpy_f(mlp, numpy_reward):
    """f(s, a, s') of raw transitions by the networks of a state; with `raw` the reward and h see no scale."""

    def f(state, phi_target, x, scale=(0.0, 1.0), raw=False):
        params = state.discriminator.params
        s, next_s = ((obs - scale[0]) / scale[1] for obs in (x.obs, x.next_obs))
        seen, next_seen = (x.obs, x.next_obs) if raw else (s, next_s)
        goes_on = 1 - np.asarray(x.terminated)
        f = numpy_reward(params, seen, x.action)
        if "h" in params:
            f = f + GAMMA * goes_on * mlp(params["h"], next_seen)[..., 0] - mlp(params["h"], seen)[..., 0]
        if state.empowerment is not None:
            phi, next_phi = mlp(state.empowerment.phi.params, s)[..., 0], mlp(phi_target, next_s)[..., 0]
            f = f + GAMMA * goes_on * next_phi - phi
        return f

    return f


@pytest.mark.parametrize("changes", [*({"method": name} for name in METHODS), {"shaping": "both", "reward_obs": "raw"}],
                         ids=lambda changes: " ".join(changes.values()))  # fmt: skip
def test_the_policys_reward_is_the_methods_by_the_networks_just_fitted(one_step, numpy_f, scale, changes):
    before, after, metrics = one_step(HPARAMS, **changes)
    raw = "reward_obs" in changes
    x = jax.tree.map(lambda ring: np.asarray(ring[0], np.float64), after.history.transitions)
    assert x.terminated.sum() > 0
    # Phi' is the copy of before: the first sync is due after the second iteration.
    slow = before.empowerment.phi_target if before.empowerment else None
    f = numpy_f(after, slow, x, scale, raw)
    expected = np.log1p(np.exp(f)) if changes.get("method") == "gail" else f - x.log_prob
    np.testing.assert_allclose(metrics["policy_reward"], expected.mean(), rtol=1e-4, atol=1e-5)
    stale = numpy_f(before, slow, x, scale, raw)
    assert np.abs(stale - f).mean() > 0.05


@pytest.mark.parametrize(("rate", "part"), [
    ("discriminator_lr", lambda state: state.discriminator.params),
    ("phi_lr", lambda state: state.empowerment.phi.params),
])  # fmt: skip
def test_the_policy_sees_what_was_just_updated(one_step, rate, part):
    """Same state, same key, one step: a rate of 0 or not shows in the reward that the policy is given."""
    runs = [one_step(HPARAMS.replace(**{rate: lr})) for lr in (0.0, 0.05)]
    (before, still, without), (_, moved, given) = runs
    jax.tree.map(np.testing.assert_array_equal, part(still), part(before))
    assert any((a != b).any() for a, b in zip(*map(jax.tree.leaves, (part(moved), part(before))), strict=True))
    np.testing.assert_array_equal(still.history.transitions.obs, moved.history.transitions.obs)
    assert abs(given["policy_reward"] - without["policy_reward"]) > 1e-3


@pytest.mark.parametrize("rate", ["lambda_i", "policy_lr"])
def test_the_policy_alone_sees_lambda_i_and_its_own_rate(one_step, rate):
    (_, still, _), (_, moved, _) = (one_step(HPARAMS.replace(**{rate: value})) for value in (0.0, 1.0))
    kernels = [s.actor.policy.nets.params["actor"]["params"]["MLP_0"]["Dense_1"]["kernel"] for s in (still, moved)]
    assert np.abs(kernels[1] - kernels[0]).max() > 1e-4
    for part in ("discriminator", "empowerment", "history"):
        jax.tree.map(np.testing.assert_array_equal, getattr(still, part), getattr(moved, part))


def test_no_gradient_of_the_discriminators_loss_reaches_phi(built, demos):
    """Phi enters the loss, which moves when Phi does; its gradient, through the whole step, is exactly 0."""
    algorithm, init, step = built()
    hparams = HPARAMS.replace(phi_lr=0.0)
    state = init(jax.random.PRNGKey(0), hparams)

    def loss(phi, phi_target, g):
        emp = state.empowerment.replace(phi=state.empowerment.phi.replace(params=phi), phi_target=phi_target)
        d = state.discriminator.replace(params=g)
        changed = state.replace(empowerment=emp, discriminator=d)
        return algorithm.step(changed, hparams, demos)[1]["discriminator_loss"]

    given = state.empowerment.phi.params, state.empowerment.phi_target, state.discriminator.params
    *to_phi, to_g = jax.jit(jax.grad(loss, argnums=(0, 1, 2)))(*given)
    for leaf in jax.tree.leaves(to_phi):
        np.testing.assert_array_equal(leaf, np.zeros(leaf.shape))
    assert max(np.abs(leaf).max() for leaf in jax.tree.leaves(to_g)) > 1e-3
    shifted = state.empowerment.replace(phi_target=jax.tree.map(lambda p: p + 0.1, given[1]))
    losses = [step(s, hparams, demos)[1]["discriminator_loss"] for s in (state, state.replace(empowerment=shifted))]
    assert abs(losses[0] - losses[1]) > 1e-3


def test_the_discriminators_loss_by_hand_with_log_pi_of_the_current_policy(toy, tiny, numpy_f):
    """One transition an iteration and one of the expert: then the random minibatches hold nothing random."""
    config = tiny(num_envs=1, rollout_length=1, ppo_minibatches=1, discriminator_updates=1, discriminator_batch=4096)
    algorithm, policy_of = make_irl(toy(), config), ppo(4, 2, config).distribution
    hparams = HPARAMS.replace(policy_lr=0.5, entropy_weight=0.1)
    demos = Demonstrations(*(np.full((1, 1, *tail), value, np.float32) for tail, value in (
        ((4,), 0.3), ((2,), 1.4), ((4,), 0.7), ((), 0.0), ((), 0.0)
    )))  # fmt: skip
    step = jax.jit(algorithm.step)
    state = jax.jit(algorithm.init)(jax.random.PRNGKey(0), hparams)

    def logits(before, after, x, policy):
        pi = policy_of(policy, jnp.asarray(x.obs))
        log_pi = stats.norm.logpdf(x.action, pi.mean, np.exp(pi.log_std)).sum(axis=-1)
        phi = after.empowerment.replace(phi_target=before.empowerment.phi_target)
        return numpy_f(before.replace(empowerment=phi), before.empowerment.phi_target, x) - log_pi

    for i in range(2):
        before, (state, metrics) = state, step(state, hparams, demos)
        seen = jax.tree.map(lambda ring, i=i: np.asarray(ring[: i + 1]), state.history.transitions)
        expert = np.log1p(np.exp(-logits(before, state, demos, before.actor.policy))).mean()
        # All that the ring holds, half the draws each, log pi under today's policy however old they are.
        policy = np.log1p(np.exp(logits(before, state, seen, before.actor.policy)))
        slack = 1e-4 + 0.02 * np.ptp(policy)
        np.testing.assert_allclose(metrics["discriminator_loss"], 0.5 * (expert + policy.mean()), atol=slack)
    now = policy_of(before.actor.policy, jnp.asarray(seen.obs)).log_prob(jnp.asarray(seen.action))
    assert abs(now[0] - seen.log_prob[0]) > 0.2  # the old sample's own log pi is another


def test_eairl_without_shaping_and_penalty_trains_as_unshaped_airl(built, demos):
    runs, compared = [], ("discriminator_loss", "policy_reward", "true_return", "kl")
    for method in ("eairl", "airl_sa"):
        _, init, step = built(method=method, shaping="none")
        state, metrics = init(jax.random.PRNGKey(0), HPARAMS), []
        for _ in range(3):
            state, metric = step(state, HPARAMS.replace(lambda_i=0.0), demos)
            metrics.append({name: metric[name] for name in compared})
        runs.append((state.discriminator.params, state.actor.policy.nets.params, metrics))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-4), *runs)


@pytest.mark.parametrize("reward_obs", ["normalized", "raw"])
@pytest.mark.parametrize(
    ("form", "part"), [("sa", "net"), ("s", "net"), ("separable", "net"), ("separable", "quadratic")]
)
def test_what_is_transferred_is_the_reward_alone_behind_its_normaliser(toy, tiny, numpy_reward, form, part, reward_obs):
    config = tiny(reward_form=form, action_part=part, shaping="both", reward_obs=reward_obs)
    state = make_irl(toy(), config).init(jax.random.PRNGKey(0), HPARAMS)
    kept = learned_reward(state).params
    assert set(state.discriminator.params) == set(kept) | {"h"}
    rng = np.random.default_rng(0)
    obs, action, mean, std = rng.normal(size=(3, 5, 4)), rng.normal(size=(3, 5, 2)), np.arange(4.0), np.arange(1.0, 5)
    stats = ObsStats(jnp.asarray(mean), jnp.asarray(std**2), jnp.zeros(()))
    given = reward_function(config)(RewardParams(kept, stats), jnp.asarray(obs), jnp.asarray(action))
    s = obs if reward_obs == "raw" else (obs - mean) / std
    np.testing.assert_allclose(given, numpy_reward(kept, s, action), atol=1e-5)


def test_the_state_keeps_its_types_so_that_a_step_compiles_once(built, demos):
    algorithm, _, _ = built()
    state = jax.eval_shape(algorithm.init, jax.random.PRNGKey(0), HPARAMS)
    after, _ = jax.eval_shape(algorithm.step, state, HPARAMS, demos)
    for (path, x), y in zip(jax.tree_util.tree_leaves_with_path(state), jax.tree.leaves(after), strict=True):
        kinds = [(leaf.shape, leaf.dtype, leaf.weak_type) for leaf in (x, y)]
        assert kinds[0] == kinds[1], jax.tree_util.keystr(path)


def test_act_samples_the_policy_and_gives_its_mean_without_a_key(built):
    algorithm, init, _ = built()
    state, obs = init(jax.random.PRNGKey(0), HPARAMS), jnp.ones((20_000, 4))
    mean, sampled = algorithm.act(state, obs, None), np.asarray(algorithm.act(state, obs, jax.random.PRNGKey(1)))
    assert mean.shape == (20_000, 2)
    np.testing.assert_allclose(mean, np.broadcast_to(mean[0], mean.shape), atol=1e-6)
    np.testing.assert_allclose(sampled.mean(axis=0), mean[0], atol=0.02)
    np.testing.assert_allclose(sampled.std(axis=0), np.full(2, np.exp(-0.5)), rtol=0.05)


@pytest.mark.parametrize(("size", "changes", "message"), [
    (4, {"method": "eairll"}, "did you mean eairl"),
    ({"pixels": (8, 8)}, {}, "flat vector"),
])  # fmt: skip
def test_what_cannot_work_is_refused(toy, tiny, size, changes, message):
    env = toy()
    env.observation_size = size
    with pytest.raises(InputError, match=message):
        make_irl(env, tiny(**changes)).init(jax.random.PRNGKey(0), HPARAMS)


def test_eairl_runs_on_an_mjx_task(tiny):
    env, config = envs.make("pendulum"), tiny(normalize_obs="running")
    demos = Demonstrations(*(np.ones((2, 5, *tail), np.float32) for tail in ((3,), (1,), (3,), (), ())))
    algorithm = make_irl(env, config)
    step = jax.jit(algorithm.step)
    state = before = jax.jit(algorithm.init)(jax.random.PRNGKey(0), HPARAMS)
    for _ in range(2):
        state, metrics = step(state, HPARAMS, demos)
    assert all(np.isfinite(value) for value in metrics.values())
    assert -5 * 17 < metrics["true_return"] < 0
    assert (state.actor.iteration, state.actor.obs_stats.count) == (2, 2 * 24)
    assert jax.tree.structure(before) == jax.tree.structure(state)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state))
