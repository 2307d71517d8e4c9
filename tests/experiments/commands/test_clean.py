"""`eairl clean`: what it says (`pipeline/test_cleaning.py` tests what it removes)."""


def test_a_folder_is_needed(tmp_path, run, capsys):
    assert run("clean", tmp_path / "nowhere") == 2
    assert "no folder" in capsys.readouterr().err
    assert run("clean", tmp_path) == 0
    assert "no checkpoints in" in capsys.readouterr().out


def test_what_can_be_freed_is_said(finished, run, table, capsys):
    size = sum(path.stat().st_size for path in (finished / "checkpoints").rglob("*") if path.is_file())
    assert run("clean", finished.parent) == 0
    printed = table(capsys)
    assert f"--yes` frees {size / 1e6:.1f} MB" in printed
    (finished / "summary.json").unlink()
    assert run("clean", finished.parent) == 0
    assert "nothing can be removed" in table(capsys)
