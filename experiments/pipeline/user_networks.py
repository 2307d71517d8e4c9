"""Networks of a user's own, by the name of their code: `my_nets.py:ResNet`, `package.module:ResNet`."""

from __future__ import annotations

from eairl_jax import NETWORKS
from eairl_jax.experiments.pipeline import user_code
from eairl_jax.named_networks import MLP


def register(name: str | None) -> None:
    """Makes a network known under the name that the command line gives it, if it is one of a user's code.

    Raises:
      InputError: if there is no such network.
    """
    if name is None or name == MLP or name in NETWORKS:
        return
    refusal = f"net={name} names no network: expected mlp, FILE.py:NAME or MODULE:NAME, e.g. my_nets.py:ResNet"
    NETWORKS[name] = user_code.find(name, callable, "class or function", f"net={name}", refusal)
