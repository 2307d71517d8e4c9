"""Results on disk, their order and their names."""

import dataclasses
import json
from pathlib import Path

import pytest

from eairl_jax import InputError
from eairl_jax.experiments.paper import results

ROOT = Path(__file__).parents[3]
MAZES = ("point_maze_left", "point_maze_right")


def test_a_result_replaces_the_result_of_the_same_identity_and_keeps_its_place(tmp_path, make_result):
    path = tmp_path / "new" / "table1.json"
    first, second = (make_result(name, [1.0, 2.0], *MAZES, "last") for name in ("airl_s-s", "eairl-sa"))
    newer = dataclasses.replace(first, returns=[5.0, 6.0])
    other_rule = dataclasses.replace(first, rule="policy")
    for result in (first, second, newer, other_rule):
        results.add(path, result)
    assert results.load(path) == [newer, second, other_rule]


def test_there_are_no_results_where_there_is_no_file(tmp_path):
    assert results.load(tmp_path / "table1.json") == []


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"other": 1}, "holds no results of `eairl reproduce`"),
        ({"rows": [{"name": "bc"}]}, "result 0 of .* lacks method"),
    ],
)
def test_a_file_that_holds_something_else_is_refused(tmp_path, content, message):
    (tmp_path / "table1.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=message):
        results.load(tmp_path / "table1.json")


def test_the_default_folder_is_that_of_the_checkout_whatever_the_current_folder_is():
    assert results.FOLDER == ROOT / "experiments" / "results"
    assert results.FOLDER.is_absolute()


@pytest.mark.parametrize("name", ["table1", "table2", "ablations"])
def test_the_shipped_results_have_everything_that_a_result_needs(name):
    shipped = results.load(results.FOLDER / f"{name}.json")
    assert len(shipped) > (3 if name == "ablations" else 10)
    assert all(len(result.returns) == len(result.seeds) for result in shipped)


def test_titles_and_colours():
    assert results.title("eairl-sa+lambda_i=0") == "EAIRL, lambda_i=0"
    assert results.title("mine-sa") == "mine-sa"
    assert results.color("eairl-sa+lambda_i=0") == results.color("eairl-sa") != results.color("eairl-separable")
    assert set(results.COLORS) == set(results.NAMES)
    assert len(set(results.COLORS.values())) == len(results.COLORS)


def test_results_are_listed_in_the_papers_order_and_variants_after_what_they_vary(make_result):
    trained = ["new", "eairl-sa+tuned", "eairl-separable", "airl_s-s", "bc", "eairl-sa", "airl_s-s"]
    made = [make_result(name, [1.0]) for name in trained]
    order = ["bc", "airl_s-s", "eairl-sa", "eairl-sa+tuned", "eairl-separable", "new"]
    assert results.names_in_order(made) == order
    assert list(dict.fromkeys(result.name for result in results.in_order(made))) == order


def test_transfers_are_told_from_imitations_and_from_rewards_back_in_their_source(make_result):
    imitation = make_result("eairl-sa", [1.0])
    home, away = (make_result("eairl-sa", [1.0], MAZES[0], target, "last") for target in MAZES)
    assert results.transfers([imitation, home, away]) == [away]
    assert list(results.by_task([imitation, away, home, away])) == [("pendulum", None), MAZES, (MAZES[0], MAZES[0])]
    assert [results.pair(result) for result in (imitation, away)] == ["pendulum", " to ".join(MAZES)]


def test_each_budget_of_retraining_has_one_ceiling(make_result):
    short, other, long = (
        make_result(name, [1.0], *MAZES, "last")
        for name in ("eairl-sa", "airl_s-s", "eairl-separable+retrain_iterations=1600")
    )
    assert results.ceilings([short, other, long, make_result("bc", [1.0])]) == {"": short, "iterations=1600": long}
