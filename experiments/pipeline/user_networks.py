"""Networks of a user's own, by the name of their code: `my_nets.py:ResNet`, `package.module:ResNet`."""

from __future__ import annotations

from eairl_jax import NETWORKS, InputError, envs
from eairl_jax.envs import names, registry
from eairl_jax.named_networks import MLP


def register(name: str | None) -> None:
    """Makes a network known under the name that the command line gives it, if it is one of a user's code.

    Raises:
      InputError: if there is no such network.
    """
    if name is None or name == MLP or name in NETWORKS:
        return
    try:
        code = names.parse(name)
        if code.origin not in (names.FILE, names.MODULE) or code.arguments:
            raise InputError(
                f"net={name} names no network: expected mlp, FILE.py:NAME or MODULE:NAME, e.g. my_nets.py:ResNet"
            )
        NETWORKS[name] = registry.user_object(code, callable, "class or function")
    except envs.TaskError as e:
        raise InputError(f"net={name}: {e}") from None
