"""The reward's forms, the shaping, and the loss, against NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import HParams, discriminator, optimize
from eairl_jax.methods import resolve

GAMMA, BATCH = 0.9, 16


@pytest.fixture
def samples():
    """Random `Samples`, a quarter of them terminated."""

    def make(seed):
        rng = np.random.default_rng(seed)

        def draw(*tail):
            return jnp.asarray(rng.normal(size=(BATCH, *tail)), jnp.float32)

        terminated = jnp.asarray(rng.random(BATCH) < 0.25, jnp.float32)
        return discriminator.Samples(draw(4), draw(2), draw(4), terminated, draw(), draw())

    return make


@pytest.fixture
def made(tiny):
    """`(method, config, params)`."""

    def make(**changes):
        config = tiny(**changes)
        method = resolve(config)
        params = discriminator.init(jax.random.PRNGKey(0), 4, 2, method, config)
        if "raw_cost" in params.get("k", ()):
            params["k"]["raw_cost"] += 0.7
        return method, config, params

    return make


@pytest.fixture
def expected_f(mlp, numpy_reward):
    """f(s, a, s'), written out."""

    def f(params, x, shaping):
        f = numpy_reward(params, x.obs, x.action)
        if shaping in ("learned", "both"):
            h, next_h = (mlp(params["h"], obs)[:, 0] for obs in (x.obs, x.next_obs))
            f = f + GAMMA * np.where(x.terminated == 1, 0, next_h) - h
        return f + x.phi_shaping if shaping in ("empowerment", "both") else f

    return f


@pytest.mark.parametrize(
    ("form", "parts", "inputs"),
    [
        ({"reward_form": "sa"}, {"g"}, 6),
        ({"reward_form": "s"}, {"g"}, 4),
        ({"reward_form": "separable", "action_part": "quadratic"}, {"g", "k"}, 4),
        ({"reward_form": "separable", "action_part": "net"}, {"g", "k"}, 4),
    ],
    ids=["sa", "s", "quadratic", "net"],
)
@pytest.mark.parametrize("shaping", ["empowerment", "learned", "both", "none"])
def test_logit_is_reward_and_shaping_less_log_pi(made, samples, numpy_reward, expected_f, form, parts, inputs, shaping):
    method, config, params = made(shaping=shaping, **form)
    assert set(params) == parts | ({"h"} if shaping in ("learned", "both") else set())
    assert params["g"]["params"]["MLP_0"]["Dense_0"]["kernel"].shape[0] == inputs
    x = samples(0)
    logit = discriminator.logit_expert_high(params, x, GAMMA, method, config)
    np.testing.assert_allclose(logit, expected_f(params, x, shaping) - x.log_prob, atol=1e-5)
    reward = discriminator.reward(params, x.obs, x.action, method.reward_form, config)
    np.testing.assert_allclose(reward, numpy_reward(params, x.obs, x.action), atol=1e-5)


def test_eairl_without_shaping_is_unshaped_airl_and_so_is_a_potential_of_zero(made, samples):
    x = samples(0)
    airl, config, params = made(method="airl_sa", shaping="none")
    unshaped = discriminator.logit_expert_high(params, x, GAMMA, airl, config)
    eairl, config, same = made(method="eairl", shaping="none")
    jax.tree.map(np.testing.assert_array_equal, params, same)
    np.testing.assert_array_equal(discriminator.logit_expert_high(same, x, GAMMA, eairl, config), unshaped)
    shaped, config, same = made(method="eairl")
    phi_0 = x._replace(phi_shaping=jnp.zeros(BATCH))
    np.testing.assert_array_equal(discriminator.logit_expert_high(same, phi_0, GAMMA, shaped, config), unshaped)
    assert np.abs(discriminator.logit_expert_high(same, x, GAMMA, shaped, config) - unshaped).max() > 0.1


@pytest.mark.parametrize("terminated", [False, True])
def test_shaping_telescopes_over_an_episode(terminated):
    potential = np.random.default_rng(0).normal(size=13)
    end = np.zeros(12)
    end[-1] = terminated
    f = discriminator.shaping(potential[:-1], potential[1:], end, GAMMA)
    total = np.sum(GAMMA ** np.arange(12) * f)
    last = 0.0 if terminated else GAMMA**12 * potential[-1]
    np.testing.assert_allclose(total, last - potential[0], rtol=1e-12)


@pytest.mark.parametrize("method", ["eairl", "gail"])
def test_loss_is_cross_entropy_with_the_expert_labelled_1(made, samples, expected_f, method):
    row, config, params = made(method=method)
    expert, policy = samples(1), samples(2)
    loss, metrics = discriminator.loss(params, expert, policy, GAMMA, row, config)
    log_pi = [x.log_prob if method == "eairl" else 0.0 for x in (expert, policy)]
    expert_d, policy_d = (
        1 / (1 + np.exp(minus - expected_f(params, x, row.shaping)))
        for x, minus in zip((expert, policy), log_pi, strict=True)
    )
    np.testing.assert_allclose(loss, -0.5 * (np.log(expert_d).mean() + np.log(1 - policy_d).mean()), rtol=1e-4)
    np.testing.assert_allclose(metrics["accuracy_expert"], (expert_d > 0.5).mean(), rtol=1e-6)
    np.testing.assert_allclose(metrics["accuracy_policy"], (policy_d < 0.5).mean(), rtol=1e-6)


def test_fit_learns_to_tell_the_expert_from_the_policy(made, samples):
    method, config, params = made(method="gail")
    expert = samples(1)._replace(action=samples(1).action + 2.0)
    minibatches = jax.tree.map(lambda x: jnp.repeat(x[None], 100, axis=0), (expert, samples(2)))
    fitted, seen = optimize.start(params), []
    for _ in range(2):
        fitted, metrics = discriminator.fit(fitted, *minibatches, HParams(discriminator_lr=1e-2), method, config)
        seen.append(metrics)
    first, second = seen
    assert second["discriminator_loss"] < 0.5 * first["discriminator_loss"]
    assert min(second["accuracy_expert"], second["accuracy_policy"]) > 0.9
