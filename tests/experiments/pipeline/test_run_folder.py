"""A run's folder is one process's, and nothing in it or beside it is lost."""

import pytest

from eairl_jax import InputError
from eairl_jax.experiments.pipeline.run_folder import RunFolder, writable


def test_two_trainings_in_one_folder_are_refused(tmp_path):
    first, second = RunFolder(tmp_path, {}), RunFolder(tmp_path, {})
    with first.alone(), pytest.raises(InputError, match="another process is training"), second.alone():
        pytest.fail("both hold it")
    with second.alone():  # it is free again
        pass


def test_whether_a_file_can_be_written_changes_none(tmp_path):
    (tmp_path / "empty").write_text("")
    (tmp_path / "full").write_text("kept")
    for name in ("empty", "full", "new"):
        writable(tmp_path / name)
    assert (tmp_path / "empty").exists()
    assert (tmp_path / "full").read_text() == "kept"
    assert not (tmp_path / "new").exists()
    with pytest.raises(InputError, match="cannot write"):
        writable(tmp_path / "full" / "below")
