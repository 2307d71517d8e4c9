"""Adversarial methods of a user's own, by the name of their code: `my_methods.py:fairl`, `package.module:fairl`."""

from __future__ import annotations

from eairl_jax import METHODS
from eairl_jax.config import choose
from eairl_jax.experiments.pipeline import user_code
from eairl_jax.methods import Method, method_names


def register(name: str) -> None:
    """Makes a method known under the name that the command line gives it, if it is one of a user's code.

    Raises:
      InputError: if there is no such method.
    """
    if ":" not in name or name in METHODS:
        choose("method", name, method_names())
        return
    refusal = f"{name!r} names no method: expected FILE.py:NAME or MODULE:NAME, e.g. my_methods.py:fairl"
    kind = "eairl_jax.methods.Method"
    METHODS[name] = user_code.find(name, lambda found: isinstance(found, Method), kind, f"--method {name}", refusal)
