"""Ranges and lists of a search."""

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from eairl_jax import InputError
from eairl_jax.experiments.pipeline import ranges
from eairl_jax.experiments.pipeline.ranges import Interval, Listed, parse, rounded, split

NUMBERS = st.floats(-1e6, 1e6, allow_subnormal=False)


@given(NUMBERS, NUMBERS, st.booleans())
def test_a_range_is_what_was_written_or_refused(low, high, is_log):
    text = f"{'log:' if is_log else ''}{low!r}..{high!r}"
    low, high = rounded(low), rounded(high)
    if low < high and (low > 0 or not is_log):
        domain = parse("beta", text)
        assert domain == Interval(low, high, is_log)
        assert parse("beta", str(domain)) == domain, "what is printed can be typed"
        assert domain.ends == (low, high)
    else:
        with pytest.raises(InputError, match=r"reversed|both ends are|has no logarithm"):
            parse("beta", text)


@given(st.lists(NUMBERS, min_size=2, max_size=6))
def test_a_list_is_what_was_written_or_refused(values):
    text, numbers = ",".join(map(repr, values)), tuple(map(rounded, values))
    if len(set(numbers)) == len(numbers):
        domain = parse("beta", text)
        assert domain == Listed(numbers)
        assert parse("beta", str(domain)) == domain
    else:
        with pytest.raises(InputError, match="expected different values"):
            parse("beta", text)


@given(NUMBERS, NUMBERS, st.floats(0, 1))
def test_a_rounded_value_stays_in_its_range_and_is_what_is_printed(low, high, share):
    low, high = sorted(map(rounded, (low, high)))
    value = low + share * (high - low)
    assume(low <= value <= high)
    assert low <= rounded(value) <= high
    assert float(f"{rounded(value):g}") == rounded(value)
    assert math.isclose(rounded(value), value, rel_tol=1e-5)


@given(st.text(st.characters(exclude_categories=["Cs"]), max_size=12))
def test_any_text_is_a_domain_or_one_message(text):
    try:
        domain = parse("beta", text)
    except InputError as e:
        message = str(e)
    else:
        message = f"--set beta={domain}"
        assert all(map(math.isfinite, domain.ends))
    assert message.startswith("--set beta=")


REFUSED = {
    "lambda_i=1..0.1": "reversed; write lambda_i=0.1..1",
    "lambda_i=log:1..0.1": "reversed; write lambda_i=log:0.1..1",
    "lambda_i=1..1.0": "both ends are 1 ",
    "lambda_i=1..1.0000001": "both ends are 1 ",
    "lambda_i=log:0..1": "0 has no logarithm: begin above 0, or write lambda_i=0..1",
    "lambda_i=nan..1": "nan is no finite number",
    "lambda_i=0..inf": "inf is no finite number",
    "lambda_i=0..": "'' is no number",
    "lambda_i=log:1": "expected a range after log:",
    "lambda_i=log:1,2": "expected a range after log:",
    "lambda_i=low..high": "'low' is no number",
    "lambda_i=1,1": "expected different values",
    "lambda_i=1": "nothing to search: give a range, e.g. --set lambda_i=log:1e-4..1$",
    "lambda_i=0,1": "lists alone make a grid, which `eairl sweep` trains",
    "lamda_i=0..1": "did you mean lambda_i",
    "num_envs=5..10": "num_envs is no float of the training",
    "num_envs=5,10": "num_envs is no float of the training",
    "hidden=5..10": "hidden is no float of the training",
    "activation=relu,tanh": "each value needs a program of its own",
    "snapshot_every=log:1..4": "snapshot_every is no float",
}


@pytest.mark.parametrize("assignment", REFUSED)
def test_what_cannot_be_searched_is_one_message(assignment):
    with pytest.raises(InputError, match=REFUSED[assignment]):
        split((assignment,))


def test_single_values_stay_what_they_are():
    given = ("hidden=8,8", "lambda_i=log:1e-4..1", "net=../my_nets.py:Net", "beta=1,2", "gamma=0.9")
    fixed, domains = split(given)
    assert fixed == ("hidden=8,8", "net=../my_nets.py:Net", "gamma=0.9")
    assert domains == {"lambda_i": Interval(1e-4, 1.0, True), "beta": Listed((1.0, 2.0))}
    assert list(map(str, domains.values())) == ["log:0.0001..1", "1,2"]
    assert len(f"{1 / 3:g}") - 2 == ranges.DIGITS
