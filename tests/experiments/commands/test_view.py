"""`eairl view`: an episode to look at, with pictures or without."""


def test_an_episode_of_a_seed_can_be_looked_at(finished, tmp_path, tiny, run, capsys, monkeypatch, unchanged):
    monkeypatch.setenv("MUJOCO_GL", "disable")
    with unchanged(finished):  # reading writes nothing
        assert run("view", finished, "--seed", 1, "--out", tmp_path / "view") == 0
    printed = capsys.readouterr().out
    assert "seed 1: return -" in printed
    assert "no pictures: this machine cannot draw with OpenGL" in printed
    assert [path.name for path in (tmp_path / "view").iterdir()] == ["episode.html"]
    assert run("view", finished, "--seed", 7) == 2
    assert "--seed 7: the run has seeds 0, 1" in capsys.readouterr().err
