"""The discriminator: a reward, its shaping, and the logit that tells the expert from the policy."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from eairl_jax import optimize
from eairl_jax.config import Config
from eairl_jax.methods import Method
from eairl_jax.nets import scalar
from eairl_jax.types import Key, Metrics, PyTree

# softplus(-3) = 0.05: actions cost next to nothing until the expert shows that they do.
FIRST_RAW_COST = -3.0


class Samples(NamedTuple):
    """What the logit needs of a transition, `[..., ]` each; observations normalised.

    Attributes:
      obs, action, next_obs, terminated: as in `Transition`.
      log_prob: log pi(a|s) under the *current* policy, for the expert's actions too.
      phi_shaping: `gamma Phi'(s') - Phi(s)`, a constant for the discriminator; 0 without empowerment.
    """

    obs: jax.Array
    action: jax.Array
    next_obs: jax.Array
    terminated: jax.Array
    log_prob: jax.Array
    phi_shaping: jax.Array


def shaping(potential: jax.Array, next_potential: jax.Array, terminated: jax.Array, gamma) -> jax.Array:
    """`F = gamma (1 - terminated) potential(s') - potential(s)` (Ng et al. 1999); nothing is owed after the end."""
    return gamma * (1.0 - terminated) * next_potential - potential


def init(key: Key, obs_size: int, action_size: int, method: Method, config: Config) -> PyTree:
    """Parameters: "g" of the reward, "k" of a separable reward's action part, "h" of a learned potential."""
    g_key, k_key, h_key = jax.random.split(key, 3)
    obs, action, net = jnp.zeros((1, obs_size)), jnp.zeros((1, action_size)), scalar(config)
    params = {"g": net.init(g_key, obs, action) if method.reward_form == "sa" else net.init(g_key, obs)}
    if method.reward_form == "separable":
        quadratic = config.action_part == "quadratic"
        params["k"] = {"raw_cost": jnp.full((), FIRST_RAW_COST)} if quadratic else net.init(k_key, action)
    if method.shaping in ("learned", "both"):
        params["h"] = net.init(h_key, obs)
    return params


def reward(params: PyTree, obs: jax.Array, action: jax.Array, form: str, config: Config) -> jax.Array:
    """What is transferred, `[...]`: g(s,a), g(s), or g(s) + k(a). Observations normalised.

    A separable reward can hold a cost of actions, and cannot memorise which action the expert takes where.
    """
    net = scalar(config)
    if form == "sa":
        return net.apply(params["g"], obs, action)  # pyright: ignore
    g = net.apply(params["g"], obs)
    if form == "s":
        return g  # pyright: ignore
    if config.action_part == "net":
        return g + net.apply(params["k"], action)  # pyright: ignore
    return g - jax.nn.softplus(params["k"]["raw_cost"]) * jnp.sum(action**2, axis=-1)


def logit_expert_high(params: PyTree, samples: Samples, gamma, method: Method, config: Config) -> jax.Array:
    """`log D - log(1 - D)`, `[...]`, with f = reward + shaping (Eq. 9)."""
    f = reward(params, samples.obs, samples.action, method.reward_form, config)
    if method.shaping in ("learned", "both"):
        h, next_h = (scalar(config).apply(params["h"], x) for x in (samples.obs, samples.next_obs))
        f += shaping(h, next_h, samples.terminated, gamma)
    if method.shaping in ("empowerment", "both"):
        f += samples.phi_shaping
    return method.logit_expert_high(f, samples.log_prob)


def loss(params: PyTree, expert: Samples, policy: Samples, gamma, method: Method, config: Config):
    """Binary cross-entropy, the expert labelled 1 (Eq. 10, its signs mended), and its metrics.

    `-log D = softplus(-logit)` on the expert, `-log(1 - D) = softplus(logit)` on the policy.
    """
    # One forward pass over both halves: a small network costs by the call, not by the sample.
    both = jax.tree.map(lambda e, p: jnp.concatenate([e, p]), expert, policy)
    logit = logit_expert_high(params, both, gamma, method, config)
    expert_logit, policy_logit = jnp.split(logit, [expert.obs.shape[0]])
    cross_entropy = 0.5 * (jax.nn.softplus(-expert_logit).mean() + jax.nn.softplus(policy_logit).mean())
    metrics = {
        "discriminator_loss": cross_entropy,
        "accuracy_expert": (expert_logit > 0).mean(),
        "accuracy_policy": (policy_logit < 0).mean(),
    }
    return cross_entropy, metrics


def fit(
    fitted: optimize.Fitted, expert: Samples, policy: Samples, hparams, method: Method, config: Config
) -> tuple[optimize.Fitted, Metrics]:
    """Updates D on minibatches `[updates, batch, ...]` of the expert and of the policy's history."""
    fitted, metrics = optimize.fit(
        fitted,
        lambda params, pair: loss(params, *pair, hparams.gamma, method, config),
        (expert, policy),
        hparams.discriminator_lr,
    )
    metrics["accuracy"] = 0.5 * (metrics["accuracy_expert"] + metrics["accuracy_policy"])
    for name, samples in (("reward_expert", expert), ("reward_policy", policy)):
        metrics[name] = reward(fitted.params, samples.obs[-1], samples.action[-1], method.reward_form, config).mean()
    return fitted, metrics
