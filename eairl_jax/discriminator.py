"""The discriminator: a reward, its shaping, and the logit that tells the expert from the policy."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from eairl_jax import train_state
from eairl_jax.config import Config
from eairl_jax.methods import METHODS
from eairl_jax.nets import scalar
from eairl_jax.types import HParams, Key, Metrics, PyTree

# softplus(-3) = 0.05: actions cost next to nothing until the expert shows that they do.
FIRST_RAW_COST = -3.0

# A logit beyond it means D < 1 % or D > 99 %: hardly any gradient is left.
SATURATED_LOGIT = 4.595

# Actions that `action_variance` tries at each state: its own, and others of the batch.
TRIED_ACTIONS = 4


class Samples(NamedTuple):
    """What the logit needs of a transition, `[..., ]` each.

    In a minibatch of the discriminator the leading axes are `[batch, length]`: `length` consecutive steps are judged
    together, 1 for all methods but those that discriminate trajectories.

    Attributes:
      obs, action, next_obs, terminated: as in `Transition`, observations as the reward sees them.
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


def init(key: Key, obs_size: int, action_size: int, config: Config) -> PyTree:
    """Parameters: "g" of the reward, "k" of a separable reward's action part, "h" of a learned potential."""
    g_key, k_key, h_key = jax.random.split(key, 3)
    obs, action, net = jnp.zeros((1, obs_size)), jnp.zeros((1, action_size)), scalar(config)
    params = {"g": net.init(g_key, obs, action) if config.reward_form == "sa" else net.init(g_key, obs)}
    if config.reward_form == "separable":
        quadratic = config.action_part == "quadratic"
        params["k"] = {"raw_cost": jnp.full((), FIRST_RAW_COST)} if quadratic else net.init(k_key, action)
    if config.shaping in ("learned", "both"):
        params["h"] = net.init(h_key, obs)
    return params


def reward(params: PyTree, obs: jax.Array, action: jax.Array, config: Config) -> jax.Array:
    """What is transferred, `[...]`: g(s,a), g(s), or g(s) + k(a).

    A separable reward can hold a cost of actions, and cannot memorise which action the expert takes where.
    """
    net = scalar(config)
    if config.reward_form == "sa":
        return net.apply(params["g"], obs, action)  # pyright: ignore
    g = net.apply(params["g"], obs)
    if config.reward_form == "s":
        return g  # pyright: ignore
    if config.action_part == "net":
        return g + net.apply(params["k"], action)  # pyright: ignore
    return g - jax.nn.softplus(params["k"]["raw_cost"]) * jnp.sum(action**2, axis=-1)


def logit_expert_high(params: PyTree, samples: Samples, discount, config: Config) -> jax.Array:
    """`log D - log(1 - D)` of each transition, `[...]`, with f = reward + shaping (Eq. 9)."""
    f = reward(params, samples.obs, samples.action, config)
    if config.shaping in ("learned", "both"):
        h, next_h = (scalar(config).apply(params["h"], x) for x in (samples.obs, samples.next_obs))
        f += shaping(h, next_h, samples.terminated, discount)
    if config.shaping in ("empowerment", "both"):
        f += samples.phi_shaping
    return METHODS[config.method].logit_expert_high(f, samples.log_prob)


def shaping_discount(hparams: HParams, config: Config):
    """gamma of the shaping term: the task's, or 1."""
    return 1.0 if config.shaping_discount == "one" else hparams.gamma


def gradient_penalty(params: PyTree, expert: Samples, policy: Samples, config: Config) -> jax.Array:
    """`(|grad r| - 1)^2` of the reward's inputs between expert and policy (Gulrajani et al. 2017), a mean `[]`.

    The share of each is the golden ratio's sequence: even over [0, 1], and without relation to a minibatch's order.
    """
    pair = (expert.obs, expert.action), (policy.obs, policy.action)
    flat = jax.tree.map(lambda x: x.reshape(-1, x.shape[-1]), pair)
    share = (jnp.arange(flat[0][0].shape[0]) * 0.6180339887 % 1.0)[:, None]
    inputs = jax.tree.map(lambda e, p: share * e + (1.0 - share) * p, *flat)
    slope = jax.vmap(jax.grad(lambda x: reward(params, *x, config)))(inputs)
    norm = jnp.sqrt(sum(jnp.sum(leaf**2, axis=-1) for leaf in slope) + 1e-12)
    return jnp.mean((norm - 1.0) ** 2)


def action_variance(params: PyTree, samples: Samples, config: Config) -> jax.Array:
    """Variance of r(s, .) over other actions of the minibatch, a mean over its states `[]`.

    What a reward says of one action at one state, and not at others, is what does not transfer.
    """
    actions = jnp.stack([jnp.roll(samples.action, shift, axis=0) for shift in range(TRIED_ACTIONS)])
    obs = jnp.broadcast_to(samples.obs, (TRIED_ACTIONS, *samples.obs.shape))
    return jnp.var(reward(params, obs, actions, config), axis=0).mean()


def input_sparsity(params: PyTree, samples: Samples, config: Config) -> jax.Array:
    """`sum_i sqrt(E (d r / d obs_i)^2)`, a group lasso over the observation's entries, `[]`.

    A discriminator tells the expert by all that is at hand; what a reward can do without should not be in it. The
    slopes are the function's own, not the first layer's weights, so later layers cannot make up for smaller ones.
    Entries count in the units in which the reward sees them (`Config.normalize_obs`).
    """
    obs, action = (x.reshape(-1, x.shape[-1]) for x in (samples.obs, samples.action))
    slope = jax.vmap(jax.grad(lambda obs, action: reward(params, obs, action, config)))(obs, action)
    return jnp.sqrt(jnp.mean(slope**2, axis=0) + 1e-8).sum()  # the root's derivative at 0 is infinite


def loss(params: PyTree, expert: Samples, policy: Samples, hparams: HParams, config: Config):
    """Binary cross-entropy, the expert labelled 1 (Eq. 10, its signs mended), and its metrics.

    `-log D = softplus(-logit)` on the expert, `-log(1 - D) = softplus(logit)` on the policy; the logit of a
    trajectory is the sum of its transitions' (Finn et al. 2016).
    """
    # One forward pass over both halves: a small network costs by the call, not by the sample.
    both = jax.tree.map(lambda e, p: jnp.concatenate([e, p]), expert, policy)
    logit = logit_expert_high(params, both, shaping_discount(hparams, config), config).sum(axis=-1)
    expert_logit, policy_logit = jnp.split(logit, [expert.obs.shape[0]])
    cross_entropy = 0.5 * (jax.nn.softplus(-expert_logit).mean() + jax.nn.softplus(policy_logit).mean())
    metrics = {
        "discriminator_loss": cross_entropy,
        "accuracy_expert": (expert_logit > 0).mean(),
        "accuracy_policy": (policy_logit < 0).mean(),
        "saturated": (jnp.abs(logit) > SATURATED_LOGIT).mean(),
    }
    total = cross_entropy
    if "gradient" in config.penalties:
        total += hparams.gradient_penalty * gradient_penalty(params, expert, policy, config)
    if "action_variance" in config.penalties:
        total += hparams.action_variance * action_variance(params, both, config)
    if "input_sparsity" in config.penalties:
        total += hparams.input_sparsity * input_sparsity(params, both, config)
    return total, metrics


def fit(
    fitted: train_state.TrainState, expert: Samples, policy: Samples, hparams: HParams, config: Config
) -> tuple[train_state.TrainState, Metrics]:
    """Updates D on minibatches `[updates, batch, length, ...]` of the expert and of the policy's history."""
    fitted, metrics = train_state.fit(
        fitted, lambda params, pair: loss(params, *pair, hparams, config), (expert, policy), hparams.discriminator_lr
    )
    metrics["accuracy"] = 0.5 * (metrics["accuracy_expert"] + metrics["accuracy_policy"])
    metrics["log_prob_expert"] = expert.log_prob.mean()
    for name, samples in (("reward_expert", expert), ("reward_policy", policy)):
        metrics[name] = reward(fitted.params, samples.obs[-1], samples.action[-1], config).mean()
    return fitted, metrics
