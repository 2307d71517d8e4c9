"""`eairl reproduce` and `eairl report`: the paper's experiments, in small."""

import json
import re

import numpy as np
import pytest

from eairl_jax import Lanes
from eairl_jax.experiments.commands import reproduce
from eairl_jax.experiments.paper import plan, results, tables
from eairl_jax.experiments.paper.plan import Planned


def _plan(monkeypatch, experiments):
    for module in (plan, reproduce):
        monkeypatch.setattr(module, "EXPERIMENTS", experiments)


def test_reproduce_trains_what_is_missing(tmp_path, tiny, monkeypatch, capsys, run):
    entries = [Planned(task, "bc") for task in ("pendulum", "point_maze_left", "ant")]
    _plan(monkeypatch, {"table2": entries})
    of_cloning = tuple(a for a in tiny if not a.startswith(("history", "empowerment", "hidden")))
    monkeypatch.setattr(reproduce, "short", lambda quick: of_cloning)
    arguments = ["reproduce", "table2", "--quick", "--out", tmp_path]  # of these tasks the ant is not a quick one
    assert run(*arguments) == 0
    printed = capsys.readouterr().out
    assert "table2: pendulum, 2 seeds" in printed
    assert "table2: pendulum, 2 seeds" in (tmp_path / "index.html").read_text()
    rows = json.loads((tmp_path / "table2.json").read_text())["rows"]
    assert [(r["name"], r["task"], r.get("target"), r["seeds"]) for r in rows] == [
        ("bc", "point_maze_left", None, [20, 21]), ("bc", "pendulum", None, [20, 21]),
    ]  # fmt: skip
    assert rows[1]["settings"]["config"]["method"] == "bc"
    assert rows[0]["machine"]["versions"]["jax"]
    # Only the row that was lost is trained again.
    (tmp_path / "imitate-pendulum-bc" / "summary.json").unlink()
    monkeypatch.setattr("eairl_jax.Lanes.run", lambda *_: pytest.fail("trained again"))
    assert run(*arguments) == 0
    again = json.loads((tmp_path / "table2.json").read_text())["rows"]
    assert [r["returns"] for r in again] == [r["returns"] for r in rows]
    # Rows of other seeds or settings are not replaced.
    capsys.readouterr()
    with monkeypatch.context() as patch:
        patch.setattr(plan, "QUICK_SEEDS", 1)
        assert run(*arguments) == 2
        assert "holds bc of point_maze_left with seeds 20 to 21" in capsys.readouterr().err
    monkeypatch.setattr(reproduce, "short", lambda quick: (*of_cloning, "policy_lr=0.5"))
    assert run(*arguments) == 2
    assert "holds bc of point_maze_left with other settings" in capsys.readouterr().err


def test_a_seed_that_diverges_stops_the_tables_or_is_dropped(tmp_path, tiny, monkeypatch, capsys, run):
    _plan(monkeypatch, {"table2": [Planned("pendulum", "bc")]})
    of_cloning = tuple(a for a in tiny if not a.startswith(("history", "empowerment", "hidden")))
    monkeypatch.setattr(reproduce, "short", lambda quick: of_cloning)
    run_lanes = Lanes.run

    def poisoned(self, state, length, check=True):
        state, metrics = run_lanes(self, state, length, check)
        name = next(name for name in metrics if name != "true_return")
        metrics[name] = np.where([[False], [True]], np.nan, metrics[name])
        return state, metrics

    monkeypatch.setattr(Lanes, "run", poisoned)
    arguments = ["reproduce", "table2", "--quick", "--out", tmp_path]
    assert run(*arguments) == 1
    assert "(imitate, expert, sweep, transfer, reproduce) with --on-nan skip" in capsys.readouterr().err
    assert run(*arguments, "--on-nan", "skip") == 0
    assert "bc: mean of 1 of 2 seeds; dropped: seed 21" in " ".join(capsys.readouterr().out.split())
    (row,) = results.load(tmp_path / "table2.json")
    assert (row.seeds, row.count, len(row.returns)) == ([20], 2, 1)
    (table,) = tables.tables([row], {})
    assert next(cells for name, cells in table.lines if name == "behaviour cloning")[0].ours.endswith(", 1 of 2 seeds")
    # The dropped seed counts as trained.
    monkeypatch.setattr(Lanes, "run", lambda *_: pytest.fail("trained again"))
    assert run(*arguments) == 0


@pytest.mark.slow
def test_reproduce_draws_and_reports(tmp_path, tiny, monkeypatch, capsys, run):
    pair = ("point_maze_left", "point_maze_right")
    eairl = [Planned(pair[0], "eairl", "default", pair[1], rule) for rule in ("last", "policy", "random")]
    changed = Planned(pair[0], "eairl", "default", pair[1], settings=("lambda_i=0",))
    retrained = Planned(pair[0], "eairl", "default", pair[1], retrain_settings=("entropy_weight=1",))
    _plan(monkeypatch, {table: [] for table in plan.EXPERIMENTS} | {"table1": eairl, "ablations": [changed, retrained]})
    monkeypatch.setattr(reproduce, "short", lambda quick: tiny[:2] + tiny[-2:])
    monkeypatch.setattr("eairl_jax.experiments.paper.reward_distance.TRANSITIONS", 16)
    assert run("reproduce", "all", "--quick", "--out", tmp_path) == 0
    rows = json.loads((tmp_path / "table1.json").read_text())["rows"]
    assert [(r["rule"], r.get("target")) for r in rows] == [
        ("last", pair[1]), ("policy", pair[1]), ("random", pair[1]),
    ]  # fmt: skip
    last, policy, random = rows
    assert set(last["closeness"]) == {"source", "target"}
    assert len(last["closeness"]["target"]["epic"]) == 2
    # What the kept restarts are worth to the reward at the end.
    assert last["closeness"]["target"]["worth, retrained"] == last["learned_rewards"]
    # And what other behaviours are worth to it.
    trained = last["diagnosis"]["behaviours"]["trained on the reward"]
    assert trained == {"learned": last["learned_rewards"], "true": last["returns"]}
    assert len(last["diagnosis"]["verdicts"]) == 2
    assert "diagnosis" not in policy
    # The policy was moved as it was, and the random reward is that of before learning.
    assert "curve" not in policy
    assert random["chosen_iterations"] == [0, 0]
    # The mazes differ by their barrier alone, which hardly anybody has reached after so little training.
    np.testing.assert_allclose(policy["returns"], last["imitation_returns"], rtol=0.2)
    assert (tmp_path / "figure2.png").stat().st_size > 10_000
    assert (tmp_path / "appendix-c-point_maze_left.png").stat().st_size > 10_000
    # What shares a learning comes together.
    retrained_row, changed_row = json.loads((tmp_path / "ablations.json").read_text())["rows"]
    assert changed_row["name"] == "eairl-sa+lambda_i=0"
    assert [r["is_published"] for r in (last, changed_row, retrained_row)] == [True, False, False]
    # Retrained by other settings, on the reward that the table's row learned.
    assert retrained_row["name"] == "eairl-sa+retrain_entropy_weight=1"
    assert retrained_row["retrain_settings"]["retrain_hparams"]["entropy_weight"] == 1
    assert retrained_row["imitation_returns"] == last["imitation_returns"]
    assert retrained_row["returns"] != last["returns"]
    assert len(list(tmp_path.glob("learn-*"))) == 2
    page = tmp_path / "report.html"
    assert run("report", "--results", tmp_path, "--out", page) == 0
    text = page.read_text()
    assert "point_maze_left to point_maze_right" in text
    assert "EAIRL, lambda_i=0" in text
    assert not re.search(r'(src|href)="http', text)
    # Nothing is trained twice, and the second page is the first.
    monkeypatch.setattr("eairl_jax.Lanes.run", lambda *_: pytest.fail("trained again"))
    assert run("reproduce", "all", "--quick", "--out", tmp_path) == 0
    assert run("report", "--results", tmp_path, "--out", page) == 0
    assert page.read_text() == text


@pytest.mark.parametrize("table", plan.EXPERIMENTS)
def test_the_committed_results_have_the_settings_of_the_plan(table):
    """A recipe that changes makes its results old: they have to be measured again, or removed."""
    path, planned = results.FOLDER / f"{table}.json", plan.EXPERIMENTS[table]
    experiments = {each.identity: reproduce.build(each, 5, quick=False) for each in planned}
    committed = results.load(path)
    assert {result.identity for result in committed} <= set(experiments)
    assert not [result.command_line for result in committed if " /" in result.command_line], "a path of one machine"
    reproduce.refuse_other_results(path, experiments)


def test_an_experiment_without_the_task_is_refused(capsys, run):
    assert run("reproduce", "table1", "--task", "pendulum") == 2
    assert "--task pendulum: table1 has ant, point_maze_left, point_maze_right" in capsys.readouterr().err
