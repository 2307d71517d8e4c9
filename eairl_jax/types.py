"""The records that every part of the library hands to the next."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import jax
from flax import struct

from eairl_jax.gaussian import Gaussian

PyTree = Any
Key = jax.Array


class Env(Protocol):
    """What the library asks of an environment: brax's `Env` interface, so any `brax.envs.Env` is one.

    `step` returns a state with fields `obs [obs]`, `reward []` and `done []`. Three attributes are read when
    present: `action_limit` (default 1: brax's convention), `obs_mean` and `obs_std` (`[obs]`, the centre and
    scale of the whole state space; see `normalize.initial`).
    """

    @property
    def observation_size(self) -> Any: ...

    @property
    def action_size(self) -> int: ...

    def reset(self, rng: jax.Array) -> Any: ...

    def step(self, state: Any, action: jax.Array) -> Any: ...


class Transition(NamedTuple):
    """Steps of the policy, `[T, N, ...]`: T steps of N parallel environments.

    Attributes:
      obs: `[T, N, obs]` s, as the environment gave it.
      action: `[T, N, act]` a, the Gaussian sample *before* any clipping, so that `log_prob` is its density; with
        `Config.actions` "clipped" what was executed, and its log-probability.
      log_prob: `[T, N]` log pi(a|s) under the policy that acted.
      next_obs: `[T, N, obs]` s', before any auto-reset.
      reward: `[T, N]` the environment's true reward, or the learned one once it was put in its place.
      terminated: `[T, N]` 1 where the task itself ended the episode: no value beyond.
      truncated: `[T, N]` 1 where the time limit ended it: the value of s' still counts.
    """

    obs: jax.Array
    action: jax.Array
    log_prob: jax.Array
    next_obs: jax.Array
    reward: jax.Array
    terminated: jax.Array
    truncated: jax.Array


class Demonstrations(NamedTuple):
    """Whole expert episodes of one length, `[E, T, ...]`; see `demonstrations.load`.

    Attributes:
      obs, action, next_obs, terminated: as in `Transition`.
      reward: `[E, T]` true reward; no algorithm reads it.
    """

    obs: jax.Array
    action: jax.Array
    next_obs: jax.Array
    reward: jax.Array
    terminated: jax.Array


@struct.dataclass
class HParams:
    """Every float of training. Any leaf may be vmapped over, so a sweep is one compiled program.

    Attributes:
      gamma: discount.
      gae_lambda: generalised advantage estimation's lambda.
      policy_lr: Adam's rate for policy and value at the first iteration.
      policy_lr_final_fraction: fraction of `policy_lr` left at `Config.iterations` (linear in between).
      clip_eps: PPO's clipping of the probability ratio.
      max_grad_norm: PPO's bound on the gradient's norm.
      kl_limit: TRPO's bound on KL(old policy || new policy) of an iteration, nats; above 0.
      cg_damping: TRPO's multiple of the identity added to the Fisher matrix.
      entropy_weight: weight of the policy's entropy (Appendix D.2: 0.1 to learn a reward, 0.001 to imitate).
      entropy_final_fraction: fraction of `entropy_weight` left at `Config.iterations`.
      std_final_fraction: fraction of the policy's std left at `Config.iterations` (geometric in between): explore first, then
        settle.
      temperature: of maximum-entropy reinforcement learning on a reward that is given: `-temperature log pi(a|s)` is
        added to it. AIRL's and EAIRL's policies have it by themselves, at 1 (f - log pi): their rewards are for it.
      temperature_final_fraction: fraction of `temperature` left at `Config.iterations` (linear in between).
      lambda_i: lambda_I, the weight of l_I in the policy's objective (Eq. 11).
      beta: temperature of the empowerment (Eq. 6, 7).
      gradient_penalty: weight of `discriminator.gradient_penalty`; counts if `Config.penalties` names it.
      action_variance: weight of `discriminator.action_variance`; counts if `Config.penalties` names it.
      input_sparsity: weight of `discriminator.input_sparsity`; counts if `Config.penalties` names it.
      discriminator_lr, inverse_lr, phi_lr: Adam's rates for D (the reward), q(a|s,s') and Phi(s).
    """

    gamma: float | jax.Array = 0.99
    gae_lambda: float | jax.Array = 0.95
    policy_lr: float | jax.Array = 1e-3
    policy_lr_final_fraction: float | jax.Array = 1.0
    clip_eps: float | jax.Array = 0.2
    max_grad_norm: float | jax.Array = 0.5
    kl_limit: float | jax.Array = 0.01
    cg_damping: float | jax.Array = 0.1
    entropy_weight: float | jax.Array = 0.001
    entropy_final_fraction: float | jax.Array = 1.0
    std_final_fraction: float | jax.Array = 1.0
    temperature: float | jax.Array = 0.0
    temperature_final_fraction: float | jax.Array = 1.0
    lambda_i: float | jax.Array = 0.001
    beta: float | jax.Array = 1.0
    gradient_penalty: float | jax.Array = 0.0
    action_variance: float | jax.Array = 0.0
    input_sparsity: float | jax.Array = 0.0
    discriminator_lr: float | jax.Array = 1e-3
    inverse_lr: float | jax.Array = 1e-3
    phi_lr: float | jax.Array = 1e-3

    def at(self, progress: jax.Array) -> HParams:
        """The settings in force at `progress` in [0, 1] of the run: rates that are annealed, annealed."""
        progress = jax.numpy.clip(progress, 0.0, 1.0)

        def annealed(value, end):
            return value * (1.0 - progress * (1.0 - end))

        return self.replace(  # pyright: ignore
            policy_lr=annealed(self.policy_lr, self.policy_lr_final_fraction),
            entropy_weight=annealed(self.entropy_weight, self.entropy_final_fraction),
            std_final_fraction=self.std_final_fraction**progress,
            temperature=annealed(self.temperature, self.temperature_final_fraction),
        )


Metrics = dict[str, jax.Array]


class Algorithm(NamedTuple):
    """Anything that trains: RL on a reward, or any adversarial method.

    Attributes:
      init: `(key, hparams) -> state`.
      step: `(state, hparams, data) -> (state, metrics)`, one pure iteration. `data` is what it learns from:
        `Demonstrations`, or the parameters of a reward.
      act: `(state, obs [..., obs], key) -> action [..., act]`, a sample of the policy; its mean if key is None.
    """

    init: Callable[[Key, HParams], PyTree]
    step: Callable[[PyTree, HParams, PyTree], tuple[PyTree, Metrics]]
    act: Callable[[PyTree, jax.Array, Key | None], jax.Array]


# (pi_theta(.|s), log pi_theta(a|s) [batch], what the penalty needs of each transition) -> cost [batch]
Penalty = Callable[[Gaussian, jax.Array, PyTree], jax.Array]


class PolicyOptimizer(NamedTuple):
    """A policy-gradient method: how a policy is improved on the rewards of a batch.

    Attributes:
      init: `(key) -> policy`, the policy's whole state.
      update: `(key, policy, transitions, penalty, penalty_data, hparams) -> (policy, metrics)`. The penalty is a
        cost on pi, added to the objective: EAIRL's l_I reaches the policy through it. `penalty_data` is a pytree of
        `[T, N, ...]`, cut into minibatches with the transitions.
      distribution: `(policy, obs [..., obs]) -> Gaussian` over actions.
    """

    init: Callable[[Key], PyTree]
    update: Callable[[Key, PyTree, Transition, Penalty, PyTree, HParams], tuple[PyTree, Metrics]]
    distribution: Callable[[PyTree, jax.Array], Gaussian]


def no_penalty(_pi: Gaussian, log_prob: jax.Array, _data: PyTree) -> jax.Array:
    """The penalty of plain reinforcement learning: none."""
    return jax.numpy.zeros_like(log_prob)
