"""A schema takes what it describes, and names the place of everything else."""

import dataclasses
from typing import Any

import pytest

from eairl_jax import schema

RUN = schema.record(
    {"task": schema.text, "seeds": schema.either(schema.whole(1), schema.list_of(schema.whole(0), low=1))},
    {"floats": schema.table_of(schema.number(0.0, 1.0)), "done": schema.flag, "note": schema.optional(schema.text)},
)
GOOD = {"task": "ant", "seeds": [0, 3], "floats": {"gamma": 0.5}, "done": True, "note": None, "other": [{}]}


def test_what_is_described_is_returned():
    assert RUN(GOOD, "") == GOOD
    assert RUN({"task": "ant", "seeds": 4}, "") == {"task": "ant", "seeds": 4}


BAD = {
    "no object": ([], "a list of|\\[\\]: expected an object with task, seeds"),
    "missing": ({"task": "ant"}, "seeds is missing"),
    "type": (GOOD | {"task": 3}, "task is 3: expected a text"),
    "two lines": (GOOD | {"task": "a\nb"}, "task is 'a.nb': expected a text of one line"),
    "inside a list": (GOOD | {"seeds": [0, -1]}, r"seeds\[1\] is -1: expected a whole number of at least 0"),
    "neither": (GOOD | {"seeds": "x"}, "seeds is 'x': expected a whole number of at least 1, or a list of at least 1"),
    "truth is no number": (GOOD | {"seeds": True}, "seeds is true: expected"),
    "range": (GOOD | {"floats": {"gamma": 1.5}}, "floats.gamma is 1.5: expected a finite number of at least 0 and of"),
    "infinite": (GOOD | {"floats": {"gamma": float("inf")}}, "floats.gamma is inf: expected"),
    "huge": (GOOD | {"floats": {"gamma": 10**400}}, "floats.gamma is a whole number of 1329 bits"),
    "null": (GOOD | {"done": None}, "done is null: expected true or false"),
    "long text": (GOOD | {"done": "x" * 1000}, r"done is 'x{59}\.\.\.: expected"),
    "strange names": (GOOD | {"floats": {"a\nb": "x"}}, r"floats\.'a.nb' is 'x'"),
}


@pytest.mark.parametrize(("value", "message"), BAD.values(), ids=BAD)
def test_what_is_wrong_is_named_with_its_place(value, message):
    with pytest.raises(schema.Mismatch, match=message) as e:
        RUN(value, "")
    assert len(str(e.value)) < 300


@dataclasses.dataclass
class Example:
    """One field for each kind of annotation."""

    count: int
    names: list[str]
    table: dict[str, float]
    maybe: float | None
    mixed: int | str
    free: Any


def test_annotations_are_schemas():
    good = {"count": 1, "names": ["a"], "table": {"x": 1}, "maybe": None, "mixed": "b", "free": [None]}
    check = schema.record(schema.of_fields(Example))
    assert check(good, "") == good
    for name, wrong in {"count": 1.5, "names": [1], "table": {"x": "y"}, "maybe": "z", "mixed": None}.items():
        with pytest.raises(schema.Mismatch, match=name):
            check(good | {name: wrong}, "")
