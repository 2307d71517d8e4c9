"""Checkpoints that no command needs any more: which they are, and that nothing else is touched."""

import json
import shutil

import filelock
import pytest

from eairl_jax.experiments.pipeline import cleaning


def test_a_cleaned_run_keeps_its_results_and_its_policies(finished, run, imitate, tiny, capsys, unchanged):
    assert run("evaluate", finished, "--episodes", 2) == 0
    before = capsys.readouterr().out
    with unchanged(finished):  # without --yes nothing is removed
        assert run("clean", finished) == 0
    assert "would be removed" in capsys.readouterr().out
    others = {path for path in finished.rglob("*") if "checkpoints" not in path.parts}
    assert run("clean", finished, "--yes") == 0
    assert "removed" in capsys.readouterr().out
    assert {path for path in finished.rglob("*") if path.name != ".lock"} == {p for p in others if p.name != ".lock"}
    assert run("evaluate", finished, "--episodes", 2) == 0
    assert capsys.readouterr().out == before
    with unchanged(finished):
        assert imitate(finished, tiny) == 0  # reads its result
    metrics = (finished / "metrics.csv").read_bytes()
    assert imitate(finished, tiny, "--more", 2) == 2
    assert (finished / "metrics.csv").read_bytes() == metrics
    assert "has no checkpoints any more" in capsys.readouterr().err
    assert run("clean", finished, "--yes") == 0
    assert "no checkpoints in" in capsys.readouterr().out


def test_policies_are_kept_before_their_checkpoint_goes(finished):
    shutil.rmtree(finished / "policy")
    (held,) = cleaning.find(finished.parent)
    assert cleaning.remove(held) == ""
    assert (finished / "policy" / "policy.json").is_file()
    assert not (finished / "checkpoints").exists()


def change_summary(folder, **changes):
    path = folder / "summary.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def change_settings(folder, **changes):
    path = folder / "config.json"
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"settings": content["settings"] | changes}))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda folder: (folder / "summary.json").unlink(), "it is not finished"),
        (lambda folder: (folder / "checkpoints" / "6").mkdir(), "it goes on beyond its plan"),
        (lambda folder: (folder / "summary.json").write_text("{"), "summary.json"),
        (lambda folder: change_summary(folder, more_iterations="many"), "more_iterations"),
        (lambda folder: change_settings(folder, sweep=[{"beta": 1.0}]), "a sweep of an earlier version"),
    ],
)
def test_checkpoints_that_are_needed_stay(finished, run, capsys, change, reason):
    change(finished)
    assert run("clean", finished.parent, "--yes") == 0
    assert reason in " ".join(capsys.readouterr().out.split())
    assert (finished / "checkpoints" / "4").is_dir()


def test_seeds_that_are_being_added_and_links_keep_theirs(finished, tmp_path):
    """A run's other trainings, such as its trials, are over with it; added seeds may not be."""
    for name in ("trials", "more-seeds/2-2", "more-seeds/3-3"):
        shutil.copytree(finished / "checkpoints", finished / name / "checkpoints")
    (finished / "more-seeds" / "2-2" / "summary.json").write_text("{}")
    (finished / "linked").symlink_to(tmp_path)
    (held,) = cleaning.find(finished)
    names = {folder.relative_to(finished).as_posix() for folder in held.folders}
    assert names == {"checkpoints", "trials/checkpoints", "more-seeds/2-2/checkpoints"}
    with filelock.FileLock(finished / ".lock"):
        pass
    assert cleaning.remove(held) == ""
    assert [path.parent.name for path in finished.rglob("checkpoints")] == ["3-3"]


def test_a_run_that_trains_is_left_alone(finished, monkeypatch):
    (held,) = cleaning.find(finished)

    def busy(*_arguments, **_options):
        raise filelock.Timeout(str(finished / ".lock"))

    monkeypatch.setattr(filelock, "FileLock", busy)
    assert cleaning.remove(held) == "another process is training in it"
    assert (finished / "checkpoints" / "4").is_dir()
