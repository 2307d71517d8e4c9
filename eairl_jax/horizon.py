"""Episodes that end early, and how learning treats them (`Config.horizon`).

Where a task can end an episode, the sign of a learned reward says how long a policy wants to live, whatever the
demonstrations show. GAIL's reward is positive, so every step of life pays. The reward of AIRL and EAIRL is negative
while the discriminator wins, so a policy learns to end its episodes at once. Two treatments avoid this:

- "fixed": every episode lasts until the time limit. The simulation goes on after the end, and what happens then is
  learned like everything before.
- "absorbing": after the end, policy and expert are in one absorbing state (Kostrikov et al. 2019). The reward learns
  what this state is worth. Observations have one more entry: 1 in the absorbing state, 0 elsewhere. All absorbing steps
  are alike, so the data of learning holds one for each end, and it counts as all of them: `rest_paid` pays the policy
  for all, and the discriminator sees it as often (`stay`). Where whole trajectories are discriminated or planned, the
  absorbing steps fill the time limit (`is_whole`).

"variable" leaves the episodes as they are. Reinforcement learning on a task's true reward needs it: the sign of that
reward belongs to the task. The true return counts the true rewards up to the end of the episode, in all three.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from flax import struct

from eairl_jax import normalize
from eairl_jax.config import Config
from eairl_jax.errors import InputError
from eairl_jax.types import Demonstrations, Env, HParams, Key, PyTree, Transition

Steps = TypeVar("Steps", Transition, Demonstrations)

ADVICE = (
    "choose --horizon absorbing (after its end an episode stays in one absorbing state until the time limit) or "
    "--horizon variable (episodes as they are; the sign of the reward then decides how long a policy wants to live); "
    'from Python Config(horizon="absorbing")'
)


def can_end(env: Env) -> bool:
    """Whether the task itself can end an episode. An environment that never does says so: `ends = False`."""
    return bool(getattr(env, "ends", True))


def of_learned_reward(env: Env) -> str:
    """The horizon that "default" stands for where a reward is learned."""
    return "absorbing" if can_end(env) else "fixed"


def resolved(env: Env, config: Config, default: str) -> Config:
    """The configuration with a time limit and a horizon.

    Args:
      default: the horizon that "default" stands for.

    Raises:
      InputError: if neither the configuration nor the environment has a time limit.
    """
    length = config.episode_length or getattr(env, "episode_length", 0)
    if not length:
        raise InputError(
            "the environment has no episode_length: give the time limit in steps, for example "
            "Config(episode_length=1000)"
        )
    horizon = default if config.horizon == "default" else config.horizon
    return dataclasses.replace(config, episode_length=int(length), horizon=horizon)


def learning_config(env: Env, config: Config) -> Config:
    """`resolved` where a reward is learned; with history "all" where an absorbing state follows an end.

    A history that the configuration names stays. A policy that has learned not to end its episodes leaves the absorbing
    state to the expert's ends alone. The discriminator would then pay for it without bound, and the policy would end
    its episodes at once. A sample of all iterations always holds ends. Kostrikov et al. (2019) draw from the whole
    replay too.

    Raises:
      InputError: if neither the configuration nor the environment has a time limit.
    """
    config = resolved(env, config, of_learned_reward(env))
    if config.history == "default" and config.horizon == "absorbing" and can_end(env):
        return dataclasses.replace(config, history="all")
    return config


class HorizonWarning(UserWarning):
    """A learned reward decides how long a policy wants to live."""


def warn_if_variable(env: Env, config: Config) -> None:
    """Warns of an adversarial method on a task whose episodes end early and are left as they are."""
    if config.horizon == "variable" and can_end(env):
        warnings.warn(
            'horizon="variable": where episodes end early, the sign of the learned reward decides how long a policy '
            'wants to live; compare with Config(horizon="absorbing")',
            HorizonWarning,
            stacklevel=4,
        )


@struct.dataclass
class HorizonState:
    """The state of an environment whose episodes go on after their end.

    Attributes:
      inner: the state of the task's own environment.
      obs: `[obs]`, or `[obs + 1]` with the absorbing state.
      reward: `[]` the true reward; 0 after the end of the episode.
      done: `[]` 1 after the only step in the absorbing state, if it stands for all; else 0.
      ended: `[]` 1 once the task has ended the episode.
    """

    inner: PyTree
    obs: jax.Array
    reward: jax.Array
    done: jax.Array
    ended: jax.Array


class FixedHorizon:
    """An environment that ends no episode where the task ends it. Everything else is as in the task's own environment.

    Args:
      env: the task's own environment.
      absorbing: whether an episode is in the absorbing state after its end. If not, its simulation goes on.
      whole: whether every episode lasts until the time limit. If not, one step in the absorbing state stands for all.
    """

    ends = False

    def __init__(self, env: Env, absorbing: bool, whole: bool = True):
        self._env, self._absorbing, self._whole = env, absorbing, whole
        self.observation_size = normalize.flat_size(env) + absorbing
        self.action_size = env.action_size

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        value = getattr(self._env, name)
        added = {"obs_mean": 0.0, "obs_std": 1.0}
        return (*value, added[name]) if self._absorbing and name in added else value

    @property
    def at_rest(self) -> Callable[[jax.Array], HorizonState]:
        """The task's own `at_rest` (`exact_empowerment`), if it has one."""
        inner = self._env.at_rest
        return lambda obs: self._state(inner(obs), *jnp.zeros(3))

    def reset(self, rng: Key) -> HorizonState:
        return self._state(self._env.reset(rng), *jnp.zeros(3))

    def step(self, state: HorizonState, action: jax.Array) -> HorizonState:
        inner = self._env.step(state.inner, action)
        reward = jnp.where(state.ended > 0, 0.0, inner.reward)
        ended = jnp.where(state.ended > 0, 1.0, inner.done.astype(jnp.float32))
        return self._state(inner, reward, jnp.zeros(()) if self._whole else state.ended, ended)

    def _state(self, inner: Any, reward: jax.Array, done: jax.Array, ended: jax.Array) -> HorizonState:
        obs = absorb(inner.obs, ended) if self._absorbing else inner.obs
        return HorizonState(inner, obs, reward, done, ended)


def learning_env(env: Env, config: Config, whole: bool = False) -> Env:
    """The environment in which a policy learns, as `config.horizon` says; `env` itself if its episodes never end.

    Args:
      whole: whether an episode must last until the time limit, whatever `config` says.
    """
    if config.horizon == "absorbing":
        return FixedHorizon(env, absorbing=True, whole=whole or is_whole(config))
    return FixedHorizon(env, absorbing=False) if config.horizon == "fixed" and can_end(env) else env


def is_whole(config: Config) -> bool:
    """Whether learning sees all absorbing steps until the time limit, and not one that stands for all."""
    return config.discriminates == "trajectories"


def absorb(obs: jax.Array, ended: jax.Array) -> jax.Array:
    """Observations `[..., obs + 1]`: their last entry is 0 in the episode; after its end it is 1, and the others 0."""
    flag = ended[..., None].astype(obs.dtype)
    return jnp.concatenate([jnp.where(flag > 0, 0.0, obs), flag], axis=-1)


def living(obs: jax.Array, size: int) -> jax.Array:
    """Observations as the networks read them: those of the task get a last entry of 0, if the networks have one.

    Args:
      size: the length of an observation in the networks.
    """
    return absorb(obs, jnp.zeros(obs.shape[:-1])) if obs.shape[-1] == size - 1 else obs


def alive(obs: jax.Array, config: Config) -> jax.Array | float:
    """1 `[...]` for raw observations `[..., obs]` outside of the absorbing state, 0 in it; 1 if there is none."""
    return 1.0 - obs[..., -1] if config.horizon == "absorbing" else 1.0


def executed(obs: jax.Array, action: jax.Array, config: Config) -> jax.Array:
    """Actions `[..., act]` as the reward reads them: 0 in the absorbing state, where an action has no effect."""
    return action * (1.0 - obs[..., -1:]) if config.horizon == "absorbing" else action


def without_ends(steps: Steps, config: Config) -> Steps:
    """Steps as the reward reads them: after an end the absorbing state follows, so no step is a termination."""
    return steps._replace(terminated=0.0 * steps.terminated) if config.horizon == "absorbing" else steps


def stay(hparams: HParams, config: Config) -> jax.Array | int:
    """How many absorbing steps `[]` the discriminator sees for each end: `1 + gamma + gamma^2 + ... = 1 / (1 - gamma)`.

    This is the share of the absorbing state in the discounted occupancy of states. It is rounded, and at most the time
    limit.
    """
    if config.horizon != "absorbing" or is_whole(config):
        return 1
    return jnp.round(1.0 / jnp.maximum(1.0 - hparams.gamma, 1.0 / config.episode_length)).astype(jnp.int32)


def rest_paid(reward: jax.Array, obs: jax.Array, hparams: HParams, config: Config) -> jax.Array:
    """Rewards `[...]`; that of an absorbing step r becomes `r + gamma r + gamma^2 r + ... = r / (1 - gamma)`.

    A policy is thus paid for all absorbing steps in the one that its data holds. This is also the value that an endless
    stay has where the time limit truncates an episode. With gamma = 1 the stay is worth `config.episode_length` steps.

    Args:
      obs: raw observations `[..., obs]`.
    """
    if config.horizon != "absorbing" or is_whole(config):
        return reward
    rest = jnp.where(hparams.gamma < 1.0, 1.0 / jnp.maximum(1.0 - hparams.gamma, 1e-12), config.episode_length)
    return reward * jnp.where(alive(obs, config) > 0, 1.0, rest)


def update_stats(stats: normalize.ObsStats, obs: jax.Array, config: Config) -> normalize.ObsStats:
    """Running statistics of observations `[..., obs]`, without those in the absorbing state."""
    if config.horizon != "absorbing":
        return normalize.update(stats, obs)
    updated = normalize.update(stats, obs, weight=alive(obs, config))
    return updated.replace(mean=updated.mean.at[-1].set(0.0), var=updated.var.at[-1].set(1.0))


class _Place(NamedTuple):
    """Where a step of learning lies in the demonstrations, `[...]` each."""

    row: jax.Array
    absorbed: jax.Array
    next_absorbed: jax.Array


def step_count(demos: Demonstrations, config: Config, stay: jax.Array | int = 1) -> jax.Array | int:
    """Steps of the demonstrations as the expert of learning takes them; with "absorbing" those after an end count."""
    return demos.obs.shape[0] if config.horizon != "absorbing" else learned_lengths(demos, config, stay).sum()


def take_steps(demos: Demonstrations, index: jax.Array, config: Config, stay: jax.Array | int = 1) -> Demonstrations:
    """The steps `[*index.shape, ...]` of the expert that an index names; `lengths` is dropped.

    Args:
      index: positions from 0 to `step_count`, of any shape, all episodes one after another.
    """
    steps = demos._replace(lengths=None)
    if config.horizon != "absorbing":
        return jax.tree.map(lambda x: jnp.asarray(x)[index], steps)
    place = _place(demos, index, config, stay)
    taken = jax.tree.map(lambda x: jnp.asarray(x)[place.row], steps)
    obs = absorb(taken.obs, place.absorbed)
    return taken._replace(
        obs=obs,
        action=None if taken.action is None else executed(obs, taken.action, config),
        next_obs=absorb(taken.next_obs, place.next_absorbed),
        terminated=jnp.zeros(index.shape),
    )


def learned_lengths(demos: Demonstrations, config: Config, stay: jax.Array | int = 1) -> jax.Array:
    """Steps of each episode `[E]` as learning takes them: with "absorbing" those that the task ended go on.

    They go on as those of the policy do: by `stay` steps, or until the time limit (`is_whole`). An episode that ended
    at the time limit does not go on.
    """
    lengths = jnp.asarray(demos.lengths)
    if config.horizon != "absorbing":
        return lengths
    has_ended = jnp.asarray(demos.terminated)[jnp.cumsum(lengths) - 1] > 0
    left = jnp.maximum(config.episode_length - lengths, 0)
    return lengths + has_ended * (left if is_whole(config) else (left > 0) * stay)


def _place(demos: Demonstrations, index: jax.Array, config: Config, stay: jax.Array | int) -> _Place:
    lengths, learned = jnp.asarray(demos.lengths), learned_lengths(demos, config, stay)
    ends = jnp.cumsum(learned)
    episode = jnp.searchsorted(ends, index, side="right")
    t, length = index - (ends - learned)[episode], lengths[episode]
    row = (jnp.cumsum(lengths) - lengths)[episode] + jnp.minimum(t, length - 1)
    has_ended = jnp.asarray(demos.terminated)[(jnp.cumsum(lengths) - 1)[episode]] > 0
    return _Place(row, t >= length, has_ended & (t >= length - 1))


def extended(steps: dict[str, jax.Array], config: Config) -> dict[str, jax.Array]:
    """Whole episodes `[E, T, ...]` as the reward of `config` sees them; the steps after an end are absorbing ones.

    Args:
      steps: as `evaluate` and `demonstrations.to_steps` return them.
    """
    if config.horizon != "absorbing":
        return steps
    # A row after an end that the task decided. Rows after the data of a truncated episode stay invalid.
    has_ended = jnp.cumsum(steps["terminated"], axis=1) - steps["terminated"] > 0
    obs = absorb(jnp.asarray(steps["obs"]), has_ended)
    changed = {
        "obs": obs,
        "next_obs": absorb(jnp.asarray(steps["next_obs"]), jnp.cumsum(steps["terminated"], axis=1) > 0),
        "action": executed(obs, jnp.asarray(steps["action"]), config),
        "valid": jnp.maximum(steps["valid"], has_ended),
    }
    return steps | changed


def check_demonstrations(env: Env, demos: Demonstrations, config: Config, where: str) -> None:
    """Checks that demonstrations fit the task, the horizon and the time limit.

    In a task that never ends an episode, demonstrations may stop before the time limit: their steps count alike.

    Args:
      config: has a time limit and a horizon (`resolved`).
      where: what to call the demonstrations in an error message.

    Raises:
      InputError: if an episode is longer than the time limit, if episodes end early and the horizon is "fixed", or if
        they end in a task that never ends an episode.
    """
    lengths, limit = demos.lengths, config.episode_length
    longest = max(limit, getattr(env, "episode_length", 0))  # a user may learn from shorter episodes
    if lengths.max() > longest:
        raise InputError(
            f"{where} holds an episode of {lengths.max()} steps, and the time limit is {longest} steps: give the time "
            "limit of the demonstrated task, or other demonstrations"
        )
    if not can_end(env):
        if demos.terminated.any():
            raise InputError(
                f"{where}: the task ended {int(demos.terminated.sum())} of {len(lengths)} episodes, but this task "
                "never ends an episode: give demonstrations of the same task, or mark the ends as a time limit"
            )
        return
    if config.horizon == "fixed" and ends_early(demos, limit):
        raise InputError(
            f"{where}: {early_ends(demos, limit)}, but horizon fixed needs whole episodes of {limit} steps: {ADVICE}"
        )


def ends_early(demos: Demonstrations, limit: int) -> bool:
    """Whether an episode of demonstrations ends before the time limit."""
    return bool((demos.lengths < limit).any() or demos.terminated.any())


def early_ends(demos: Demonstrations, limit: int) -> str:
    """How many episodes end early, for a message."""
    count = int((demos.lengths < limit).sum())
    shortest, longest = demos.lengths.min(), demos.lengths.max()
    return f"{count} of {len(demos.lengths)} episodes end before the time limit ({shortest} to {longest} steps)"
