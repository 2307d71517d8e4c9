"""Seeds that were added to a run: which groups it has, which are missing, and what they are together."""

import json
import shutil

import numpy as np
import pytest

from eairl_jax import load_policy, load_reward
from eairl_jax.experiments.pipeline import more_seeds, policies


def begin(path, group, is_finished=True):
    folder = more_seeds.folder(path, group)
    folder.mkdir(parents=True)
    if is_finished:
        (folder / "summary.json").write_text("{}")


@pytest.mark.parametrize(("count", "expected"), [(0, []), (3, [range(5, 8)])])
def test_a_run_without_added_seeds(tmp_path, count, expected):
    assert more_seeds.groups(tmp_path, range(5), count) == expected


@pytest.mark.parametrize(
    ("count", "expected"),
    [(0, [range(2, 4)]), (2, [range(2, 4), range(4, 12)]), (10, [range(2, 4), range(4, 12)]),
     (11, [range(2, 4), range(4, 12), range(12, 13)])],
)  # fmt: skip
def test_groups_that_were_begun_are_kept_and_the_rest_is_one_more(tmp_path, count, expected):
    begin(tmp_path, range(4, 12), is_finished=False)  # killed: it goes on when seeds are asked for
    begin(tmp_path, range(2, 4))
    (tmp_path / "more-seeds" / "notes-1").mkdir()
    assert more_seeds.groups(tmp_path, range(2), count) == expected
    assert more_seeds.finished(tmp_path) == [tmp_path / "more-seeds" / "2-3"]


def test_a_finished_run_goes_on_and_gets_more_seeds(finished, tiny, imitate, run, capsys, metrics_lines, unchanged):
    """Iterations beyond the plan, one more seed; the table, the summary, reward and policy hold all of it."""
    before = metrics_lines(finished)
    more = ("--more", "2", "--more-seeds", "1")
    assert imitate(finished, tiny, *more) == 0
    assert metrics_lines(finished)[: len(before)] == before
    assert [row["iteration"] for row in metrics_lines(finished)[len(before) :]] == ["5", "5", "6", "6"]
    summary = json.loads((finished / "summary.json").read_text())
    assert (summary["seeds"], summary["more_iterations"]) == ([0, 1, 2], 2)
    assert summary["env_steps"] == 6 * 2 * 20
    alone = json.loads((finished / "more-seeds" / "2-2" / "summary.json").read_text())
    assert summary["returns"][2:] == alone["returns"]
    reward, policy = load_reward(finished / "reward"), load_policy(finished / "policy")
    for artefact in (reward, policy):
        assert (artefact.description["seeds"], artefact.description["iterations"]) == ([0, 1, 2], [6, 6, 6])
    other = load_reward(finished / "more-seeds" / "2-2" / "reward")
    obs, action = np.ones(3, np.float32), np.ones(1, np.float32)
    assert reward(obs, action, seed=2) == other(obs, action, seed=0)
    assert policies.load(finished).seeds == [0, 1, 2]
    capsys.readouterr()
    with unchanged(finished):  # the same command, and the plain one, compute nothing
        assert imitate(finished, tiny, *more) == imitate(finished, tiny) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert printed.count("policy, 3 seeds") == 2
    assert printed.count("2 iterations beyond the plan, at the final rates") == 2
    assert run("runs", finished) == 0
    assert "seeds: 3" in capsys.readouterr().out
    # Killed on its way beyond the plan: the newest checkpoint counts, the one of the plan's end is gone.
    (finished / "summary.json").write_text(json.dumps(summary | {"more_iterations": 0}))
    shutil.rmtree(finished / "checkpoints" / "4")
    assert policies.load(finished).iteration == 6


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [("--more", 3, "--more 3: expected a multiple of snapshot_every = 2, for example --more 2"),
     ("--more", -2, "--more -2: expected a multiple"), ("--more-seeds", -1, "--more-seeds -1: expected 0 or more"),
     ("--more-seeds", 10**9, "expected 1 to")],
)  # fmt: skip
def test_impossible_additions_are_refused(finished, tiny, imitate, capsys, unchanged, option, value, message):
    with unchanged(finished):
        assert imitate(finished, tiny, option, value) == 2
    assert message in " ".join(capsys.readouterr().err.split())
