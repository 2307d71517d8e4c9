"""Metrics that are read while they are written."""

import numpy as np
import pytest

from eairl_jax import InputError
from eairl_jax.experiments.pipeline.following import Followed

HEADER = "seed,iteration,env_steps,accuracy,true_return\n"


def lines(*iterations):
    return "".join(f"{seed},{i},{i * 10},0.5,{i + seed}\n" for i in iterations for seed in (0, 2))


def test_news_are_read_once_and_a_torn_line_waits(tmp_path):
    path, followed = tmp_path / "metrics.csv", Followed(tmp_path)
    assert not followed.update()  # there is no file yet
    path.write_text(HEADER)
    assert not followed.update()
    path.write_text(HEADER + lines(1, 2) + "0,3,3")
    assert followed.update()
    assert not followed.update()
    assert followed.iterations.tolist() == [1, 2]
    np.testing.assert_array_equal(followed.curves["true_return"], [2, 3])
    path.write_text(HEADER + lines(1, 2, 3))
    assert followed.update()
    assert followed.curves["true_return"].tolist() == [2, 3, 4]
    assert set(followed.curves) == {"accuracy", "true_return"}


def test_a_run_that_went_back_to_its_checkpoint_is_read_anew(tmp_path):
    path, followed = tmp_path / "metrics.csv", Followed(tmp_path)
    path.write_text(HEADER + lines(1, 2, 3))
    followed.update()
    path.write_text(HEADER + lines(1))
    assert followed.update()
    assert followed.iterations.tolist() == [1]


def test_values_that_are_not_finite_do_not_count(tmp_path):
    (tmp_path / "metrics.csv").write_text(HEADER + "0,1,10,0.5,nan\n1,1,10,0.7,4\n0,2,20,0.5,-inf\n")
    followed = Followed(tmp_path)
    assert followed.update()
    np.testing.assert_array_equal(followed.curves["true_return"], [4, np.nan])
    np.testing.assert_allclose(followed.curves["accuracy"], [0.6, 0.5])


@pytest.mark.parametrize("text", ["a,b\n1,2\n", HEADER + "0,one,10,0.5,1\n", HEADER + "0\n", HEADER + "0,1,10,0.5,x\n"])
def test_what_is_no_table_of_metrics_is_refused(tmp_path, text):
    (tmp_path / "metrics.csv").write_text(text)
    with pytest.raises(InputError, match=r"is no(?: table of)? metrics"):
        Followed(tmp_path).update()
