"""Adversarial methods of a user's own, by the name of their code: `my_methods.py:fairl`, `package.module:fairl`."""

from __future__ import annotations

from eairl_jax import METHODS, InputError, envs
from eairl_jax.config import choose
from eairl_jax.envs import names, registry
from eairl_jax.methods import Method, method_names


def register(name: str) -> None:
    """Makes a method known under the name that the command line gives it, if it is one of a user's code.

    Raises:
      InputError: if there is no such method.
    """
    if ":" not in name or name in METHODS:
        choose("method", name, method_names())
        return
    try:
        code = names.parse(name)
        if code.origin not in (names.FILE, names.MODULE) or code.arguments:
            raise InputError(
                f"{name!r} names no method: expected FILE.py:NAME or MODULE:NAME, e.g. my_methods.py:fairl"
            )
        METHODS[name] = registry.user_object(code, lambda found: isinstance(found, Method), "eairl_jax.methods.Method")
    except envs.TaskError as e:
        raise InputError(f"--method {name}: {e}") from None
