"""A run's folder belongs to one run and one process, and nothing in it or beside it is lost."""

import json

import numpy as np
import pytest

from eairl_jax import InputError
from eairl_jax.experiments.pipeline.run_folder import RunFolder, check_writable, settings_digest

LABELS = [{"seed": 0}, {"seed": 1}]


def chunk(folder, first, length=2):
    """Appends iterations, each metric equal to its iteration."""
    values = np.tile(first + 1 + np.arange(length, dtype=float), (2, 1))
    folder.append_metrics(first, 10, LABELS, {"b": values, "a": -values})


def test_two_trainings_in_one_folder_are_refused(tmp_path):
    first, second = RunFolder(tmp_path, {}), RunFolder(tmp_path, {})
    with first.locked(), pytest.raises(InputError, match="another process is training"), second.locked():
        pytest.fail("both hold it")
    with second.locked():  # it is free again
        pass


@pytest.mark.parametrize("left", [".writable", "config.json.part"])
def test_a_folder_that_a_killed_process_was_about_to_claim_can_be_claimed(tmp_path, left):
    (tmp_path / left).write_text('{"sett')
    RunFolder(tmp_path, {"task": "pendulum"})
    assert [path.name for path in tmp_path.iterdir()] == ["config.json"]


def test_what_a_killed_process_has_left_of_a_file_is_removed(tmp_path):
    """A run that needs nothing more than its end does not write each of its files again."""
    folder = RunFolder(tmp_path / "run", {"task": "t"})
    folder.prepare()
    folder.add_seconds(run_seconds=1.0)
    (folder.path / "seconds.json.part").write_text("{")
    with folder.locked():
        assert folder.seconds()["run_seconds"] == 1.0
        assert not list(folder.path.glob("*.part"))


def test_whether_a_file_can_be_written_changes_none(tmp_path):
    (tmp_path / "empty").write_text("")
    (tmp_path / "full").write_text("kept")
    for name in ("empty", "full", "new"):
        check_writable(tmp_path / name)
    assert (tmp_path / "empty").exists()
    assert (tmp_path / "full").read_text() == "kept"
    assert not (tmp_path / "new").exists()
    with pytest.raises(InputError, match="cannot write"):
        check_writable(tmp_path / "full" / "below")


def test_metrics_are_appended_and_read_as_curves(tmp_path):
    folder = RunFolder(tmp_path, {})
    chunk(folder, 0)
    before = (tmp_path / "metrics.csv").read_bytes()
    chunk(folder, 2)
    after = (tmp_path / "metrics.csv").read_bytes()
    assert after.startswith(before), "what was written is not written again"
    assert after.splitlines()[0] == b"seed,iteration,env_steps,a,b"
    assert [line["env_steps"] for line in folder.metrics()] == ["10", "10", "20", "20", "30", "30", "40", "40"]
    np.testing.assert_array_equal(folder.curve("b", 2), [[1, 2, 3, 4]] * 2)


@pytest.mark.parametrize("torn", ["", "1,4", "1,40,400,-4.0,4.0\r\n0,5"])
def test_lines_of_a_lost_chunk_are_dropped(tmp_path, torn):
    """A kill between the metrics and the checkpoint leaves lines, the last one perhaps torn."""
    folder = RunFolder(tmp_path, {})
    chunk(folder, 0)
    kept = (tmp_path / "metrics.csv").read_bytes()
    chunk(folder, 2)
    with open(tmp_path / "metrics.csv", "a", newline="") as f:
        f.write(torn)
    folder.keep_metrics(4, LABELS)
    assert (tmp_path / "metrics.csv").read_bytes() == kept
    folder.keep_metrics(0, LABELS)
    assert not (tmp_path / "metrics.csv").exists()


def edited(change):
    """Changes the text of a file."""
    return lambda path: path.write_bytes(change(path.read_bytes()))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda path: path.unlink(), "is missing, and with it the 4 lines before the last checkpoint"),
        (edited(lambda x: x.replace(b"seed", b"lane", 1)), "its first line is not seed,iteration,env_steps"),
        (edited(lambda x: x[: x.rindex(b"1,2,20")]), "has 3 lines of metrics, and the last checkpoint 4"),
        (edited(lambda x: x.replace(b"1,2,20", b"1,9,20")), "line 5: expected the metrics of a lane"),
        (edited(lambda x: x.replace(b"0,1,10,-1,1", b"0,1,10,-1")), "line 2: expected the metrics"),
        (edited(lambda x: x.replace(b"0,1,10,-1,1", b"0,1,10,-1,x")), "line 2: expected the metrics"),
        (lambda path: path.write_bytes(b"\xff\xfe\x00"), "is no text"),
        (lambda path: path.write_bytes(b""), "its first line is not"),
    ],
    ids=["gone", "columns", "cut", "another iteration", "a short line", "a word", "bytes", "empty"],
)
def test_metrics_that_are_not_what_was_written_are_refused(tmp_path, damage, message):
    folder = RunFolder(tmp_path, {})
    chunk(folder, 0)
    damage(tmp_path / "metrics.csv")
    with pytest.raises(InputError, match=message):
        folder.keep_metrics(4, LABELS)


def test_the_mark_that_an_editor_adds_is_taken_away(tmp_path):
    folder = RunFolder(tmp_path, {})
    chunk(folder, 0)
    path = tmp_path / "metrics.csv"
    kept = path.read_bytes()
    path.write_bytes(b"\xef\xbb\xbf" + kept)
    folder.keep_metrics(4, LABELS)
    assert path.read_bytes() == kept


def test_a_chunk_with_other_columns_is_refused(tmp_path):
    folder = RunFolder(tmp_path, {})
    chunk(folder, 0)
    with pytest.raises(InputError, match=r"has other columns than this training writes \(b, c\)"):
        folder.append_metrics(2, 10, LABELS, {"a": np.zeros((2, 2)), "c": np.zeros((2, 2))})


def test_a_folder_of_another_run_is_refused(tmp_path):
    RunFolder(tmp_path / "run", {"seeds": [0, 1], "config": {"gamma": 1}})
    RunFolder(tmp_path / "run", {"seeds": [0, 1], "config": {"gamma": 1}})
    with pytest.raises(InputError, match=r"different run \(seeds: there \[0, 1\], here \[0\]\)"):
        RunFolder(tmp_path / "run", {"seeds": [0], "config": {"gamma": 1}})
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("")
    with pytest.raises(InputError, match="no run's folder"):
        RunFolder(tmp_path / "other", {})
    with pytest.raises(InputError, match="cannot write"):
        RunFolder(tmp_path / "other" / "thesis.tex" / "run", {})


def test_a_setting_that_is_new_leaves_an_older_run_what_it_was(tmp_path):
    settings = {"task": "ant", "config": {"actions": "sampled", "iterations": 7}}
    older = {"task": "ant", "config": {"iterations": 7}}  # a version wrote it that did not know `actions`
    assert settings_digest(older) == settings_digest(settings)
    RunFolder(tmp_path, older)
    RunFolder(tmp_path, settings)
    settings["config"]["actions"] = "clipped"
    assert settings_digest(older) != settings_digest(settings)
    with pytest.raises(InputError, match=r"config.actions: there 'sampled', here 'clipped'"):
        RunFolder(tmp_path, settings)


def test_seconds_add_up_over_sessions_and_phases(tmp_path):
    folder = RunFolder(tmp_path / "run", {})
    folder.add_seconds(compile_seconds=2.0)
    folder.add_seconds(run_seconds=3.0)
    RunFolder(tmp_path / "run" / "source_retrain", {}).add_seconds(run_seconds=4.0)
    assert folder.seconds() == {"compile_seconds": 2.0, "run_seconds": 7.0}
    folder.write_summary({"mean": 1.0})
    assert folder.summary() == json.loads((tmp_path / "run" / "summary.json").read_text()) == {"mean": 1.0}


def test_a_run_of_a_version_without_trials_is_continued_without_trials(tmp_path):
    RunFolder(tmp_path, {"target": "ant", "restarts": 1})
    RunFolder(tmp_path, {"target": "ant", "restarts": 1, "trials": 0, "trial_iterations": 0})
    with pytest.raises(InputError, match="trials: there 0, here 16"):
        RunFolder(tmp_path, {"target": "ant", "restarts": 1, "trials": 16, "trial_iterations": 20})
