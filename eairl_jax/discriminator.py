"""The discriminator: a reward, its shaping, and the logit that distinguishes the expert from the policy."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from eairl_jax import named_networks, nets, train_state
from eairl_jax.config import OWN_PART, Config
from eairl_jax.methods import EXACT_PHI, LEARNED_H, LEARNED_PHI, METHODS
from eairl_jax.types import HParams, Key, Metrics, PyTree

# softplus(-3) = 0.05: actions cost almost nothing until the demonstrations show that they do.
RAW_COST_INIT = -3.0

# A logit beyond this value means D < 1 % or D > 99 %: almost no gradient is left.
SATURATED_LOGIT = 4.595

# Number of actions that `action_variance` compares at each state: the action of the sample, and others of the batch.
COMPARED_ACTIONS = 4

# Steps of this size fill [0, 1] evenly (the golden ratio's sequence).
GOLDEN_RATIO_STEP = 0.6180339887


class Samples(NamedTuple):
    """The data of a transition that its logit depends on, `[...]` each.

    In a minibatch of the discriminator the leading axes are `[batch, length]`. The discriminator classifies `length`
    consecutive steps together; `length` is 1 unless the method discriminates trajectories.

    Attributes:
      obs: `[..., obs]` s, as the reward receives it.
      action: `[..., act]` a.
      next_obs: `[..., obs]` s', as the reward receives it.
      terminated: 1 where the task ended the episode.
      log_prob: log pi(a|s) under the *current* policy, also for the expert's actions.
      phi_shaping: `gamma Phi'(s') - Phi(s)`, a constant for the discriminator; 0 without empowerment.
    """

    obs: jax.Array
    action: jax.Array
    next_obs: jax.Array
    terminated: jax.Array
    log_prob: jax.Array
    phi_shaping: jax.Array


def shaping(potential: jax.Array, next_potential: jax.Array, terminated: jax.Array, gamma) -> jax.Array:
    """`F = gamma (1 - terminated) potential(s') - potential(s)`, `[...]` (Ng et al. 1999)."""
    return gamma * (1.0 - terminated) * next_potential - potential


def check_network(obs_size: int, action_size: int, config: Config) -> None:
    """Makes the network known that `config.net` names (`named_networks.register`).

    Raises:
      InputError: if there is no such network, or if it cannot compute a reward or a potential.
    """
    named_networks.register(config.net)
    net = nets.scalar(config)
    if isinstance(net, nets.NamedScalar):
        for size in (obs_size, obs_size + action_size):
            net.shapes(size)


def init(key: Key, obs_size: int, action_size: int, config: Config) -> PyTree:
    """Fresh parameters.

    "g" of the reward, "k" of a separable reward's action part, "h" of a learned potential, "d" of a classifier beside
    the reward (`Method.reward_loss`), "m" of what each source has for itself (`own_part`).
    """
    obs, action, net = jnp.zeros((1, obs_size)), jnp.zeros((1, action_size)), nets.scalar(config)
    params = init_reward(key, obs_size - config.context_size, action_size, config)
    if config.shaping in LEARNED_H:
        params["h"] = net.init(_keys(key)[2], obs)
    if METHODS[config.method].reward_loss:
        params["d"] = net.init(jax.random.fold_in(key, 1), *_classified(obs, action, config))
    if OWN_PART in config.penalties:
        params["m"] = net.init(jax.random.fold_in(key, 2), *_classified(obs, action, config))
    return params


def init_reward(key: Key, obs_size: int, action_size: int, config: Config) -> PyTree:
    """Fresh parameters of a reward: "g", and "k" of a separable reward's action part.

    Args:
      obs_size: of the observation that the reward sees, without `Config.context_size`.
    """
    g_key, k_key, _ = _keys(key)
    obs, action, net = jnp.zeros((1, obs_size)), jnp.zeros((1, action_size)), nets.scalar(config)
    params = {"g": net.init(g_key, obs, action) if config.reward_form == "sa" else net.init(g_key, obs)}
    if config.reward_form == "separable":
        quadratic = config.action_part == "quadratic"
        params["k"] = {"raw_cost": jnp.full((), RAW_COST_INIT)} if quadratic else net.init(k_key, action)
    return params


def _keys(key: Key) -> Key:
    """The keys `[3]` of g, k and h."""
    return jax.random.split(key, 3)


def _seen(obs: jax.Array, config: Config) -> jax.Array:
    """Observations `[..., obs]` without the entries that say which of several sources they are from."""
    return obs[..., : obs.shape[-1] - config.context_size]


def _classified(obs: jax.Array, action: jax.Array, config: Config) -> tuple[jax.Array, ...]:
    """What a classifier beside the reward sees: what the reward is a function of."""
    return (obs,) if config.reward_form == "s" else (obs, action)


def reward(params: PyTree, obs: jax.Array, action: jax.Array, config: Config) -> jax.Array:
    """The reward that is transferred, `[...]`: g(s,a), g(s), or g(s) + k(a).

    A separable reward can express a cost of actions, and cannot memorise which action the expert takes at which state.
    """
    net, obs = nets.scalar(config), _seen(obs, config)
    if config.reward_form == "sa":
        return nets.apply(net, params["g"], obs, action)
    g = nets.apply(net, params["g"], obs)
    if config.reward_form == "s":
        return g
    if config.action_part == "net":
        return g + nets.apply(net, params["k"], action)
    return g - jax.nn.softplus(params["k"]["raw_cost"]) * jnp.sum(action**2, axis=-1)


def own_part(params: PyTree, obs: jax.Array, action: jax.Array, config: Config) -> jax.Array:
    """The part m of the reward that belongs to the source of a step alone, `[...]` (MSRD, Chen et al. 2020b).

    Demonstrators of one task differ in style. With `f = r + m` the reward r holds what they share, because the mean
    square of m is charged; m knows the source by the last entries of the observation. Only r is kept and transferred.
    """
    return nets.apply(nets.scalar(config), params["m"], *_classified(obs, action, config))


def logit_expert_high(params: PyTree, samples: Samples, discount, config: Config) -> jax.Array:
    """`log D - log(1 - D)` of each transition, `[...]`, with f = reward + shaping (Eq. 9).

    With `Method.reward_loss`, f is the classifier "d". With `own_part`, f has that part too.
    """
    if METHODS[config.method].reward_loss:
        f = nets.apply(nets.scalar(config), params["d"], *_classified(samples.obs, samples.action, config))
    else:
        f = reward(params, samples.obs, samples.action, config)
    if OWN_PART in config.penalties:
        f += own_part(params, samples.obs, samples.action, config)
    if config.shaping in LEARNED_H:
        h, next_h = (nets.apply(nets.scalar(config), params["h"], x) for x in (samples.obs, samples.next_obs))
        f += shaping(h, next_h, samples.terminated, discount)
    if config.shaping in (*LEARNED_PHI, EXACT_PHI):
        f += samples.phi_shaping
    return METHODS[config.method].logit_expert_high(f, samples.log_prob)


def policy_reward(params: PyTree, samples: Samples, hparams: HParams, config: Config) -> jax.Array:
    """The reward `[...]` that the policy is trained on: the method's function of the logit, or of the reward."""
    if METHODS[config.method].reward_loss:
        return METHODS[config.method].policy_reward(reward(params, samples.obs, samples.action, config))
    logit = logit_expert_high(params, samples, shaping_discount(hparams, config), config)
    return METHODS[config.method].policy_reward(logit)


def shaping_discount(hparams: HParams, config: Config):
    """The discount factor of the shaping term: the task's gamma, or 1."""
    return 1.0 if config.shaping_discount == "one" else hparams.gamma


def gradient_penalty(params: PyTree, expert: Samples, policy: Samples, config: Config) -> jax.Array:
    """`E (|grad r| - 1)^2`, `[]`, at inputs between those of expert and policy (Gulrajani et al. 2017).

    The expert's share of each input follows the golden ratio's sequence: the shares cover [0, 1] evenly, and do not
    depend on the order of the minibatch.
    """
    pair = (expert.obs, expert.action), (policy.obs, policy.action)
    flat = jax.tree.map(lambda x: x.reshape(-1, x.shape[-1]), pair)
    share = (jnp.arange(flat[0][0].shape[0]) * GOLDEN_RATIO_STEP % 1.0)[:, None]
    inputs = jax.tree.map(lambda e, p: share * e + (1.0 - share) * p, *flat)
    slope = jax.vmap(jax.grad(lambda x: reward(params, x[0], x[1], config)))(inputs)
    norm = jnp.sqrt(sum(jnp.sum(leaf**2, axis=-1) for leaf in slope) + 1e-12)
    return jnp.mean((norm - 1.0) ** 2)


def action_variance(params: PyTree, samples: Samples, config: Config) -> jax.Array:
    """Variance of r(s, .) over actions of the minibatch, averaged over its states, `[]`.

    Differences between actions that depend on the state are the part of a reward that does not transfer.
    """
    actions = jnp.stack([jnp.roll(samples.action, shift, axis=0) for shift in range(COMPARED_ACTIONS)])
    obs = jnp.broadcast_to(samples.obs, (COMPARED_ACTIONS, *samples.obs.shape))
    return jnp.var(reward(params, obs, actions, config), axis=0).mean()


def input_sparsity(params: PyTree, samples: Samples, config: Config) -> jax.Array:
    """`sum_i sqrt(E (d r / d obs_i)^2)`, `[]`: a group lasso over the entries of the observation.

    A discriminator uses every difference between expert and policy. The penalty removes the entries that the reward
    does not need. It uses the derivatives of the whole function, and not the weights of the first layer, which later
    layers could compensate. Entries count in the units that the reward receives (`Config.reward_obs`).
    """
    obs, action = (x.reshape(-1, x.shape[-1]) for x in (samples.obs, samples.action))
    slope = jax.vmap(jax.grad(lambda obs, action: reward(params, obs, action, config)))(obs, action)
    return jnp.sqrt(jnp.mean(slope**2, axis=0) + 1e-8).sum()  # + 1e-8: the derivative of a root is infinite at 0


def loss(params: PyTree, expert: Samples, policy: Samples, hparams: HParams, config: Config):
    """The method's loss, plus penalties.

    The logit of a trajectory is the sum of the logits of its transitions (Finn et al. 2016), except with
    `Method.reward_loss`.

    Returns:
      `(loss [], metrics)`.
    """
    # One forward pass over both halves: the cost of a small network depends on the number of calls.
    both, method = jax.tree.map(lambda e, p: jnp.concatenate([e, p]), expert, policy), METHODS[config.method]
    logit = logit_expert_high(params, both, shaping_discount(hparams, config), config)
    logit = logit if method.reward_loss else logit.sum(axis=-1)
    expert_logit, policy_logit = jnp.split(logit, [expert.obs.shape[0]])
    total = method.loss(expert_logit, policy_logit)
    metrics = {
        "discriminator_loss": total,
        "accuracy_expert": (expert_logit > 0).mean(),
        "accuracy_policy": (policy_logit < 0).mean(),
        "saturated": (jnp.abs(logit) > SATURATED_LOGIT).mean(),
    }
    if method.reward_loss:
        r = reward(params, both.obs, both.action, config)
        metrics["reward_loss"] = method.reward_loss(r, jax.lax.stop_gradient(logit))
        total += metrics["reward_loss"]
    if "gradient" in config.penalties:
        total += hparams.gradient_penalty * gradient_penalty(params, expert, policy, config)
    if "action_variance" in config.penalties:
        total += hparams.action_variance * action_variance(params, both, config)
    if "input_sparsity" in config.penalties:
        total += hparams.input_sparsity * input_sparsity(params, both, config)
    if OWN_PART in config.penalties:
        metrics["own_part"] = jnp.mean(own_part(params, both.obs, both.action, config) ** 2)
        total += hparams.own_part * metrics["own_part"]
    return total, metrics


def fit(
    state: train_state.TrainState, expert: Samples, policy: Samples, hparams: HParams, config: Config
) -> tuple[train_state.TrainState, Metrics]:
    """Updates D once on each pair of minibatches.

    Args:
      expert: `[updates, batch, length, ...]` samples of the expert.
      policy: `[updates, batch, length, ...]` samples of the policy.
    """
    state, metrics = train_state.fit(
        state,
        lambda params, pair: loss(params, pair[0], pair[1], hparams, config),
        (expert, policy),
        hparams.discriminator_lr,
    )
    metrics["accuracy"] = 0.5 * (metrics["accuracy_expert"] + metrics["accuracy_policy"])
    metrics["log_prob_expert"] = expert.log_prob.mean()
    for name, samples in (("reward_expert", expert), ("reward_policy", policy)):
        metrics[name] = reward(state.params, samples.obs[-1], samples.action[-1], config).mean()
    return state, metrics
