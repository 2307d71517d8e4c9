"""The records that the report shows."""

import pytest

from eairl_jax.experiments.paper import report_tables

MAZES = ("point_maze_left", "point_maze_right")


def test_the_overview_has_a_panel_for_imitation_and_for_each_kind_of_target(make_result, results_of):
    imitations = [
        make_result("eairl-sa", [8.0, 9.0], "ant"),
        make_result("eairl-sa", [10.0, 10.0], "swimmer"),
        make_result("bc", [5.0, 5.0], "ant"),
        make_result("eairl-sa+lambda_i=0", [5.0, 5.0], "ant"),
    ]
    transfers = [make_result("airl_s-s", [4.0, 4.0], "ant", "crippled_ant", rule) for rule in ("last", "policy")]
    imitation, ant = report_tables.overview(results_of(imitations, transfers))
    assert imitation.title == "imitation, 2 tasks"
    # A changed setting is left to the tables.
    assert [(line.title, line.tasks) for line in imitation.lines] == [("behaviour cloning", 1), ("EAIRL", 2)]
    cloning, eairl = imitation.lines
    assert eairl.mean == pytest.approx(0.925)
    assert eairl.paper == pytest.approx((641.12 / 935.12 + 49.55 / 76.21) / 2)
    assert cloning.paper is None
    assert imitation.ceiling is None
    assert (ant.title, ant.ceiling) == ("the reward in the crippled ant, 1 task", 0.95)
    assert [line.mean for line in ant.lines] == [0.4]


def test_measures_are_means_over_the_seeds_that_have_them(make_result):
    result = make_result("eairl-sa", [1.0, 2.0], *MAZES, "last")
    (measured,) = report_tables.closeness([result])
    assert (measured["title"], measured["pair"], measured["score"]) == ("EAIRL", " to ".join(MAZES), 0.15)
    assert measured["measures"]["target: epic"] == 0.5
    assert not any("worth" in name for name in measured["measures"])
    (worth,) = report_tables.worth([result])
    assert worth["worth"] == [1.5, 1.5, 1.5]


def test_a_measure_that_no_seed_has_is_none(make_result):
    closeness = {"source": {"epic": [None, None]}, "target": {"epic": [None, 0.2]}}
    (measured,) = report_tables.closeness([make_result("eairl-sa", [1.0, 2.0], *MAZES, "last", closeness=closeness)])
    assert measured["measures"] == {"source: epic": None, "target: epic": 0.2}


def test_the_budget_counts_the_steps_of_learning_and_of_retraining(make_result):
    budget = report_tables.budget("table1", make_result("eairl-sa", [1.0, 2.0], *MAZES, "last"))
    assert (budget["learned"], budget["retrained"], budget["minutes"]) == (40, 40, 1.0)
    assert (budget["seeds"], budget["device"], budget["jax"]) == ("0 to 1", "2 x cpu", "0.10")
    assert report_tables.budget("table2", make_result("eairl-sa", [1.0]))["retrained"] is None


def test_hours_include_compilation(make_result, results_of):
    results = results_of([make_result("bc", [1.0]), make_result("gail-sa", [1.0])])
    assert report_tables.hours(results) == [{"experiment": "table2", "results": 2, "hours": 2 * 72 / 3600}]


def test_captions_say_what_a_picture_shows(make_result):
    transfers = [
        make_result("eairl-separable", [7.0, 8.0], "ant", "crippled_ant", "last", imitation_returns=[3.0, 4.0])
    ]
    assert "the reward that each method learned" in report_tables.caption("point_maze_left", transfers)
    assert "the paths of every seed" in report_tables.caption("ant-ways", transfers)
    assert report_tables.caption("crippled_ant", transfers).endswith("seed 0: true return 7")
    assert "learned beside the reward of EAIRL, separable, seed 0: true return 3" in report_tables.caption(
        "ant", transfers
    )
    assert report_tables.caption("swimmer", transfers) == "swimmer"
