"""Points of a sweep."""

from eairl_jax.experiments.pipeline import points

TWO = [{"beta": 1.0, "lambda_i": 0.1}, {"beta": 2.0, "lambda_i": 0.1}]


def test_a_point_is_named_by_its_values():
    assert points.name(TWO[0]) == "beta 1, lambda_i 0.1"
    assert points.folder_name(TWO[0]) == "beta=1-lambda_i=0.1"
    assert (points.name({}), points.folder_name({})) == ("", "all")


def test_a_dropped_seed_has_no_return():
    dropped = [{"seed": 3, "beta": 1.0}]
    assert points.returns(TWO, [3, 4], [5.0, 6.0, 7.0], dropped) == [[5.0], [6.0, 7.0]]
    assert points.returns(TWO, [3, 4], [5.0, 6.0], dropped) == [[5.0], [6.0, None]]
    assert points.returns(TWO, [3, 4], [5.0], [{"seed": 3}, {"seed": 4}]) == [[], []]
