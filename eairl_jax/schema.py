"""What a value from a file must be: types, ranges, sizes.

A `Schema` takes a value and its place in the file, and returns the value. It raises `Mismatch` for any other value.
`storage.read_json` turns a `Mismatch` into an `InputError` that names the file.
"""

from __future__ import annotations

import json
import math
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from typing import Any

LARGEST_WHOLE = 2**63 - 1
LARGEST_SEED = 2**32 - 1
SHOWN = 60
"""Characters of a wrong value that an error message shows."""

Schema = Callable[[Any, str], Any]


class Mismatch(Exception):
    """A value is not what its schema expects.

    Attributes:
      place: of the value in its file, for example "config.hidden[2]"; empty for the whole file.
      found: the value.
      expected: what it should have been.
    """

    def __init__(self, place: str, found: Any, expected: str):
        self.place, self.found, self.expected = place, found, expected
        written = json.dumps(found) if found is None or isinstance(found, bool) else shown(found)
        super().__init__(f"{place + ' is ' if place else ''}{written}: expected {expected}")


class Absent:
    """Stands for a member that a record does not have."""

    def __repr__(self) -> str:
        return "missing"


def shown(value: Any) -> str:
    """A value as a short text of one line, whatever its size."""
    if isinstance(value, int) and abs(value) > 10**30:
        return f"a whole number of {value.bit_length()} bits"
    if isinstance(value, dict):
        return f"an object with {listed(value)}" if value else "an empty object"
    if isinstance(value, list | tuple) and len(value) > 8:
        return f"a list of {len(value)} values"
    text = repr(value[: SHOWN + 1] if isinstance(value, str) else value)
    return text if len(text) <= SHOWN else text[:SHOWN] + "..."


def listed(names: Iterable[Any]) -> str:
    """The first names, separated by commas."""
    names = [str(name)[:SHOWN] for name in names]
    return ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")


# Single values -------------------------------------------------------------------------------------------------------


def anything(value: Any, place: str) -> Any:
    """Any value."""
    del place
    return value


def whole(low: int = -LARGEST_WHOLE, high: int = LARGEST_WHOLE) -> Schema:
    """A whole number from `low` to `high`."""
    bounds = f" of at least {low}" if high == LARGEST_WHOLE else f" from {low} to {high}"
    expected = "a whole number" + ("" if low == -LARGEST_WHOLE else bounds)

    def check(value: Any, place: str) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise Mismatch(place, value, expected)
        return value

    return check


def number(low: float = -math.inf, high: float = math.inf) -> Schema:
    """A finite number from `low` to `high`."""
    lower, upper = (
        (f" of at least {low:g}" if low > -math.inf else ""),
        (f" of at most {high:g}" if high < 1e308 else ""),
    )
    expected = "a finite number" + lower + (" and" if lower and upper else "") + upper

    def check(value: Any, place: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or abs(value) > 1e308:
            raise Mismatch(place, value, expected)
        if not math.isfinite(value) or not low <= value <= high:
            raise Mismatch(place, value, expected)
        return value

    return check


def text(value: Any, place: str) -> str:
    """A text of one line."""
    if not isinstance(value, str) or not value.isprintable():
        raise Mismatch(place, value, "a text of one line")
    return value


def flag(value: Any, place: str) -> bool:
    """True or false."""
    if not isinstance(value, bool):
        raise Mismatch(place, value, "true or false")
    return value


def optional(schema: Schema) -> Schema:
    """A value, or null."""

    def check(value: Any, place: str) -> Any:
        return None if value is None else schema(value, place)

    return check


def either(*schemas: Schema) -> Schema:
    """What at least one of the schemas expects."""

    def check(value: Any, place: str) -> Any:
        expected = []
        for schema in schemas:
            try:
                return schema(value, place)
            except Mismatch as e:
                if e.place != place:  # the kind is right, and something inside is wrong
                    raise
                expected.append(e.expected)
        raise Mismatch(place, value, ", or ".join(dict.fromkeys(expected)))

    return check


# Lists and objects ---------------------------------------------------------------------------------------------------


def list_of(schema: Schema, low: int = 0) -> Schema:
    """A list of at least `low` values."""

    def check(value: Any, place: str) -> list:
        if not isinstance(value, list) or len(value) < low:
            raise Mismatch(place, value, "a list" + (f" of at least {low} values" if low else ""))
        return [schema(each, f"{place}[{i}]") for i, each in enumerate(value)]

    return check


def table_of(schema: Schema) -> Schema:
    """An object whose members are all alike."""

    def check(value: Any, place: str) -> dict:
        if not isinstance(value, dict):
            raise Mismatch(place, value, "an object")
        return {name: schema(each, _inside(place, name)) for name, each in value.items()}

    return check


def record(needed: Mapping[str, Schema], others: Mapping[str, Schema] | None = None) -> Schema:
    """An object with all members of `needed`, perhaps those of `others`, and perhaps members of any other name."""
    known = {**needed, **(others or {})}

    def check(value: Any, place: str) -> dict:
        if not isinstance(value, dict):
            raise Mismatch(place, value, f"an object with {listed(needed) or 'named members'}")
        for name in needed:
            if name not in value:
                raise Mismatch(_inside(place, name), Absent(), "this member")
        return {name: known.get(name, anything)(each, _inside(place, name)) for name, each in value.items()}

    return check


def _inside(place: str, name: str) -> str:
    name = name[:SHOWN] if name.isprintable() else repr(name[:SHOWN])
    return f"{place}.{name}" if place else name


SINGLE: dict[Any, Schema] = {
    Any: anything,
    int: whole(),
    float: number(),
    str: text,
    bool: flag,
    dict: table_of(anything),
}
SINGLE |= {list: list_of(anything), types.NoneType: optional(anything)}


def of(kind: Any) -> Schema:
    """The schema of a type annotation: `int`, `float`, `str`, `bool`, `Any`, `list[...]`, `dict[str, ...]`, `A | B`."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        schemas = [of(each) for each in inner if each is not types.NoneType]
        schema = schemas[0] if len(schemas) == 1 else either(*schemas)
        return optional(schema) if types.NoneType in inner else schema
    if origin is list:
        return list_of(of(inner[0]))
    if origin is dict:
        return table_of(of(inner[1]))
    return SINGLE[kind]


def of_fields(cls: type) -> dict[str, Schema]:
    """The schema of each field of a dataclass."""
    return {name: of(kind) for name, kind in typing.get_type_hints(cls).items()}
