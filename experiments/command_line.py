"""The arguments of `eairl` before tyro reads them: an option that is given several times has all of its values.

tyro keeps the last of several options of one name, without a word. `--set a=1 --set b=2` means `--set a=1 b=2` here.
"""

from __future__ import annotations

import typing
from collections import Counter
from collections.abc import Iterable

from eairl_jax.errors import InputError
from eairl_jax.experiments.options import COMMANDS, NOT_OFFERED

ASSIGNMENTS = ("--set", "--retrain-set")
"""Options whose values are NAME=VALUE."""
HELP = {"-h", "--help"}


class Given(typing.NamedTuple):
    """An option as it was typed.

    Attributes:
      option: for example "--set"; empty for what stands before the first option.
      values: what follows it.
    """

    option: str
    values: list[str]


def normalised(arguments: list[str]) -> list[str]:
    """The arguments with each option once.

    Raises:
      InputError: if an option of one value is given twice, if an option of many values has none, or has one of them
        twice, or if the command lacks an option for a reason.
    """
    if not arguments or arguments[0] not in COMMANDS or HELP & set(arguments):
        return arguments
    kinds = _kinds(COMMANDS[arguments[0]])
    given = _parts(arguments)
    merged: dict[str, Given] = {}
    for each in given:
        if (arguments[0], each.option) in NOT_OFFERED:
            raise InputError(f"{each.option}: {NOT_OFFERED[arguments[0], each.option]}")
        name = each.option.replace("--no-", "--", 1) if each.option not in kinds else each.option
        if name not in merged:
            merged[name] = each
        elif kinds.get(name) is tuple:
            merged[name] = Given(each.option, [*merged[name].values, *each.values])
        elif name in kinds:
            raise InputError(f"{name} is given twice: give it once")
        else:
            return arguments  # tyro says that there is no such option
    for each in merged.values():
        if kinds.get(each.option) is tuple:
            _check_values(each)
    return [token for each in merged.values() for token in (*filter(None, [each.option]), *each.values)]


def _parts(arguments: Iterable[str]) -> list[Given]:
    """The arguments, split before each option. `--set=a=1` is `--set a=1`, and `--retrain_set` is `--retrain-set`."""
    parts = [Given("", [])]
    for token in arguments:
        if token.startswith("--") and len(token) > 2:
            option, equals, value = token.partition("=")
            parts.append(Given(option.replace("_", "-"), [value] if equals else []))
        else:
            parts[-1].values.append(token)
    return parts


def _kinds(record: type) -> dict[str, type]:
    """The type of each option of a command by its name; `tuple` for one of many values."""
    kinds = {}
    for name, hint in typing.get_type_hints(record, include_extras=True).items():
        named = [each.name for each in getattr(hint, "__metadata__", ()) if getattr(each, "name", None)]
        plain = typing.get_args(hint)[0] if hasattr(hint, "__metadata__") else hint
        option = f"--{(named or [name])[0]}".replace("_", "-")
        kinds[option] = tuple if typing.get_origin(plain) is tuple else object
    return kinds


def _check_values(given: Given) -> None:
    """Raises `InputError` if there is no value, or one of them twice."""
    option, values = given
    if not any(values):
        raise InputError(f"{option} has no value: give one or more, or leave {option} out")
    names = [value.partition("=")[0] if option in ASSIGNMENTS else value for value in values]
    name, count = Counter(names).most_common(1)[0]
    if count > 1:
        twice = ", ".join(value for value, each in zip(values, names, strict=True) if each == name)
        raise InputError(f"{option} has {name} {count} times ({twice}): give it once")
