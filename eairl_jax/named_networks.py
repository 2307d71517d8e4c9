"""Networks of a user's own for the reward and the potentials, by the name of their code. Needs no jax."""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Callable, Iterator
from typing import Any

from eairl_jax.errors import InputError
from eairl_jax.schema import shown

MLP = "mlp"
"""The name of the library's network."""

NETWORKS: dict[str, Callable[[], Any]] = {}
"""The networks that this program knows beside `MLP`, by the values of `Config.net`: flax modules, or what makes them.

A network maps `[..., n]`, the observation and the action in one vector, to `[...]`. Its variables are parameters alone.
"""


def register(name: str) -> None:
    """Makes a network known that is named MODULE:NAME; the module is imported. A known network stays as it is.

    Only call it for a name that the user has given: the import runs the module's code.

    Raises:
      InputError: if there is no such network.
    """
    if name == MLP or name in NETWORKS:
        return
    module, _, attribute = name.rpartition(":")
    if not module or not attribute.isidentifier():
        raise InputError(f'net = {shown(name)}: expected "mlp", MODULE:NAME, or a key of eairl_jax.NETWORKS')
    if module.endswith(".py"):
        raise InputError(
            f"net = {shown(name)}: a file is loaded by the commands alone; in a program of yours import the network "
            f"and say eairl_jax.NETWORKS[{name!r}] = {attribute}"
        )
    try:
        found = getattr(importlib.import_module(module), attribute, None)
    except Exception as e:  # whatever the module raises
        raise InputError(f"net = {shown(name)}: {module} cannot be imported ({type(e).__name__}: {e})") from e
    if not callable(found):
        raise InputError(f"net = {shown(name)}: {module} has no class or function {attribute}")
    NETWORKS[name] = found


@contextlib.contextmanager
def known(name: str, network: Callable[[], Any] | None) -> Iterator[None]:
    """Makes a network known, and forgets it if the context ends with an error. None changes nothing."""
    before = dict(NETWORKS)
    if network is not None:
        NETWORKS[name] = network
    try:
        yield
    except BaseException:
        NETWORKS.clear()
        NETWORKS.update(before)
        raise


def network(name: str) -> Callable[[], Any]:
    """What makes a known network.

    Raises:
      InputError: if the network is not known. Nothing is imported: the name may come from a stranger's file.
    """
    if name not in NETWORKS:
        raise InputError(
            f"the network {shown(name)} is code that this program does not know, and no code is run because a file "
            "names it: import the network, and give it with load_reward(folder, net=NETWORK), or say "
            f"eairl_jax.NETWORKS[{name!r}] = NETWORK before; a command takes --net. A program without the code can "
            "use what `eairl export` writes"
        )
    return NETWORKS[name]
