"""What only reads a run works where nothing can be written."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from eairl_jax import Checkpoints


def read_only_mount(folder: Path) -> bool:
    """Makes a folder read-only even for root; False where this is not allowed."""
    try:
        subprocess.run(["mount", "--bind", folder, folder], check=True, capture_output=True)
        subprocess.run(["mount", "-o", "remount,bind,ro", folder], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        return False
    return True


@pytest.fixture
def read_only(finished):
    """A finished run whose folder cannot be written, and whose pictures and policies were never made."""
    shutil.rmtree(finished / "policy")
    (finished / "curves.png").unlink()
    is_mounted = read_only_mount(finished)
    if not is_mounted:
        for path in [finished, *finished.rglob("*")]:
            path.chmod(0o555 if path.is_dir() else 0o444)
    if os.access(finished, os.W_OK):
        pytest.skip("this user writes everywhere")
    yield finished
    if is_mounted:
        subprocess.run(["umount", finished], check=True)
    else:
        for path in [finished, *finished.rglob("*")]:
            path.chmod(0o755)


def test_commands_that_read_need_no_leave_to_write(read_only, imitate, tiny, tmp_path, run, capsys):
    assert run("evaluate", read_only, "--episodes", 2) == 0
    assert run("export", read_only, "--what", "reward", "--out", tmp_path / "out") == 0
    assert run("runs", read_only) == 0
    assert imitate(read_only, tiny) == 0
    assert run("view", read_only) == 2
    assert "cannot write" in capsys.readouterr().err
    assert run("view", read_only, "--out", tmp_path / "view") == 0


def test_checkpoints_are_read_without_a_trace(finished):
    before = {path: path.stat().st_mtime_ns for path in finished.rglob("*")}
    checkpoints = Checkpoints(finished / "checkpoints", read_only=True)
    assert checkpoints.latest() == 4
    assert checkpoints.is_intact(4)
    assert {path: path.stat().st_mtime_ns for path in finished.rglob("*")} == before
