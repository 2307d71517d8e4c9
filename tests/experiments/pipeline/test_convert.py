"""`eairl demos TASK --from SOURCE --to DEST`: what is written, what is said, and what is refused."""

import json

import numpy as np
import pytest

from eairl_jax import demonstrations
from eairl_jax.experiments.pipeline.places import shipped_demonstrations


@pytest.fixture
def flat_file(tmp_path):
    """Two pendulum episodes of 200 steps in flat columns with the names of D4RL, one action outside its bounds."""
    demos = demonstrations.load(shipped_demonstrations("pendulum"))
    rows = slice(0, 400)
    action = np.clip(demos.action[rows], -2, 2)
    action[7] = 3.0
    path = tmp_path / "d4rl.npz"
    np.savez(
        path,
        observations=demos.obs[rows].astype(np.float64),
        next_observations=demos.next_obs[rows].astype(np.float64),
        actions=action,
        rewards=demos.reward[rows],
        terminals=np.zeros(400),
        timeouts=np.arange(400) % 200 == 199,
    )
    return path


@pytest.fixture
def here(monkeypatch, tmp_path):
    """An empty folder that the command is run in."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


def test_columns_become_demonstrations_with_their_provenance(flat_file, here, run, capsys):
    assert run("demos", "pendulum", "--from", flat_file) == 0
    said = capsys.readouterr().out
    assert f"{flat_file} (npz) has 2 episodes of 200 steps, 400 steps in all." in said
    assert "Converted to float32: obs from float64, next_obs from float64." in said
    assert "1 of 400 steps have an action outside [-2, 2], the largest of size 3." in said
    assert "Written to demos/pendulum.npz, with pendulum.json beside it." in said
    path = here / "demos" / "pendulum.npz"
    demos = demonstrations.load(path, "pendulum", 3, 1)
    whole = demonstrations.load(shipped_demonstrations("pendulum"))
    np.testing.assert_array_equal(demos.obs, whole.obs[:400])
    provenance = demonstrations.provenance(path)
    assert provenance["command_line"] == f"eairl demos pendulum --from {flat_file}"
    assert provenance["expert_return"] == pytest.approx(demonstrations.returns(demos).mean())
    assert provenance["facts"]["outside"] == 1
    assert "random_return" not in provenance


def test_the_scores_of_a_file_of_this_library_are_kept(here, run, capsys):
    assert run("demos", "pendulum", "--from", "shipped", "--max-episodes", 3, "--to", "few.npz") == 0
    before = demonstrations.provenance(shipped_demonstrations("pendulum"))
    after = demonstrations.provenance(here / "few.npz")
    for name in ("expert_return", "random_return", "score_episodes"):
        assert after[name] == before[name]
    assert after["lengths"] == [200] * 3
    assert "eairl imitate pendulum --demos few.npz" in capsys.readouterr().out


def test_episodes_are_cut_at_the_time_limit_of_the_task(flat_file, here, run, capsys):
    with np.load(flat_file) as arrays:
        columns = {name: x for name, x in arrays.items() if name != "timeouts"}
        whole = arrays["next_observations"][:-1] == arrays["observations"][1:]
    columns["observations"][200] = columns["next_observations"][199]  # one episode of 400 steps
    np.savez(here / "long.npz", **columns, timeouts=np.arange(400) == 399)
    assert not whole.all()
    assert run("demos", "pendulum", "--from", "long.npz") == 0
    said = capsys.readouterr().out
    assert "1 episode lasted longer than the time limit, and lost the steps after it." in said
    assert demonstrations.load("demos/pendulum.npz").lengths.tolist() == [200]


@pytest.mark.parametrize("option", ["--to", "--out"])
@pytest.mark.parametrize("name", ["x.json", "x.hdf5", "x"])
def test_another_suffix_is_kept_and_said(flat_file, here, run, capsys, option, name):
    assert run("demos", "pendulum", "--from", flat_file, option, name) == 0
    assert demonstrations.load(here / f"{name}.npz").lengths.tolist() == [200, 200]
    assert json.loads((here / f"{name}.json").read_text())["episodes"] == 2
    assert f"The suffix .npz was appended to {name}." in capsys.readouterr().out


def test_observations_alone_become_demonstrations_without_scores(flat_file, here, run, capsys):
    with np.load(flat_file) as arrays:
        np.savez(here / "obs.npz", **{n: arrays[n] for n in ("observations", "next_observations", "timeouts")})
    assert run("demos", "pendulum", "--from", "obs.npz") == 0
    said = capsys.readouterr().out
    assert "There are no rewards." in said
    assert "There are no actions." in said
    assert "eairl imitate pendulum --method gaifo --demos demos/pendulum.npz" in said
    demos = demonstrations.load("demos/pendulum.npz", "pendulum", 3, 1)
    assert demos.action is None
    assert demos.reward is None
    assert not {"expert_return", "returns"} & set(demonstrations.provenance("demos/pendulum.npz"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--from", "shipped", "--expert", "runs/x"], "--from reads demonstrations and --expert collects new ones"),
        (["--from", "shipped", "--to", "a.npz", "--out", "b.npz"], "--to and --out both name the file"),
        (["--to", "minari:x-v0"], "--to without --from: give the demonstrations with --from SOURCE"),
        (["--obs-key", "x", "--max-episodes", 3], "--obs-key, --max-episodes without --from"),
        (["--from", "none.npz"], "none.npz does not exist"),
        (["--from", "shipped", "--max-episodes", 0], "max_episodes is 0: expected at least 1"),
        (["--from", "shipped", "--to", "minari:x"], "is no name of a Minari data set"),
        (["--from", "shipped", "--to", "a.npz/b.npz"], "cannot write a.npz/b.npz"),
        (["--from", "shipped", "--obs-key", "state"], "has no entry 'state'"),
    ],
)
def test_contradictions_and_bad_places_are_refused(here, run, capsys, arguments, message):
    (here / "a.npz").write_text("a file")
    assert run("demos", "pendulum", *arguments) == 2
    assert message in capsys.readouterr().err.replace("\n", " ")
    assert [path.name for path in here.rglob("*") if path.is_file()] == ["a.npz"]


def test_demonstrations_of_another_task_are_refused(flat_file, here, run, capsys):
    assert run("demos", "swimmer", "--from", flat_file) == 2
    assert "obs has shape (400, 3), expected (400, 8)" in capsys.readouterr().err
    assert run("demos", "swimmer", "--from", shipped_demonstrations("pendulum")) == 2
    assert "demonstrates 'pendulum', not 'swimmer'" in capsys.readouterr().err
    assert not list(here.rglob("*.npz"))


def test_a_source_is_never_overwritten(here, run, capsys):
    assert run("demos", "pendulum", "--from", "shipped") == 0
    before = (here / "demos" / "pendulum.npz").read_bytes()
    assert run("demos", "pendulum", "--from", "demos/pendulum.npz") == 2
    assert "--from and the file to write are the same" in capsys.readouterr().err
    assert (here / "demos" / "pendulum.npz").read_bytes() == before


@pytest.mark.extras
def test_ours_go_to_minari_and_return(here, run, capsys, monkeypatch):
    pytest.importorskip("h5py")
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(here / "root"))
    assert run("demos", "pendulum", "--from", "shipped", "--to", "minari:pendulum/expert-v0") == 0
    assert "minari.load_dataset('pendulum/expert-v0') reads it." in capsys.readouterr().out
    metadata = minari.load_dataset("pendulum/expert-v0").storage.metadata
    before = demonstrations.provenance(shipped_demonstrations("pendulum"))
    assert metadata["ref_min_score"] == before["random_return"]
    assert metadata["ref_max_score"] == before["expert_return"]
    assert metadata["eairl_provenance"]["task"] == "pendulum"
    assert run("demos", "pendulum", "--from", "minari:pendulum/expert-v0") == 0
    ours = demonstrations.load("demos/pendulum.npz")
    for x, y in zip(ours, demonstrations.load(shipped_demonstrations("pendulum")), strict=True):
        np.testing.assert_array_equal(x, y)
    assert run("demos", "pendulum", "--from", "shipped", "--to", "minari:pendulum/expert-v0") == 2
    assert "exists: choose another name or version" in capsys.readouterr().err
