"""What Optuna proposes, and the database of the finished trials."""

import pytest

from eairl_jax import InputError
from eairl_jax.experiments.pipeline.ranges import Interval, Listed, rounded
from eairl_jax.experiments.pipeline.search import Database, Plan, Trial, best, proposed

DOMAINS = {"lambda_i": Interval(1e-4, 1.0, True), "beta": Listed((0.0, 1.0)), "gamma": Interval(0.9, 1.0)}
PLAN = Plan(DOMAINS, 16, 4, seed=3)
SETTINGS = {"task": "pendulum", "search": {name: str(domain) for name, domain in DOMAINS.items()}}


def test_the_best_comes_first_and_what_diverged_does_not_count():
    trials = [Trial(n, {}, [], score) for n, score in enumerate((0.1, None, -3.0, 0.9))]
    assert [trial.number for trial in best(trials)] == [3, 0, 2]
    assert best(trials[1:2]) == []


@pytest.mark.parametrize("trials, generation", [(0, 4), (-4, 4), (6, 4), (3, 4), (4, 0)])
def test_an_impossible_number_of_trials_is_refused(trials, generation):
    with pytest.raises(InputError, match="--generation"):
        Plan(DOMAINS, trials, generation, 0)


def filled(path, count, plan=PLAN):
    """A database with trials whose best has a lambda_i of 0.1; every third has diverged."""
    path.parent.mkdir(exist_ok=True)
    database = Database(path, SETTINGS)
    while (done := len(database.finished())) < count:
        number = done // plan.generation
        points = proposed(plan, database.finished()[: number * plan.generation], number)
        point = points[done % plan.generation]
        score = None if done % 3 == 2 else -abs(point["lambda_i"] - 0.1)
        database.add(plan, Trial(done, point, [] if score is None else [score], score))
    return database


@pytest.mark.extras
def test_proposals_follow_from_the_finished_trials_and_the_seed(tmp_path):
    pytest.importorskip("optuna")
    whole = filled(tmp_path / "whole" / "search.db", 16).finished()
    for point in (trial.params for trial in whole):
        assert 1e-4 <= point["lambda_i"] <= 1
        assert point["beta"] in (0.0, 1.0)
        assert point["gamma"] == rounded(point["gamma"])
    for count in (3, 4, 9, 16):  # a search that is stopped after any trial comes to the same trials
        parts = filled(tmp_path / "parts" / "search.db", count).finished()
        assert [(t.params, t.value, t.state) for t in parts] == [(t.params, t.value, t.state) for t in whole[:count]]
    assert [trial.value is None for trial in whole] == [n % 3 == 2 for n in range(16)]
    other = Plan(DOMAINS, 16, 4, seed=4)
    assert proposed(other, [], 0) != proposed(PLAN, [], 0)
    assert proposed(PLAN, [], 1) != proposed(PLAN, [], 0)


@pytest.mark.extras
def test_a_database_of_something_else_is_refused(tmp_path):
    pytest.importorskip("optuna")
    Database(tmp_path / "search.db", SETTINGS)
    with pytest.raises(InputError, match="belongs to a different run"):
        Database(tmp_path / "search.db", SETTINGS | {"task": "ant"})
    other = tmp_path / "other"
    other.mkdir()
    (other / "config.json").write_text("{}")
    with pytest.raises(InputError, match=r"holds files but no search\.db"):
        Database(other / "search.db", SETTINGS)
    (other / "search.db").write_bytes(bytes(range(256)) * 20)
    with pytest.raises(InputError, match="file is not a database"):
        Database(other / "search.db", SETTINGS)
