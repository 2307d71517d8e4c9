"""THE loop, a step at a time, recomputed in NumPy from what it leaves behind."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from eairl_jax import (
    HParams,
    InputError,
    RewardParams,
    discriminator,
    discriminator_data,
    empowerment,
    envs,
    learned_reward,
    replay,
)
from eairl_jax.gaussian import Gaussian
from eairl_jax.irl import REWARD_FIELDS, make_irl, reward_function, reward_kind
from eairl_jax.methods import METHODS, with_method_defaults
from eairl_jax.normalize import ObsStats
from eairl_jax.ppo import ppo
from eairl_jax.types import no_penalty

GAMMA = 0.9
HPARAMS = HParams(gamma=GAMMA, discriminator_lr=0.05, phi_lr=0.05, inverse_lr=0.05)


@pytest.fixture
def numpy_f(mlp, numpy_reward):
    """f(s, a, s') of raw transitions by `(discriminator's params, Phi's, Phi's of s')`; no Phi, no shaping by it."""

    def f(params, phi, next_phi, x, config, scale=(0.0, 1.0)):
        s, next_s = ((obs - scale[0]) / scale[1] for obs in (x.obs, x.next_obs))
        seen, next_seen = (x.obs, x.next_obs) if config.reward_obs == "raw" else (s, next_s)
        owed = (1.0 if config.shaping_discount == "one" else GAMMA) * (1 - np.asarray(x.terminated))
        f = numpy_reward(params, seen, x.action)
        if "h" in params:
            f = f + owed * mlp(params["h"], next_seen)[..., 0] - mlp(params["h"], seen)[..., 0]
        return f + owed * mlp(next_phi, next_s)[..., 0] - mlp(phi, s)[..., 0] if phi else f

    return f


def phis(before, after):
    """Phi and its slow copy in the iteration from `before` to `after`: the first sync is due after the second."""
    return (after.empowerment.phi.params, before.empowerment.phi_target) if after.empowerment else (None, None)


# Trajectories are judged whole: an iteration holds whole ones. The release's pool keeps one environment of one.
WHOLE = {"gan_gcl": {"rollout_length": 5}, "eairl_release": {"num_envs": 1}}
CASES = [
    *({"method": name} | WHOLE.get(name, {}) for name in METHODS),
    {"shaping": "both", "reward_obs": "raw", "layer_norm": True, "policy_layer_norm": True},
    {"l_i_in": "reward"},
]


@pytest.mark.parametrize("changes", CASES, ids=lambda changes: " ".join(map(str, changes.values())))
def test_the_policys_reward_is_the_methods_by_the_networks_just_fitted(one_step, tiny, numpy_f, mlp, scale, changes):
    before, after, metrics = one_step(HPARAMS.replace(lambda_i=0.5), **changes)
    config = with_method_defaults(tiny(**changes))
    x = jax.tree.map(lambda ring: np.asarray(ring[0], np.float64), after.replay.transitions)
    assert x.terminated.sum() > 0 or config.discriminates == "trajectories"
    phi, slow = phis(before, after)
    next_phi = phi if config.policy_phi == "online" else slow
    f = numpy_f(after.discriminator.params, phi, next_phi, x, config, scale)
    expected = np.log1p(np.exp(f)) if config.method in ("gail", "gaifo") else f - x.log_prob
    if config.l_i_in == "reward":
        s, next_s = ((obs - scale[0]) / scale[1] for obs in (x.obs, x.next_obs))
        q = empowerment.q_distribution(after.empowerment.inverse.params, x._replace(obs=s, next_obs=next_s), config)
        expected = expected - 0.5 * (np.asarray(q.log_prob(x.action)) - x.log_prob - mlp(phi, s)[..., 0]) ** 2
    np.testing.assert_allclose(metrics["policy_reward"], expected.mean(), rtol=1e-4, atol=1e-5)
    stale_phi = before.empowerment.phi.params if phi else None
    stale = numpy_f(before.discriminator.params, stale_phi, slow, x, config, scale)
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
    np.testing.assert_array_equal(still.replay.transitions.obs, moved.replay.transitions.obs)
    assert abs(given["policy_reward"] - without["policy_reward"]) > 1e-3


@pytest.mark.parametrize("rate", ["lambda_i", "policy_lr"])
def test_the_policy_alone_sees_lambda_i_and_its_own_rate(one_step, rate):
    (_, still, _), (_, moved, _) = (one_step(HPARAMS.replace(**{rate: value})) for value in (0.0, 1.0))
    kernels = [s.agent.policy.nets.params["actor"]["params"]["MLP_0"]["Dense_1"]["kernel"] for s in (still, moved)]
    assert np.abs(kernels[1] - kernels[0]).max() > 1e-4
    for part in ("discriminator", "empowerment", "replay"):
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


@pytest.mark.parametrize(("method", "length"), [("eairl", 1), ("gan_gcl", 2)])
def test_the_discriminators_loss_by_hand_with_log_pi_of_the_current_policy(toy, tiny, flat, numpy_f, method, length):
    """One sample an iteration and one of the expert: then the random minibatches hold nothing random.

    A sample is a transition, or a trajectory, whose logit is the sum of its transitions'.
    """
    config = tiny(method=method, num_envs=1, rollout_length=length, episode_length=5 if length == 1 else length,
                  ppo_minibatches=1, discriminator_updates=1, discriminator_batch=4096 * length)  # fmt: skip
    algorithm, policy_of, own = make_irl(toy(), config), ppo(4, 2, config).distribution, with_method_defaults(config)
    hparams = HPARAMS.replace(policy_lr=0.2, entropy_weight=0.1)
    rng = np.random.default_rng(0)
    draws = (rng.uniform(-0.5, 0.5, (1, length, *tail)).astype(np.float32) for tail in ((4,), (2,), (4,), ()))
    one_episode = flat(*draws, np.zeros((1, length), np.float32))
    step = jax.jit(algorithm.step)
    state = jax.jit(algorithm.init)(jax.random.PRNGKey(0), hparams)

    def logits(before, after, x):
        pi = policy_of(before.agent.policy, jnp.asarray(x.obs))
        log_pi = stats.norm.logpdf(x.action, pi.mean, np.exp(pi.log_std)).sum(axis=-1)
        return (numpy_f(before.discriminator.params, *phis(before, after), x, own) - log_pi).sum(axis=1)

    for i in range(2):
        before, (state, metrics) = state, step(state, hparams, one_episode)
        seen = jax.tree.map(lambda ring, i=i: np.asarray(ring[: i + 1]), state.replay.transitions)
        expert = np.log1p(np.exp(-logits(before, state, jax.tree.map(lambda x: x[None], one_episode)))).mean()
        # All that the ring holds, half the draws each, log pi under today's policy however old they are.
        policy = np.log1p(np.exp(logits(before, state, seen)))
        slack = 1e-4 + 0.02 * np.ptp(policy)
        np.testing.assert_allclose(metrics["discriminator_loss"], 0.5 * (expert + policy.mean()), atol=slack)
    now = policy_of(before.agent.policy, jnp.asarray(seen.obs)).log_prob(jnp.asarray(seen.action))
    assert np.abs(now[0] - seen.log_prob[0]).max() > 0.2  # the old sample's own log pi is another


@pytest.mark.parametrize(("discriminates", "batch", "length"), [("transitions", 200, 1), ("trajectories", 40, 5)])
def test_the_discriminator_is_shown_transitions_or_whole_episodes(
    tiny, flat, transitions, discriminates, batch, length
):
    """As many samples of the one as of the other: 200 transitions are 40 episodes of five."""
    config = with_method_defaults(tiny(discriminates=discriminates, rollout_length=5, discriminator_batch=200))
    raw = jax.tree.map(jnp.asarray, transitions(length=5))
    raw = raw._replace(obs=jnp.arange(5 * 4 * 4.0).reshape(5, 4, 4))
    demos = flat(*(np.arange(3 * 5 * n).reshape(3, 5, *tail) for n, *tail in ((4, 4), (2, 2), (4, 4), (1,), (1,))))
    past = replay.add(jax.random.PRNGKey(0), replay.empty(4, 2, config), raw, config)
    drawn = discriminator_data.draw_minibatches(jax.random.PRNGKey(0), demos, past, raw, HParams(), config)
    for given, episodes in zip(drawn, (demos.obs, raw.obs.swapaxes(0, 1)), strict=True):
        assert given.obs.shape == (2, batch, length, 4)
        pieces = {tuple(piece) for piece in np.asarray(given.obs).reshape(2 * batch, -1)}
        assert pieces == {tuple(piece) for piece in np.asarray(episodes).reshape(-1, 4 * length)}


@pytest.mark.parametrize(("one", "other"), [
    ({"method": "eairl", "shaping": "none", "episode_length": 1},
     {"method": "airl_sa", "shaping": "none", "episode_length": 1}),
    ({"method": "eairl", "shaping": "learned"}, {"method": "airl_sa"}),
    ({"method": "gan_gcl", "episode_length": 1}, {"method": "airl_sa", "shaping": "none", "episode_length": 1}),
], ids=["EAIRL without Phi, unshaped AIRL", "EAIRL with h, AIRL", "GAN-GCL of one step, unshaped AIRL"])  # fmt: skip
def test_one_method_without_what_sets_it_apart_trains_as_another(built, demos, one, other):
    """Without l_I in the policy's loss; what one method alone reports is left out."""
    runs = []
    for changes in (one, other):
        _, init, step = built(**changes)
        state, metrics = init(jax.random.PRNGKey(0), HPARAMS), []
        for _ in range(3):
            state, metric = step(state, HPARAMS.replace(lambda_i=0.0), demos)
            metrics.append(metric)
        runs.append((state.discriminator, state.agent, metrics))
    shared = set(runs[0][2][0]) & set(runs[1][2][0])
    assert {"discriminator_loss", "accuracy", "reward_expert", "policy_reward", "true_return", "kl"} <= shared
    runs = [(*parts, [{name: metric[name] for name in shared} for metric in metrics]) for *parts, metrics in runs]
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-4), *runs)


@pytest.mark.parametrize(
    ("changes", "sees"), [({}, True), ({"method": "eairl_release"} | WHOLE["eairl_release"], False)]
)
def test_the_discriminator_sees_the_new_phi_or_the_old_as_the_order_says(one_step, changes, sees):
    """Phi's rate shows in the discriminator only if Phi was fitted first; the policy's reward has the new one."""
    (_, still, without), (_, moved, given) = (one_step(HPARAMS.replace(phi_lr=lr), **changes) for lr in (0.0, 0.05))
    pairs = list(zip(*(jax.tree.leaves(s.discriminator.params) for s in (still, moved)), strict=True))
    assert any((a != b).any() for a, b in pairs) == sees
    assert bool(without["discriminator_loss"] != given["discriminator_loss"]) == sees
    assert abs(given["policy_reward"] - without["policy_reward"]) > 1e-3


@pytest.fixture
def untrained(built, tiny, transitions, scale):
    """`(config, empowerment, agent, raw transitions, the same normalised, pi)` of a run whose Phi' is not Phi."""

    def make(**changes):
        state = built()[1](jax.random.PRNGKey(0), HPARAMS)
        config = with_method_defaults(tiny(**changes))
        slow = jax.tree.map(lambda leaf: leaf + 0.1, state.empowerment.phi_target)
        seen = jax.tree.map(jnp.asarray, transitions())
        raw = seen._replace(obs=scale[0] + scale[1] * seen.obs, next_obs=scale[0] + scale[1] * seen.next_obs)

        def pi(obs):
            return ppo(4, 2, config).distribution(state.agent.policy, obs)

        return config, state.empowerment.replace(phi_target=slow), state.agent, raw, seen, pi

    return make


@pytest.mark.parametrize("scoring", [False, True])
@pytest.mark.parametrize("changes", [{}, {"policy_phi": "online"}, {"shaping_discount": "one"}], ids=str)
def test_the_shaping_by_phi_is_a_constant_of_the_phi_and_the_discount_asked_for(untrained, mlp, changes, scoring):
    """The release scores the policy's transitions, and those alone, with Phi itself at s'."""
    config, emp, acting, raw, x, pi = untrained(**changes)

    def samples(emp):
        if scoring:
            return discriminator_data.for_policy_reward(raw, emp, (), acting, HPARAMS, config)
        return discriminator_data.for_loss(raw, pi, emp, (), acting, HPARAMS, config)

    result = samples(emp)
    next_phi = emp.phi.params if scoring and "policy_phi" in changes else emp.phi_target
    discount = 1.0 if "shaping_discount" in changes else GAMMA
    phi, next_phi = mlp(emp.phi.params, x.obs)[..., 0], mlp(next_phi, x.next_obs)[..., 0]
    assert x.terminated.sum() > 0
    np.testing.assert_allclose(result.phi_shaping, discount * (1 - x.terminated) * next_phi - phi, atol=1e-5)
    now = stats.norm.logpdf(x.action, pi(x.obs).mean, np.exp(pi(x.obs).log_std)).sum(axis=-1)
    np.testing.assert_allclose(result.log_prob, raw.log_prob if scoring else now, rtol=1e-4, atol=1e-4)
    for leaf in jax.tree.leaves(jax.grad(lambda emp: samples(emp).phi_shaping.sum(), allow_int=True)(emp)):
        assert leaf.dtype == jax.dtypes.float0 or not leaf.any()


@pytest.mark.parametrize("actions", ["stored", "resampled"])
@pytest.mark.parametrize("power", [1, 2])
def test_l_i_lowers_the_reward_or_is_a_penalty_on_the_policy_as_it_is_now(untrained, mlp, power, actions):
    hparams, key = HPARAMS.replace(lambda_i=0.3, beta=0.7), jax.random.PRNGKey(1)
    settings = {"l_i_power": power, "l_i_actions": actions}
    config, emp, _, _, x, pi = untrained(**settings)
    own, phi = empowerment.terms(key, emp.inverse.params, pi(x.obs), x, config), mlp(emp.phi.params, x.obs)[..., 0]

    def cost(log_prob):
        return 0.3 * np.abs(0.7 * own.log_q - (log_prob + phi)) ** power

    kept, penalty, data = empowerment.with_l_i(key, x, pi, emp, hparams, config)
    np.testing.assert_array_equal(kept.reward, x.reward)
    now = Gaussian(pi(x.obs).mean + 0.3, pi(x.obs).log_std - 0.2)
    judged = x.action if actions == "stored" else own.action
    now_log_prob = stats.norm.logpdf(judged, now.mean, np.exp(now.log_std)).sum(axis=-1)
    given = penalty(now, now.log_prob(x.action), data)
    np.testing.assert_allclose(given, cost(now_log_prob), rtol=1e-4, atol=1e-4)

    config = with_method_defaults(dataclasses.replace(config, l_i_in="reward"))
    lowered, nothing, data = empowerment.with_l_i(key, x, pi, emp, hparams, config)
    np.testing.assert_allclose(lowered.reward, x.reward - cost(own.log_prob), rtol=1e-4, atol=1e-4)
    assert (nothing, data) == (no_penalty, ())


def test_the_policys_std_follows_its_schedule_from_iteration_to_iteration(built, demos, tiny):
    _, init, step = built()
    hparams, policy_of = HPARAMS.replace(std_final_fraction=0.2, policy_lr=0.0), ppo(4, 2, tiny()).distribution
    state = init(jax.random.PRNGKey(0), hparams)
    for iteration in (0, 5, 6):  # of 10; what the network says stays exp(-0.5)
        agent = state.agent.replace(iteration=jnp.asarray(iteration, jnp.int32))
        before, (state, _) = state, step(state.replace(agent=agent), hparams, demos)
        std = np.exp(policy_of(state.agent.policy, jnp.ones(4)).log_std)
        np.testing.assert_allclose(std, np.full(2, np.exp(-0.5) * 0.2 ** (iteration / 10)), rtol=1e-5)
    # The samples of the last iteration are of the std that the one before had left, and know it.
    x = jax.tree.map(lambda ring: ring[2 % 2], state.replay.transitions)
    given = policy_of(before.agent.policy, (x.obs - agent.obs_stats.mean) / np.sqrt(agent.obs_stats.var))
    np.testing.assert_allclose(given.log_prob(x.action), x.log_prob, rtol=1e-4, atol=1e-4)
    assert np.abs(given.log_std - np.log(std)).min() > 0.1


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


class Recorded:
    """A configuration that remembers which of its fields were read."""

    def __init__(self, config):
        self._config, self.read = config, set()

    def __getattr__(self, name):
        self.read.add(name)
        return getattr(self._config, name)


@pytest.mark.parametrize("horizon", ["fixed", "absorbing"])
@pytest.mark.parametrize("form", ["sa", "s", "separable"])
def test_rewards_of_one_kind_are_one_function(toy, tiny, monkeypatch, form, horizon):
    config = tiny(reward_form=form, horizon=horizon)
    learned = learned_reward(make_irl(toy(ends_at=2.0), config).init(jax.random.PRNGKey(0), HPARAMS))
    size = learned.obs_stats.mean.shape[-1]
    obs, action = jnp.linspace(-1, 1, 3 * size).reshape(3, size), jnp.ones((3, 2))
    given = reward_function(config)(learned, obs, action)
    np.testing.assert_array_equal(reward_function(reward_kind(config))(learned, obs, action), given)
    assert reward_kind(config) == reward_kind(dataclasses.replace(config, method="airl_sa", iterations=7))
    assert reward_kind(config) != reward_kind(dataclasses.replace(config, hidden=(5,)))
    recorded = Recorded(with_method_defaults(config))
    monkeypatch.setattr("eairl_jax.irl.methods.with_method_defaults", lambda _: recorded)
    reward_function(config)(learned, obs, action)
    assert recorded.read <= set(REWARD_FIELDS)


@pytest.mark.parametrize("method", METHODS)
def test_the_state_keeps_its_types_so_that_a_step_compiles_once(built, demos, method):
    algorithm, _, _ = built(method=method, **WHOLE.get(method, {}))
    state = jax.eval_shape(algorithm.init, jax.random.PRNGKey(0), HPARAMS)
    after, _ = jax.eval_shape(algorithm.step, state, HPARAMS, demos)
    for (path, x), y in zip(jax.tree_util.tree_leaves_with_path(state), jax.tree.leaves(after), strict=True):
        kinds = [(leaf.shape, leaf.dtype, leaf.weak_type) for leaf in (x, y)]
        assert kinds[0] == kinds[1], jax.tree_util.keystr(path)


def test_the_slow_phi_is_copied_after_every_so_many_whole_iterations(built, demos, equal_trees):
    """`phi_sync_interval` is 2: after the second iteration and the fourth, not after the first."""
    _, init, step = built()
    state = init(jax.random.PRNGKey(0), HPARAMS)
    for iteration in range(1, 5):
        before, (state, _) = state, step(state, HPARAMS, demos)
        copied = state.empowerment.phi.params if iteration % 2 == 0 else before.empowerment.phi_target
        equal_trees(state.empowerment.phi_target, copied)


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
    (4, {"method": "gan_gcl"}, "rollout_length = 6 must be a multiple of episode_length = 5"),
    (4, {"discriminates": "trajectories"}, "rollout_length = 6 must be a multiple of episode_length = 5"),
    ({"pixels": (8, 8)}, {}, "flat vector"),
])  # fmt: skip
def test_what_cannot_work_is_refused(toy, tiny, size, changes, message):
    env = toy()
    env.observation_size = size
    with pytest.raises(InputError, match=message):
        make_irl(env, tiny(**changes)).init(jax.random.PRNGKey(0), HPARAMS)


def test_eairl_runs_on_an_mjx_task(tiny, flat):
    env, config = envs.make("pendulum"), tiny(normalize_obs="running")
    demos = flat(*(np.ones((2, 5, *tail), np.float32) for tail in ((3,), (1,), (3,), (), ())))
    algorithm = make_irl(env, config)
    step = jax.jit(algorithm.step)
    state = before = jax.jit(algorithm.init)(jax.random.PRNGKey(0), HPARAMS)
    for _ in range(2):
        state, metrics = step(state, HPARAMS, demos)
    assert all(np.isfinite(value) for value in metrics.values())
    assert -5 * 17 < metrics["true_return"] < 0
    assert (state.agent.iteration, state.agent.obs_stats.count) == (2, 2 * 24)
    assert jax.tree.structure(before) == jax.tree.structure(state)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state))


@pytest.mark.parametrize("changes", [{}, {"l_i_actions": "resampled"}], ids=["stored", "resampled"])
def test_of_executed_actions_the_part_beyond_the_bound_has_no_effect(toy, tiny, demos, changes):
    limit = 0.4
    env, config = toy(ends_at=4, action_limit=limit), tiny(actions="clipped", log_std_init=0.4, **changes)
    algorithm = make_irl(env, config)
    start, step = jax.jit(algorithm.init)(jax.random.PRNGKey(0), HPARAMS), jax.jit(algorithm.step)
    far = demos._replace(action=jnp.where(demos.action > limit, 9.0, demos.action))
    assert float((far.action == 9.0).mean()) > 0.5
    once, again = (step(start, HPARAMS, x) for x in (demos, far))
    jax.tree.map(np.testing.assert_array_equal, once, again)

    state, _ = once
    x = jax.tree.map(lambda ring: ring[0], state.replay.transitions)
    assert float(jnp.abs(x.action).max()) == np.float32(limit)  # what the discriminator sees of the policy
    np.testing.assert_array_max_ulp(x.next_obs[..., 1:3], x.action, maxulp=1)  # and what the environment did
    pi = ppo(4, 2, config, limit).distribution(start.agent.policy, x.obs)
    mass = stats.norm.logsf((limit - np.asarray(pi.mean)) / np.exp(np.asarray(pi.log_std)))
    at_high = np.asarray(x.action == np.float32(limit)).all(axis=-1)
    assert at_high.any()
    np.testing.assert_allclose(np.asarray(x.log_prob)[at_high], mass.sum(axis=-1)[at_high], rtol=1e-4)


def test_a_policy_starts_anew_and_its_reward_does_not(built, flat):
    hparams = HPARAMS.replace(policy_lr=0.0, std_initial_fraction=4.0, std_final_fraction=0.25)
    _, init, step = built(policy_reset_every=2)
    demos = flat(*(np.ones((1, 5, *tail), np.float32) for tail in ((4,), (2,), (4,), (), ())))
    states = [init(jax.random.PRNGKey(0), hparams)]
    for _ in range(5):
        states.append(step(states[-1], hparams, demos)[0])

    def weights(state):
        return np.concatenate([np.ravel(x) for x in jax.tree.leaves(state.agent.policy.nets.params)])

    moved = [bool((weights(a) != weights(b)).any()) for a, b in itertools.pairwise(states)]
    assert moved == [False, False, True, False, True]  # the rate is 0, so only a fresh one differs
    # Annealed within each policy's training.
    stds = [float(np.exp(state.agent.policy.log_std_offset)) for state in states]
    np.testing.assert_allclose(stds, [4.0, 4.0, 1.0, 4.0, 1.0, 4.0], rtol=1e-5)
    updates = [int(state.discriminator.adam.count) for state in states]
    assert updates == [2 * i for i in range(6)]


def test_a_reward_of_several_sources_does_not_see_which_one_it_is(toy, tiny, transitions):
    """The potential h and the policy do. What is left is a reward of the tasks' own observations."""
    env = toy()
    env.context_size = 2
    config = tiny(method="airl_sa")
    state = make_irl(env, config).init(jax.random.PRNGKey(0), HParams())
    params, raw = state.discriminator.params, transitions()
    inner = dataclasses.replace(with_method_defaults(config), context_size=2)
    obs, other = raw.obs, raw.obs.copy()
    other[..., 2:] += 1.0

    def logit(obs):
        samples = discriminator.Samples(obs, raw.action, raw.next_obs, raw.terminated, raw.log_prob, 0.0)
        return discriminator.logit_expert_high(params, samples, GAMMA, inner)

    seen, changed = (discriminator.reward(params, x, raw.action, inner) for x in (obs, other))
    np.testing.assert_array_equal(seen, changed)
    assert np.abs(np.asarray(logit(obs) - logit(other))).max() > 1e-3  # the shaping sees the source
    learned = learned_reward(state, context_size=2)
    alone = reward_function(config)(learned, raw.obs[..., :2], raw.action)
    np.testing.assert_allclose(alone, seen, rtol=1e-5)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"context_size": 1}, "context_size = 1: this task has 2"),
        ({"horizon": "absorbing"}, "horizon absorbing is not possible with several sources"),
        ({"method": "own_loss", "penalties": ("own_part",)}, "own_part: the reward of own_loss is no part of its"),
    ],
)
def test_settings_that_several_sources_cannot_have_are_refused(toy, tiny, no_trace, changes, message):
    del no_trace
    METHODS["own_loss"] = dataclasses.replace(METHODS["gail"], reward_loss=lambda rewards, logits: rewards.mean())
    env = toy()
    env.context_size = 2
    with pytest.raises(InputError, match=message):
        make_irl(env, tiny(**{"method": "airl_sa"} | changes))


def test_one_source_has_no_part_of_the_reward_for_itself(toy, tiny):
    with pytest.raises(InputError, match="own_part: there is one source"):
        make_irl(toy(), tiny(method="airl_sa", penalties=("own_part",)))
