"""Numbers of any library are numbers, truth values and texts are not; one key is one key."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import InputError, arguments

WHOLE = [3, np.int64(3), np.uint8(3), np.array(3), jnp.int32(3), jnp.asarray(3)]
NO_WHOLE = [
    True,
    np.bool_(True),
    jnp.asarray(True),
    3.0,
    np.float32(3),
    "3",
    None,
    [3],
    np.array([3]),
    jnp.ones(1, int),
]


@pytest.mark.parametrize("value", WHOLE, ids=repr)
def test_whole_numbers_of_any_library(value):
    assert arguments.count("steps", value) == 3
    assert type(arguments.count("steps", value)) is int
    assert arguments.real_number(value) == 3


@pytest.mark.parametrize("value", NO_WHOLE, ids=repr)
def test_what_is_no_whole_number_is_named(value):
    with pytest.raises(InputError, match=r"steps = .*: expected a whole number of at least 1"):
        arguments.count("steps", value)


@pytest.mark.parametrize("value", [0, -1, 2**31, 10**5000], ids=["zero", "negative", "32 bits", "huge"])
def test_counts_have_a_range(value):
    with pytest.raises(InputError, match=r"steps = .*: expected a whole number from 1 to 2147483647"):
        arguments.count("steps", value)


@pytest.mark.parametrize("value", [0.5, np.float32(0.5), jnp.float32(0.5), np.array(0.5)], ids=repr)
def test_numbers_of_any_library(value):
    assert arguments.real_number(value) == 0.5


@pytest.mark.parametrize("value", [True, "0.5", None, [0.5], np.array([0.5]), 1j], ids=repr)
def test_what_is_no_number(value):
    with pytest.raises(TypeError):
        arguments.real_number(value)


@pytest.mark.parametrize(
    "key", [jax.random.key(0), jax.random.PRNGKey(0), np.zeros(2, np.uint32), jax.random.split(jax.random.key(1))[0]]
)
def test_one_key_of_either_kind(key):
    assert arguments.one_key(key) is key


SEVERAL = [jax.random.split(jax.random.key(0), 3), jax.random.split(jax.random.PRNGKey(0), 3)]


@pytest.mark.parametrize("key", [*SEVERAL, 0, None, "key", np.zeros(2), np.zeros(3, np.uint32)])
def test_what_is_not_one_key_is_refused(key):
    with pytest.raises(InputError, match=r"expected one random key, for example jax\.random\.key\(0\)") as e:
        arguments.one_key(key)
    assert ("these are several" in str(e.value)) == any(key is each for each in SEVERAL)


def test_a_function_is_needed():
    arguments.function("act", len, "act(obs, key)")
    with pytest.raises(InputError, match=r"act is 3: expected a function that is called as act\(obs, key\)"):
        arguments.function("act", 3, "act(obs, key)")
