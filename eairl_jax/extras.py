"""Libraries that only some functions need. An extra of the package installs each of them."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from eairl_jax.errors import InputError


def required(module: str, extra: str) -> ModuleType:
    """An optional library, imported at its first use.

    Args:
      module: the name of the module.
      extra: the extra of this package that installs it.

    Raises:
      InputError: if the library is not installed, with the command that installs it.
    """
    try:
        return import_module(module)
    except ImportError as e:
        raise InputError(f'{module} is missing ({e}): pip install "eairl-jax[{extra}]"') from None
