"""The time of an iteration along a number, and the law that fits it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eairl_jax import InputError
from eairl_jax.experiments.options import Bench
from eairl_jax.experiments.pipeline import scaling
from eairl_jax.experiments.pipeline.experiment import imitations


def test_an_axis_is_a_name_and_whole_numbers_in_rising_order():
    assert scaling.axis("num_envs=64,16,16") == scaling.Axis("num_envs", (16, 64))


@pytest.mark.parametrize("text", ["num_envs", "num_envs=", "num_envs=16", "=1,2", "seeds=0,1", "seeds=1.5,2", "a=1,b"])
def test_what_is_no_axis_is_refused(text):
    with pytest.raises(InputError, match="expected a name and at least two whole numbers"):
        scaling.axis(text)


@given(st.floats(1e-4, 10), st.floats(1e-6, 10), st.sets(st.integers(1, 10_000), min_size=2, max_size=6))
def test_a_law_is_found_again(fixed, each, values):
    values = sorted(values)
    law = scaling.fitted(values, [fixed + each * value for value in values])
    assert law.deviation < 1e-6
    np.testing.assert_allclose(law.fixed + law.each * np.array(values), fixed + each * np.array(values), rtol=1e-6)


def test_a_law_has_no_number_below_0_and_says_how_far_it_is_off():
    law = scaling.fitted([1, 2, 4], [4.0, 2.0, 1.0])
    assert law.each == 0
    assert law.deviation == pytest.approx(max(abs(law.fixed / y - 1) for y in (4.0, 2.0, 1.0)))


def test_one_number_varies_and_a_bad_value_is_refused_before_anything_is_measured():
    def make(settings):
        return imitations(Bench("pendulum", set=tuple(settings)), "reward")[0]

    of_envs = scaling.experiments(scaling.Axis("num_envs", (4, 8)), make)
    assert [(each.config.num_envs, each.seeds) for each in of_envs] == [(4, (0,)), (8, (0,))]
    of_seeds = scaling.experiments(scaling.Axis("seeds", (1, 3)), make)
    assert [each.seeds for each in of_seeds] == [(0,), (0, 1, 2)]
    assert of_seeds[0].config == of_seeds[1].config
    with pytest.raises(InputError, match="unknown setting"):
        scaling.experiments(scaling.Axis("num_env", (4, 8)), make)
