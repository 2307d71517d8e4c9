"""The policy optimisers by name."""

from __future__ import annotations

from eairl_jax.config import Config
from eairl_jax.normalize import flat_size
from eairl_jax.ppo import ppo
from eairl_jax.rollout import action_limit
from eairl_jax.shards import ONE, Shards
from eairl_jax.trpo import trpo
from eairl_jax.types import Env, PolicyOptimizer

OPTIMIZERS = {"ppo": ppo, "trpo": trpo}


def make_optimizer(env: Env, config: Config, shards: Shards = ONE) -> PolicyOptimizer:
    """The optimiser that `config.optimizer` names, for policies that act in `env`.

    Args:
      shards: the devices, each of which takes the gradient of a part of every minibatch.

    Raises:
      InputError: if the environment's observations are not flat vectors.
    """
    return OPTIMIZERS[config.optimizer](flat_size(env), env.action_size, config, action_limit(env), shards)
