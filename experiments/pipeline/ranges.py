"""What a search may choose from: the ranges and lists of `eairl search --set`, read and checked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from eairl_jax import InputError
from eairl_jax.experiments.settings import GROUPS, SETTINGS, choose_setting

DIGITS = 6
"""The digits of a value. A value that is printed is thus the value that was trained with."""
EXAMPLE = "--set lambda_i=log:1e-4..1"
LOG, TO = "log:", ".."


@dataclass(frozen=True)
class Interval:
    """The numbers between two ends.

    Attributes:
      low, high: the ends, which are values too.
      is_log: whether the logarithm of the value is searched, instead of the value.
    """

    low: float
    high: float
    is_log: bool = False

    def __str__(self) -> str:
        return f"{LOG if self.is_log else ''}{self.low:g}{TO}{self.high:g}"

    @property
    def ends(self) -> tuple[float, ...]:
        """Numbers that are possible values of the setting only if all numbers of the interval are."""
        return self.low, self.high


@dataclass(frozen=True)
class Listed:
    """Some numbers.

    Attributes:
      values: the numbers, all different.
    """

    values: tuple[float, ...]

    def __str__(self) -> str:
        return ",".join(f"{value:g}" for value in self.values)

    @property
    def ends(self) -> tuple[float, ...]:
        """All of them."""
        return self.values


Domain = Interval | Listed


class Searched(NamedTuple):
    """The assignments of a search.

    Attributes:
      fixed: `name=value` of the settings that keep one value.
      domains: what each of the other settings is chosen from, in the order in which they were given.
    """

    fixed: tuple[str, ...]
    domains: dict[str, Domain]


def split(assignments: tuple[str, ...]) -> Searched:
    """Separates ranges (`LOW..HIGH`, `log:LOW..HIGH`) and lists (`A,B,C`) from single values.

    Raises:
      InputError: for a range or list that cannot be searched, and if there is no range.
    """
    fixed, domains = [], {}
    for assignment in assignments:
        name, _, text = assignment.partition("=")
        choose_setting(name)
        if name in GROUPS["hparams"] and (TO in text or "," in text or text.startswith(LOG)):
            domains[name] = parse(name, text)
        elif _has_many_values(name, text):
            raise InputError(
                f"--set {assignment}: {name} is no float of the training, so each value needs a program of its own and "
                f"cannot be searched: give one value, or compare values by `eairl sweep`"
            )
        else:
            fixed.append(assignment)
    if not any(isinstance(domain, Interval) for domain in domains.values()):
        hint = "; lists alone make a grid, which `eairl sweep` trains" if domains else ""
        raise InputError(f"nothing to search: give a range, e.g. {EXAMPLE}{hint}")
    return Searched(tuple(fixed), domains)


def parse(name: str, text: str) -> Domain:
    """Reads `LOW..HIGH`, `log:LOW..HIGH` or `A,B,C`.

    Args:
      name: of the setting, for messages.

    Raises:
      InputError: if it is none of these, or if its numbers make no range or list.
    """
    where, is_log = f"--set {name}={text}", text.startswith(LOG)
    if TO not in text:
        if is_log:
            raise InputError(f"{where}: expected a range after {LOG}, e.g. {name}={LOG}1e-4{TO}1")
        values = tuple(_number(where, part) for part in text.split(","))
        if len(set(values)) < len(values):
            raise InputError(f"{where}: expected different values (in {DIGITS} digits)")
        return Listed(values)
    low, high = (_number(where, part) for part in text.removeprefix(LOG).split(TO, 1))
    if low > high:
        raise InputError(f"{where}: the range is reversed; write {name}={Interval(high, low, is_log)}")
    if low == high:
        raise InputError(f"{where}: both ends are {low:g} (in {DIGITS} digits): give one value, or two different ends")
    if is_log and low <= 0:
        raise InputError(f"{where}: {low:g} has no logarithm: begin above 0, or write {name}={Interval(low, high)}")
    return Interval(low, high, is_log)


def rounded(value: float) -> float:
    """The nearest number of `DIGITS` digits."""
    return float(f"{value:.{DIGITS}g}")


def _number(where: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise InputError(
            f"{where}: {text!r} is no number: expected LOW{TO}HIGH, {LOG}LOW{TO}HIGH or A,B,C, e.g. {EXAMPLE}"
        ) from None
    if not math.isfinite(value):
        raise InputError(f"{where}: {text} is no finite number")
    return rounded(value)


def _has_many_values(name: str, text: str) -> bool:
    """Whether a text is a range or a list. Sizes of layers and names of files may hold commas and dots."""
    if isinstance(SETTINGS[name], tuple):
        return TO in text
    return text.startswith(LOG) or "," in text or (TO in text and all(map(_is_number, text.split(TO, 1))))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
