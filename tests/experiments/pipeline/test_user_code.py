"""Objects of a user's own file (`test_user_methods.py` and `test_user_networks.py` test what they are used for)."""

import pytest

from eairl_jax import InputError
from eairl_jax.experiments.pipeline import user_code


def test_an_object_is_found_by_the_name_of_its_code(tmp_path):
    (tmp_path / "mine.py").write_text("value = 7\n")
    name = f"{tmp_path}/mine.py:value"
    assert user_code.find(name, lambda found: found == 7, "seven", "--option", "refused") == 7
    with pytest.raises(InputError, match="--option: "):
        user_code.find(name, lambda found: found == 8, "eight", "--option", "refused")
    with pytest.raises(InputError, match=r"^refused$"):
        user_code.find("pendulum", lambda found: True, "anything", "--option", "refused")
