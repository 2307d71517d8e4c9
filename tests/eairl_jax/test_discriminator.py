"""The reward's forms, the shaping, the loss and its regularisers, against NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import HParams, discriminator, train_state
from eairl_jax.methods import METHODS, Method, gail_logit, with_method_defaults

GAMMA, BATCH = 0.9, 16
HPARAMS = HParams(gamma=GAMMA)
FORMS = {
    "sa": {"reward_form": "sa"},
    "s": {"reward_form": "s"},
    "quadratic": {"reward_form": "separable", "action_part": "quadratic"},
    "net": {"reward_form": "separable", "action_part": "net"},
}


@pytest.fixture
def samples():
    """Random `Samples` `[BATCH, length]`, a quarter of them terminated."""

    def make(seed, length=1, spread=1.0):
        rng = np.random.default_rng(seed)

        def draw(*tail):
            return jnp.asarray(spread * rng.normal(size=(BATCH, length, *tail)), jnp.float32)

        terminated = jnp.asarray(rng.random((BATCH, length)) < 0.25, jnp.float32)
        return discriminator.Samples(draw(4), draw(2), draw(4), terminated, draw(), draw())

    return make


@pytest.fixture
def made(tiny):
    """`(resolved config, params)`."""

    def make(**changes):
        config = with_method_defaults(tiny(**changes))
        params = discriminator.init(jax.random.PRNGKey(0), 4, 2, config)
        if "raw_cost" in params.get("k", ()):
            params["k"]["raw_cost"] += 0.7
        return config, params

    return make


@pytest.fixture
def expected_f(mlp, numpy_reward):
    """f(s, a, s'), written out."""

    def f(params, x, shaping, discount=GAMMA):
        f = numpy_reward(params, x.obs, x.action)
        if shaping in ("learned", "both"):
            h, next_h = (mlp(params["h"], obs)[..., 0] for obs in (x.obs, x.next_obs))
            f = f + discount * np.where(x.terminated == 1, 0, next_h) - h
        return f + x.phi_shaping if shaping in ("empowerment", "both") else f

    return f


@pytest.mark.parametrize(
    ("form", "parts", "inputs"),
    [("sa", {"g"}, 6), ("s", {"g"}, 4), ("quadratic", {"g", "k"}, 4), ("net", {"g", "k"}, 4)],
)
@pytest.mark.parametrize("shaping", ["empowerment", "learned", "both", "none"])
def test_logit_is_reward_and_shaping_less_log_pi(made, samples, numpy_reward, expected_f, form, parts, inputs, shaping):
    config, params = made(shaping=shaping, **FORMS[form])
    assert set(params) == parts | ({"h"} if shaping in ("learned", "both") else set())
    assert params["g"]["params"]["MLP_0"]["Dense_0"]["kernel"].shape[0] == inputs
    x = samples(0)
    logit = discriminator.logit_expert_high(params, x, GAMMA, config)
    np.testing.assert_allclose(logit, expected_f(params, x, shaping) - x.log_prob, atol=1e-5)
    reward = discriminator.reward(params, x.obs, x.action, config)
    np.testing.assert_allclose(reward, numpy_reward(params, x.obs, x.action), atol=1e-5)


def test_eairl_without_shaping_is_unshaped_airl_and_so_is_a_potential_of_zero(made, samples):
    x = samples(0)
    airl, params = made(method="airl_sa", shaping="none")
    unshaped = discriminator.logit_expert_high(params, x, GAMMA, airl)
    eairl, same = made(method="eairl", shaping="none")
    jax.tree.map(np.testing.assert_array_equal, params, same)
    np.testing.assert_array_equal(discriminator.logit_expert_high(same, x, GAMMA, eairl), unshaped)
    shaped, same = made(method="eairl")
    phi_0 = x._replace(phi_shaping=jnp.zeros_like(x.phi_shaping))
    np.testing.assert_array_equal(discriminator.logit_expert_high(same, phi_0, GAMMA, shaped), unshaped)
    assert np.abs(discriminator.logit_expert_high(same, x, GAMMA, shaped) - unshaped).max() > 0.1


@pytest.mark.parametrize("terminated", [False, True])
def test_shaping_telescopes_over_an_episode(terminated):
    potential = np.random.default_rng(0).normal(size=13)
    end = np.zeros(12)
    end[-1] = terminated
    f = discriminator.shaping(potential[:-1], potential[1:], end, GAMMA)
    total = np.sum(GAMMA ** np.arange(12) * f)
    last = 0.0 if terminated else GAMMA**12 * potential[-1]
    np.testing.assert_allclose(total, last - potential[0], rtol=1e-12)


@pytest.mark.parametrize(
    ("method", "length", "changes"),
    [
        ("eairl", 1, {}),
        ("airl_sa", 1, {}),
        ("airl_sa", 1, {"shaping_discount": "one"}),
        ("gail", 1, {}),
        ("gan_gcl", 3, {}),
        ("eairl", 3, {"discriminates": "trajectories", "shaping": "both"}),
    ],
)
def test_loss_is_cross_entropy_with_the_expert_labelled_1(made, samples, expected_f, method, length, changes):
    """D of a trajectory is `exp f(tau) / (exp f(tau) + pi(tau))`, f(tau) a sum and pi(tau) a product."""
    config, params = made(method=method, **changes)
    discount = 1.0 if changes.get("shaping_discount") == "one" else GAMMA

    def d(x):
        f = np.asarray(expected_f(params, x, config.shaping, discount), np.float64).sum(axis=-1)
        pi = 1.0 if method == "gail" else np.exp(np.asarray(x.log_prob, np.float64)).prod(axis=-1)
        return np.exp(f) / (np.exp(f) + pi)

    expert, policy = samples(1, length, 2.0), samples(2, length, 2.0)
    loss, metrics = discriminator.loss(params, expert, policy, HPARAMS, config)
    expert_d, policy_d = d(expert), d(policy)
    logit = discriminator.logit_expert_high(params, expert, discount, config).sum(axis=-1)
    np.testing.assert_allclose(logit, np.log(expert_d / (1 - expert_d)), rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(loss, -0.5 * (np.log(expert_d).mean() + np.log(1 - policy_d).mean()), rtol=1e-4)
    np.testing.assert_allclose(metrics["discriminator_loss"], loss, rtol=1e-6)
    np.testing.assert_allclose(metrics["accuracy_expert"], (expert_d > 0.5).mean(), rtol=1e-6)
    np.testing.assert_allclose(metrics["accuracy_policy"], (policy_d < 0.5).mean(), rtol=1e-6)
    saturated = np.abs(np.concatenate([expert_d, policy_d]) - 0.5).round(12) > 0.49
    assert 0 < saturated.mean() < 1
    np.testing.assert_allclose(metrics["saturated"], saturated.mean(), rtol=1e-6)


@pytest.fixture
def beside(monkeypatch):
    """A method whose reward is learned beside the classifier, by a covariance over trajectories."""

    def covariance(r, logit):
        r, logit = r.sum(axis=1), logit.sum(axis=1)
        return -jnp.mean((r - r.mean()) * (logit - logit.mean()))

    row = Method("", gail_logit, lambda r: 2.0 * r, "s", "none", reward_loss=covariance, discriminates="trajectories")
    monkeypatch.setitem(METHODS, "beside", row)


@pytest.mark.usefixtures("beside")
@pytest.mark.parametrize("form", FORMS)
def test_a_reward_beside_the_classifier_has_a_loss_of_its_own(made, samples, mlp, numpy_reward, form):
    config, params = made(method="beside", **FORMS[form])
    expert, policy = samples(1, 3), samples(2, 3)
    both = [np.concatenate(pair).astype(np.float64) for pair in zip(expert, policy, strict=True)]
    inputs = both[0] if form == "s" else np.concatenate(both[:2], axis=-1)
    logit, r = mlp(params["d"], inputs)[..., 0], numpy_reward(params, *both[:2])
    np.testing.assert_allclose(discriminator.logit_expert_high(params, expert, GAMMA, config), logit[:BATCH], atol=1e-5)
    paid = discriminator.policy_reward(params, expert, HPARAMS, config)
    np.testing.assert_allclose(paid, 2 * r[:BATCH], rtol=1e-4, atol=1e-5)

    (_, metrics), slope = jax.value_and_grad(discriminator.loss, has_aux=True)(params, expert, policy, HPARAMS, config)
    d = 1 / (1 + np.exp(-logit))
    cross_entropy = -0.5 * (np.log(d[:BATCH]).mean() + np.log(1 - d[BATCH:]).mean())
    np.testing.assert_allclose(metrics["discriminator_loss"], cross_entropy, rtol=1e-4)
    np.testing.assert_allclose(metrics["accuracy_expert"], (d[:BATCH] > 0.5).mean(), rtol=1e-6)
    covariance = np.cov(r.sum(axis=1), logit.sum(axis=1), bias=True)[0, 1]
    np.testing.assert_allclose(metrics["reward_loss"], -covariance, rtol=1e-3)

    # The classifier learns by the cross-entropy alone, and the reward by the covariance alone.
    alone = jax.grad(lambda p: METHODS["beside"].loss(*discriminator.logit_expert_high(
        p, jax.tree.map(lambda *pair: jnp.stack(pair), expert, policy), GAMMA, config)))(params)  # fmt: skip
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-6), slope["d"], alone["d"])
    assert all(np.abs(leaf).max() == 0 for leaf in jax.tree.leaves(alone["g"]))
    assert any(np.abs(leaf).max() > 1e-4 for leaf in jax.tree.leaves(slope["g"]))


@pytest.mark.parametrize("method", ["gail", "gan_gcl"])
def test_fit_learns_to_tell_the_expert_from_the_policy(made, samples, method):
    config, params = made(method=method)
    length = 3 if method == "gan_gcl" else 1
    expert = samples(1, length)._replace(action=samples(1, length).action + 2.0)
    minibatches = jax.tree.map(lambda x: jnp.repeat(x[None], 100, axis=0), (expert, samples(2, length)))
    fitted, seen = train_state.init(params), []
    for _ in range(2):
        fitted, metrics = discriminator.fit(fitted, *minibatches, HParams(discriminator_lr=1e-2), config)
        seen.append(metrics)
    first, second = seen
    assert second["discriminator_loss"] < 0.5 * first["discriminator_loss"]
    assert min(second["accuracy_expert"], second["accuracy_policy"]) > 0.9


@pytest.mark.parametrize("form", FORMS)
def test_gradient_penalty_is_on_the_slope_between_expert_and_policy(made, samples, numpy_reward, form):
    config, params = made(**FORMS[form])
    expert, policy = samples(1, 2), samples(2, 2)
    ends = [np.concatenate([x.obs, x.action], axis=-1).reshape(-1, 6).astype(np.float64) for x in (expert, policy)]
    share = (np.arange(2 * BATCH) * 0.6180339887 % 1)[:, None]
    at, eps = share * ends[0] + (1 - share) * ends[1], 1e-6

    def reward(x):
        return numpy_reward(params, x[:, :4], x[:, 4:])

    slope = np.stack([(reward(at + step) - reward(at - step)) / (2 * eps) for step in eps * np.eye(6)], axis=-1)
    expected = ((np.linalg.norm(slope, axis=-1) - 1) ** 2).mean()
    np.testing.assert_allclose(discriminator.gradient_penalty(params, expert, policy, config), expected, rtol=1e-3)
    assert expected > 0.01


def test_a_flat_reward_has_a_penalty_with_a_gradient(made, samples):
    """The norm's derivative at 0 is not a number, unless one keeps away from it."""
    config, params = made()
    flat = jax.tree.map(jnp.zeros_like, params)
    value, slope = jax.value_and_grad(discriminator.gradient_penalty)(flat, samples(1), samples(2), config)
    np.testing.assert_allclose(value, 1.0, atol=1e-4)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slope))


@pytest.mark.parametrize("form", FORMS)
def test_action_variance_is_over_actions_of_other_samples_at_one_state(made, samples, mlp, numpy_reward, form):
    config, params = made(**FORMS[form])
    x = samples(1, 2)
    given = discriminator.action_variance(params, x, config)
    obs, action = (np.asarray(part, np.float64) for part in (x.obs, x.action))
    own_and_three_more = [action[np.arange(BATCH) - back] for back in range(4)]
    # g(s) is the same for every action: only what the action adds to it varies, which is nothing for g(s) alone.
    if form == "sa":
        rewards = [numpy_reward(params, obs, a) for a in own_and_three_more]
    elif form == "net":
        rewards = [mlp(params["k"], a)[..., 0] for a in own_and_three_more]
    else:
        cost = np.log1p(np.exp(float(params["k"]["raw_cost"]))) if form == "quadratic" else 0.0
        rewards = [-cost * (a**2).sum(axis=-1) for a in own_and_three_more]
    expected = np.var(rewards, axis=0).mean()
    np.testing.assert_allclose(given, expected, rtol=1e-3, atol=1e-12)
    assert (expected == 0) == (form == "s")


@pytest.mark.parametrize("form", FORMS)
def test_input_sparsity_is_the_sum_of_each_observations_slope(made, samples, numpy_reward, form):
    config, params = made(**FORMS[form])
    x, eps = samples(1, 2), 1e-6
    obs, action = (np.asarray(part, np.float64) for part in (x.obs, x.action))
    slope = [
        (numpy_reward(params, obs + step, action) - numpy_reward(params, obs - step, action)) / (2 * eps)
        for step in eps * np.eye(4)
    ]
    expected = sum(np.sqrt((own**2).mean()) for own in slope)
    np.testing.assert_allclose(discriminator.input_sparsity(params, x, config), expected, rtol=1e-3)
    assert expected > 0.1


def test_input_sparsity_leaves_a_reward_the_inputs_that_tell_the_expert(made, samples):
    """Of two entries that differ, one by much, the reward keeps that one; without the penalty it uses both."""

    def shifted(seed, by):
        x = jax.tree.map(lambda *parts: jnp.concatenate(parts), *(samples(seed + more) for more in range(0, 40, 2)))
        return x._replace(obs=x.obs + jnp.asarray(by), log_prob=jnp.zeros_like(x.log_prob))

    expert, policy = shifted(1, [2.0, 0.5, 0.0, 0.0]), shifted(2, [0.0] * 4)
    minibatches = jax.tree.map(lambda x: jnp.repeat(x[None], 400, axis=0), (expert, policy))
    shares = {}
    for weight, penalties in ((0.0, ()), (0.1, ("input_sparsity",))):
        config, params = made(reward_form="s", shaping="none", penalties=penalties)
        hparams = HParams(discriminator_lr=1e-2, input_sparsity=weight)
        fitted, _ = discriminator.fit(train_state.init(params), *minibatches, hparams, config)
        slope = jax.vmap(jax.grad(lambda o: discriminator.reward(fitted.params, o, jnp.zeros(2), config)))  # noqa: B023
        sizes = jnp.sqrt(jnp.mean(slope(policy.obs.reshape(-1, 4)) ** 2, axis=0))
        shares[weight] = float(sizes[0] / sizes.sum())
    assert shares[0.1] > 0.9 > 0.7 > shares[0.0]


SOURCES = dict(context_size=2, penalties=("own_part",), shaping="none")


@pytest.fixture
def of_two_sources(samples):
    """`samples` whose observations end with two entries that name one of two sources, by turns."""

    def make(seed, length=1):
        x = samples(seed, length)
        which = jnp.broadcast_to(jax.nn.one_hot(jnp.arange(BATCH) % 2, 2)[:, None], (BATCH, length, 2))
        return x._replace(**{name: x._asdict()[name].at[..., 2:].set(which) for name in ("obs", "next_obs")})

    return make


@pytest.mark.parametrize("form", ["s", "sa", "separable"])
def test_each_source_has_a_part_of_the_reward_for_itself(made, of_two_sources, mlp, form):
    config, params = made(**SOURCES, reward_form=form)
    x = of_two_sources(1)
    seen = x.obs if form == "s" else np.concatenate([x.obs, x.action], axis=-1)
    m = mlp(params["m"], seen)[..., 0]
    r = discriminator.reward(params, x.obs, x.action, config)
    logit = discriminator.logit_expert_high(params, x, GAMMA, config)
    np.testing.assert_allclose(logit, r + m - x.log_prob, rtol=1e-4, atol=1e-5)
    other = x._replace(obs=x.obs.at[..., 2:].set(1.0 - x.obs[..., 2:]))
    np.testing.assert_array_equal(discriminator.reward(params, other.obs, x.action, config), r)
    assert (discriminator.own_part(params, other.obs, x.action, config) != m).all()


def test_what_a_source_has_for_itself_is_charged_by_its_mean_square(made, of_two_sources):
    config, params = made(**SOURCES)
    expert, policy = of_two_sources(1), of_two_sources(2)
    free, charged = (
        discriminator.loss(params, expert, policy, HPARAMS.replace(own_part=w), config) for w in (0.0, 0.7)
    )
    both = jax.tree.map(lambda e, p: jnp.concatenate([e, p]), expert, policy)
    size = np.mean(np.square(discriminator.own_part(params, both.obs, both.action, config)))
    np.testing.assert_allclose(charged[0] - free[0], 0.7 * size, rtol=1e-4)
    np.testing.assert_allclose(charged[1]["own_part"], size, rtol=1e-5)


def test_the_shared_reward_holds_what_two_demonstrators_share(made, of_two_sources):
    """Both go far in the first entry; in the second one goes up and the other down."""

    def drawn(seed, share, style):
        x = jax.tree.map(lambda *parts: jnp.concatenate(parts), *(of_two_sources(seed + 2 * i) for i in range(20)))
        shift = jnp.stack([share + 0 * x.obs[..., 2], style * (x.obs[..., 2] - x.obs[..., 3])], axis=-1)
        return x._replace(obs=x.obs.at[..., :2].add(shift), log_prob=jnp.zeros_like(x.log_prob))

    minibatches = jax.tree.map(lambda x: jnp.repeat(x[None], 400, axis=0), (drawn(1, 1.5, 1.5), drawn(2, 0.0, 0.0)))
    config, params = made(**SOURCES, reward_form="s")
    hparams = HParams(discriminator_lr=1e-2, own_part=0.03)
    fitted, _ = discriminator.fit(train_state.init(params), *minibatches, hparams, config)

    def slope(function, obs):
        return jax.vmap(jax.grad(lambda o: function(fitted.params, o, jnp.zeros(2), config)))(obs)[:, :2].mean(axis=0)

    obs = minibatches[1].obs[0].reshape(-1, 4)
    shared = slope(discriminator.reward, obs)
    assert shared[0] > 0.3
    assert abs(shared[1]) < 0.2 * shared[0]
    first, second = (slope(discriminator.own_part, obs[obs[:, source] == 1]) for source in (2, 3))
    assert first[1] > 0.3
    assert second[1] < -0.3


@pytest.mark.parametrize(
    ("name", "weight"),
    [("gradient", "gradient_penalty"), ("action_variance", "action_variance"), ("input_sparsity", "input_sparsity")],
)
def test_a_penalty_counts_by_its_weight_if_it_is_named(made, samples, name, weight):
    expert, policy, hparams = samples(1), samples(2), HPARAMS.replace(**{weight: 0.7})
    (plain, params), (config, _) = made(), made(penalties=(name,))
    without, with_it = (discriminator.loss(params, expert, policy, hparams, c) for c in (plain, config))
    both = jax.tree.map(lambda e, p: jnp.concatenate([e, p]), expert, policy)
    if name == "gradient":
        penalty = discriminator.gradient_penalty(params, expert, policy, config)
    else:
        penalty = getattr(discriminator, name)(params, both, config)
    np.testing.assert_allclose(with_it[0] - without[0], 0.7 * penalty, rtol=1e-4)
    assert penalty > 0.01
    jax.tree.map(np.testing.assert_array_equal, with_it[1], without[1])  # the metric is the cross-entropy alone
