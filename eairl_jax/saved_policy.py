"""A policy on disk: save it, load it, and act by it. It holds no optimiser and no value function."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from flax.traverse_util import unflatten_dict

from eairl_jax import arguments, artefacts, horizon, normalize, numpy_nets, storage
from eairl_jax.actor_critic import ActorCritic
from eairl_jax.config import Config
from eairl_jax.errors import InputError
from eairl_jax.saved_reward import Compiled, vectors
from eairl_jax.schema import shown
from eairl_jax.types import Key, PyTree


@struct.dataclass
class PolicyParams:
    """What a policy needs to act.

    Attributes:
      actor: parameters of the network.
      log_std_offset: `[]` is added to the log of its std.
      obs_stats: the normaliser of its observations.
    """

    actor: PyTree
    log_std_offset: jax.Array
    obs_stats: normalize.ObsStats


def policy_params(state: PyTree) -> PolicyParams:
    """The policy of the state of any algorithm. If the state has a lane axis, the result has it."""
    policy = state.agent.policy
    return PolicyParams(policy.nets.params["actor"], policy.log_std_offset, state.agent.obs_stats)


class LearnedPolicy:
    """A policy pi(a|s): one for each seed of a run.

    The policy can be pickled. It compiles itself at its first call for each shape.

    Attributes:
      description: task, sizes, method, `action_limit`, the seed and the iteration of each policy, settings.
      config: the static settings of the run.
      params: `PolicyParams`, every leaf `[seeds, ...]`.
      act: pure `(PolicyParams of one seed, obs [..., obs], noise [..., act] or None) -> action [..., act]`.

    Raises:
      InputError: if an argument has another type. `save_policy` checks what the arguments hold.
    """

    def __init__(self, description: dict, config: Config, params: PolicyParams):
        given = (("description", description, dict), ("config", config, Config), ("params", params, PolicyParams))
        for name, value, kind in given:
            if not isinstance(value, kind):
                raise InputError(f"{name} is {shown(value)}: expected a {kind.__name__}")
        self.description, self.config, self.params = description, config, params
        limit = float(description.get("action_limit", 1.0))
        networks = ActorCritic.build(description["action_size"], config, limit)

        def act(params: PolicyParams, obs: jax.Array, noise: jax.Array | None = None) -> jax.Array:
            obs = horizon.living(obs, params.obs_stats.mean.shape[-1])
            obs = normalize.normalize(params.obs_stats, obs)
            pi = networks.pi(params.actor, params.log_std_offset, obs)
            return jnp.clip(pi.mean if noise is None else pi.sample(noise), -limit, limit)

        def act_or_sample(params: PolicyParams, obs: jax.Array, key: Key | None = None) -> jax.Array:
            shape = (*obs.shape[:-1], description["action_size"])
            return act(params, obs, None if key is None else jax.random.normal(key, shape))

        self.act, self._compiled = act, Compiled(params, act_or_sample)

    def __call__(self, obs: jax.Array, key: Key | None = None, seed: int = 0) -> jax.Array:
        """Actions `[..., act]` for raw observations `[..., obs]`, within the task's bounds.

        Args:
          key: of a sample of the policy; None for its mean action.
          seed: the position of the seed in the run, from 0; not the seed itself.

        Raises:
          InputError: if the length of the observations is not the policy's, or if the run had fewer seeds.
        """
        obs = vectors("obs", obs)
        artefacts.refuse_other_sizes(
            self.description, "policy", obs.shape[-1], self.description["action_size"], "this call"
        )
        keys = () if key is None else (arguments.one_key(key),)
        return self._compiled(self._row(seed), obs, *keys)

    def function(self, seed: int = 0) -> Callable[[jax.Array, jax.Array], jax.Array]:
        """The policy of one seed as a pure function, to be traced into a program.

        Its arguments are observations `[..., obs]` and noise `[..., act]`: zeros for the mean action, draws from a
        standard normal distribution for a sample. It checks no shapes.

        Args:
          seed: the position of the seed in the run, from 0.

        Raises:
          InputError: if the run had fewer seeds.
        """
        params = jax.tree.map(lambda leaf: jnp.asarray(leaf)[self._row(seed)], self.params)
        return functools.partial(self.act, params)

    def numpy(self, seed: int = 0) -> numpy_nets.Policy:
        """The policy of one seed, computed by NumPy alone: the fastest way to act one step at a time.

        Args:
          seed: the position of the seed in the run, from 0.

        Raises:
          InputError: if the run had fewer seeds.
        """
        return numpy_nets.Policy(self._contents(), self._row(seed))

    def _row(self, seed: Any) -> int:
        return artefacts.seed_row(seed, jax.tree.leaves(self.params)[0].shape[0], "policy")

    def _contents(self) -> artefacts.Contents:
        return artefacts.Contents(self.description, self.config, storage.named_leaves(self.params))

    def __reduce__(self) -> tuple:
        return LearnedPolicy, (self.description, self.config, jax.tree.map(np.asarray, self.params))


def save_policy(directory: Path | str, policy: LearnedPolicy) -> None:
    """Writes `policy.npz` and `policy.json` into a folder, which is created.

    Raises:
      InputError: if `load_policy` would refuse the policy.
    """
    if not isinstance(policy, LearnedPolicy):
        raise InputError(
            f"policy is {shown(policy)}: expected a LearnedPolicy, made of a description, Config and params"
        )
    artefacts.write(Path(directory), artefacts.POLICY, policy._contents())


def load_policy(directory: Path | str) -> LearnedPolicy:
    """Reads a policy. The files may come from a stranger: nothing in them is executed.

    Args:
      directory: a folder that `save_policy` has written (`policy/` of a run).

    Raises:
      InputError: if the folder does not hold a complete policy, or if the parameters do not fit the settings.
    """
    contents = artefacts.read(directory, artefacts.POLICY)
    tree = unflatten_dict(contents.arrays, sep="/")
    params = PolicyParams(tree["actor"], tree["log_std_offset"], normalize.ObsStats(**tree["obs_stats"]))
    return LearnedPolicy(contents.description, contents.config, params)
