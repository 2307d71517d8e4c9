"""Arguments from Python: whole numbers, numbers, sizes and random keys of any library, or one clear message."""

from __future__ import annotations

import math
import operator
from typing import Any, NamedTuple

from eairl_jax.errors import InputError
from eairl_jax.schema import shown

LARGEST_COUNT = 2**31 - 1
"""Devices count in 32 bits."""


SMALLEST, LARGEST = 1e-12, 1e6
"""Sizes of the floats of a run: 0, or between these two. A smaller number is lost in float32, and would act as 0; the
square of a much larger one is infinite there."""


class Range(NamedTuple):
    """The floats that a setting can have. A number that is not 0 has a size of at least `SMALLEST`.

    Attributes:
      low: the smallest value.
      high: the largest value.
      included: whether `low` itself is a value.
    """

    low: float = 0.0
    high: float = LARGEST
    included: bool = True

    def contains(self, values: Any) -> Any:
        """Whether a number, or each number of an array, is in the range; NaN is not."""
        above = values >= self.low if self.included else values > self.low
        # A little less than SMALLEST: its nearest number in float32 is below it.
        return above & (values <= self.high) & ((values == 0) | (abs(values) >= SMALLEST * (1 - 1e-6)))

    def __str__(self) -> str:
        bounds = f"at least {self.low:g}" if self.included else f"above {self.low:g}"
        return f"{bounds} and at most {self.high:g}"

    def check(self, name: str, value: float, example: float) -> None:
        """Raises `InputError` unless the number is in the range.

        Args:
          name: of the setting.
          value: a number.
          example: a possible value, for the message.
        """
        if not self.contains(value):
            is_tiny = 0 < abs(value) < SMALLEST and self.low <= value
            hint = f"; a number below {SMALLEST:g} acts as 0" if is_tiny else ""
            raise InputError(f"{name} = {value:g}: expected a number {self}, for example {example:g}{hint}")


def whole_number(value: Any) -> int:
    """The Python number of a whole number of any library (`np.int64`, an array `[]` of jax, ...).

    Raises:
      TypeError: for anything else; truth values are no numbers.
    """
    if _is_truth(value) or getattr(value, "shape", ()) != ():
        raise TypeError
    return operator.index(value)


def real_number(value: Any) -> int | float:
    """The Python number of a number of any library; infinite if it has no `float`.

    Raises:
      TypeError: for anything else; truth values are no numbers.
    """
    if _is_truth(value) or getattr(value, "shape", ()) != () or isinstance(value, str | bytes):
        raise TypeError
    if isinstance(value, int) and abs(value) <= LARGEST_COUNT:
        return value
    try:
        return float(value)
    except OverflowError:  # a whole number of hundreds of digits
        return math.inf
    except ValueError:
        raise TypeError from None


def _is_truth(value: Any) -> bool:
    return isinstance(value, bool) or str(getattr(value, "dtype", "")) == "bool"


def count(name: str, value: Any, low: int = 1, high: int = LARGEST_COUNT) -> int:
    """A count or size as a Python number.

    Args:
      name: of the argument, for the error message.
      value: a whole number of any library.
      low: the smallest number that is possible.
      high: the largest number that is possible.

    Raises:
      InputError: if it is no whole number from `low` to `high`.
    """
    try:
        number = whole_number(value)
    except TypeError:
        raise InputError(f"{name} = {shown(value)}: expected a whole number of at least {low}") from None
    if not low <= number <= high:
        raise InputError(f"{name} = {shown(number)}: expected a whole number from {low} to {high}")
    return number


def function(name: str, value: Any, call: str) -> None:
    """Checks that an argument can be called.

    Args:
      name: of the argument, for the error message.
      call: how it is called, for example "act(obs, key)".

    Raises:
      InputError: if it cannot.
    """
    if not callable(value):
        raise InputError(f"{name} is {shown(value)}: expected a function that is called as {call}")


def one_key(key: Any) -> Any:
    """One random key: `jax.random.key(0)`, or the old-style `jax.random.PRNGKey(0)`, also as a NumPy array.

    Raises:
      InputError: if it is none, or if these are several keys.
    """
    import jax

    shape, dtype = getattr(key, "shape", None), getattr(key, "dtype", None)
    if dtype is not None and jax.numpy.issubdtype(dtype, jax.dtypes.prng_key) and shape == ():
        return key
    old = jax.eval_shape(jax.random.PRNGKey, 0)
    if dtype != old.dtype or shape != old.shape:
        raise InputError(
            f"key is {_described(key)}: expected one random key, for example jax.random.key(0)"
            + ("; these are several, take one of them" if _are_several(shape, dtype, old) else "")
        )
    return key


def _described(key: Any) -> str:
    dtype = getattr(key, "dtype", None)
    return shown(key) if dtype is None else f"an array of shape {key.shape} and dtype {dtype}"


def _are_several(shape: Any, dtype: Any, old: Any) -> bool:
    return bool(shape) and ("key" in str(dtype) or (dtype == old.dtype and shape[-1:] == old.shape))
