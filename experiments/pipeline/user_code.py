"""An object of a user's own, by the name of its code: FILE.py:NAME or MODULE:NAME."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from eairl_jax import InputError, envs
from eairl_jax.envs import names, registry


def find(name: str, fits: Callable[[Any], bool], kind: str, option: str, refusal: str) -> Any:
    """Loads an object; its code is run.

    Args:
      fits: whether the object is one of the kind.
      kind: what it must be, for an error message.
      option: what the user gave, for an error message.
      refusal: the error message for a name that names no code.

    Raises:
      InputError: if there is no such object.
    """
    try:
        code = names.parse(name)
        if code.origin not in (names.FILE, names.MODULE) or code.arguments:
            raise InputError(refusal)
        return registry.user_object(code, fits, kind)
    except envs.TaskError as e:
        raise InputError(f"{option}: {e}") from None
