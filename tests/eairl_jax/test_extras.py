"""A missing library is one sentence with the command that installs it."""

import json

import pytest

from eairl_jax import InputError
from eairl_jax.extras import required


def test_a_missing_library_names_the_extra():
    with pytest.raises(InputError, match=r'no_such_library is missing .* pip install "eairl-jax\[minari\]"'):
        required("no_such_library", "minari")


def test_a_library_is_imported():
    assert required("json", "none") is json
