"""The policy optimisers by name."""

from __future__ import annotations

from eairl_jax.config import Config
from eairl_jax.ppo import ppo
from eairl_jax.trpo import trpo
from eairl_jax.types import PolicyOptimizer

OPTIMIZERS = {"ppo": ppo, "trpo": trpo}


def make_optimizer(obs_size: int, action_size: int, config: Config) -> PolicyOptimizer:
    """The one that `config.optimizer` names."""
    return OPTIMIZERS[config.optimizer](obs_size, action_size, config)
