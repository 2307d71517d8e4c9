"""The records and interfaces that connect the parts of the library."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import jax

from eairl_jax.gaussian import Gaussian
from eairl_jax.hparams import HParams

PyTree = Any
Key = jax.Array
Metrics = dict[str, jax.Array]


class Env(Protocol):
    """An environment as the library uses it: brax's `Env` interface, so every `brax.envs.Env` fits.

    `step` returns a state with the fields `obs [obs]`, `reward []` and `done []`. Three attributes are optional:
    `action_limit` (the default is 1, brax's convention), and `obs_mean` and `obs_std` (`[obs]`, the centre and the
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
      obs: `[T, N, obs]` s, in the environment's units until `agent.normalize_obs` normalises it.
      action: `[T, N, act]` a. With `Config.actions` "sampled": the Gaussian's sample before any clipping. With
        "clipped": the executed action. `log_prob` belongs to this action.
      log_prob: `[T, N]` log pi(a|s) under the policy that acted.
      next_obs: `[T, N, obs]` s', before any auto-reset.
      reward: `[T, N]` the environment's true reward, or the learned reward that has replaced it.
      terminated: `[T, N]` 1 where the task ended the episode: s' has no value.
      truncated: `[T, N]` 1 where the time limit ended the episode: s' keeps its value.
    """

    obs: jax.Array
    action: jax.Array
    log_prob: jax.Array
    next_obs: jax.Array
    reward: jax.Array
    terminated: jax.Array
    truncated: jax.Array


class Demonstrations(NamedTuple):
    """E expert episodes of any lengths: S steps, all episodes one after another. `demonstrations.load` reads them.

    Attributes:
      obs: `[S, obs]` s.
      action: `[S, act]` a, before any clipping; None if the demonstrations hold no actions.
      next_obs: `[S, obs]` s'.
      reward: `[S]` the true reward, None if it is unknown. No algorithm reads it.
      terminated: `[S]` 1 where the task ended the episode. An episode that just stops met its time limit.
      lengths: `[E]` steps of each episode; their sum is S.
    """

    obs: Any
    action: Any
    next_obs: Any
    reward: Any
    terminated: Any
    lengths: Any


class Algorithm(NamedTuple):
    """A training algorithm: RL on a reward, behaviour cloning, or an adversarial method. All functions are pure.

    Attributes:
      init: `(key, hparams) -> state`.
      step: `(state, hparams, data) -> (state, metrics)`, one iteration. `data` is what the algorithm learns from:
        `Demonstrations`, or the parameters of a reward.
      act: `(state, obs [..., obs], key) -> action [..., act]`, a sample of the policy, or its mean if key is None.
      shards: how many devices compute one lane together (`eairl_jax.shards`). With more than one, only `Lanes` can run
        `step`.
    """

    init: Callable[[Key, HParams], PyTree]
    step: Callable[[PyTree, HParams, PyTree], tuple[PyTree, Metrics]]
    act: Callable[[PyTree, jax.Array, Key | None], jax.Array]
    shards: int = 1


# (pi(.|s), log pi(a|s) [batch], the penalty's data for each transition) -> cost [batch]
Penalty = Callable[[Gaussian, jax.Array, PyTree], jax.Array]


class PolicyOptimizer(NamedTuple):
    """A policy-gradient method: it improves a policy on the rewards of a batch.

    Attributes:
      init: `(key) -> policy`, the whole state of a fresh policy.
      update: `(key, policy, transitions, penalty, penalty_data, hparams) -> (policy, metrics)`. The mean of `penalty`
        is added to the policy's loss: EAIRL's l_I reaches the policy by this way. `penalty_data` is a pytree of
        `[T, N, ...]`; it is cut into minibatches together with the transitions.
      distribution: `(policy, obs [..., obs]) -> Gaussian` over actions; observations are normalised.
    """

    init: Callable[[Key], PyTree]
    update: Callable[[Key, PyTree, Transition, Penalty, PyTree, HParams], tuple[PyTree, Metrics]]
    distribution: Callable[[PyTree, jax.Array], Gaussian]


def no_penalty(_pi: Gaussian, log_prob: jax.Array, _data: PyTree) -> jax.Array:
    """The penalty of plain reinforcement learning: a cost of 0 for every transition."""
    return jax.numpy.zeros_like(log_prob)
