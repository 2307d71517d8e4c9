"""Whole commands on tiny settings: what they leave, how they resume, what they refuse."""

import csv
import json

import numpy as np
import pytest

from eairl_jax import Checkpoints, load_reward
from experiments import cli, training


def run(*arguments):
    """Runs `eairl` and returns its exit code."""
    try:
        cli.main([str(a) for a in arguments])
    except SystemExit as e:
        return e.code
    return 0


def rl_settings(tiny):
    """Those of `tiny` that retraining has too."""
    return [a for a in tiny if not a.startswith(("history", "discriminator", "empowerment"))]


def imitate(out, tiny):
    return run("imitate", "pendulum", "--seeds", 2, "--out", out, "--set", *tiny)


def test_imitate_leaves_what_it_promises(tmp_path, tiny, capsys):
    assert imitate(tmp_path / "run", tiny) == 0
    folder = tmp_path / "run"
    summary = json.loads((folder / "summary.json").read_text())
    promised = ["command", "task", "target", "method", "seeds", "env_steps", "compile_seconds", "run_seconds",
                "expert", "random", "returns", "mean", "std", "normalized"]  # fmt: skip
    assert set(promised) <= set(summary)
    assert summary["env_steps"] == 4 * 2 * 20
    scale = summary["expert"] - summary["random"]
    assert summary["normalized"] == pytest.approx((np.mean(summary["returns"]) - summary["random"]) / scale)
    with open(folder / "metrics.csv", newline="") as f:
        rows = list(csv.DictReader(f))
    assert [(r["seed"], r["iteration"]) for r in rows] == [(str(s), str(i)) for i in range(1, 5) for s in range(2)]
    wanted = {"true_return", "discriminator_loss", "accuracy", "reward_policy", "reward_expert", "empowerment", "l_i",
              "l_q", "kl", "entropy", "value_loss"}  # fmt: skip
    assert wanted <= set(rows[0])
    assert (folder / "curves.png").read_bytes().startswith(b"\x89PNG")
    assert "normalized" in capsys.readouterr().out
    reward = load_reward(folder / "reward", 3, 1)
    assert np.isfinite(reward(np.ones(3), np.ones(1), seed=1))
    # The same command again computes nothing and prints the same score.
    before = (folder / "metrics.csv").stat().st_mtime_ns
    assert imitate(folder, tiny) == 0
    assert (folder / "metrics.csv").stat().st_mtime_ns == before


def test_a_killed_run_goes_on_bit_identically(tmp_path, tiny, monkeypatch):
    assert imitate(tmp_path / "whole", tiny) == 0

    class Killed(Checkpoints):
        """Dies before the second checkpoint: the second chunk's metrics are on disk, its state is not."""

        def save(self, iteration, state):
            if iteration == 4:
                raise KeyboardInterrupt
            super().save(iteration, state)

    monkeypatch.setattr(training, "Checkpoints", Killed)
    assert imitate(tmp_path / "killed", tiny) == 130
    assert Checkpoints(tmp_path / "killed" / "checkpoints").latest() == 2
    monkeypatch.setattr(training, "Checkpoints", Checkpoints)
    assert imitate(tmp_path / "killed", tiny) == 0
    for name in ("metrics.csv", "reward/reward.npz"):
        assert (tmp_path / "killed" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name
    states = [read_state(tmp_path / name) for name in ("whole", "killed")]
    assert states[0].keys() == states[1].keys()
    for name, leaf in states[0].items():
        np.testing.assert_array_equal(leaf, states[1][name], err_msg=name)


def read_state(folder):
    """The last checkpoint's leaves."""
    import orbax.checkpoint as ocp

    manager = ocp.CheckpointManager((folder / "checkpoints").resolve())
    return manager.restore(4, args=ocp.args.StandardRestore())


def test_transfer_uses_the_source_alone_to_choose(tmp_path, tiny):
    arguments = ["transfer", "point_maze_left", "point_maze_right", "--reward-form", "separable", "--seeds", 2]
    settings = ["--set", *tiny, "--retrain-set", *rl_settings(tiny)]
    assert run(*arguments, "--out", tmp_path / "run", *settings) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["target"] == "point_maze_right"
    source = np.array(summary["source_returns"])  # [snapshot, seed]
    chosen = [summary["snapshots"][best] for best in source.argmax(axis=0)]
    assert summary["chosen_iterations"] == chosen
    reward = load_reward(tmp_path / "run" / "reward")
    assert reward.description["iterations"] == chosen
    for seed, iteration in enumerate(chosen):
        snapshot = load_reward(tmp_path / "run" / "imitate" / "snapshots" / f"{iteration:06d}")
        obs, action = np.array([0.1, 0.2]), np.array([0.3, -0.4])
        assert reward(obs, action, seed) == snapshot(obs, action, seed)
    assert len(summary["ceiling"]) == 2
    # And the artefact can be put to use again.
    again = ["transfer", "point_maze_left", "point_maze_right", "--reward", tmp_path / "run" / "reward"]
    assert run(*again, "--out", tmp_path / "again", "--retrain-set", *rl_settings(tiny)) == 0
    reused = json.loads((tmp_path / "again" / "summary.json").read_text())
    assert reused["returns"] == summary["returns"]


def test_expert_and_demos_make_what_imitate_reads(tmp_path, tiny):
    assert run("expert", "pendulum", "--seeds", 2, "--out", tmp_path / "expert", "--set", *rl_settings(tiny)) == 0
    path = tmp_path / "pendulum.npz"
    assert run("demos", "pendulum", "--expert", tmp_path / "expert", "--episodes", 3, "--out", path) == 0
    provenance = json.loads(path.with_suffix(".json").read_text())
    with np.load(path, allow_pickle=False) as arrays:
        assert arrays["obs"].shape == (3, 200, 3)
        np.testing.assert_allclose(arrays["reward"].sum(axis=1), provenance["returns"], rtol=1e-5)
    assert provenance["expert"]["chosen_seed"] in (0, 1)
    arguments = ["imitate", "pendulum", "--seeds", 2, "--demos", path, "--out", tmp_path / "run", "--set", *tiny]
    assert run(*arguments) == 0
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["expert"] == provenance["expert_return"]


def test_nan_stops_the_run_and_keeps_the_last_good_checkpoint(tmp_path, tiny, monkeypatch, capsys):
    from eairl_jax import Lanes

    run_lanes = Lanes.run

    def poisoned(self, state, length):
        state, metrics = run_lanes(self, state, length)
        if (tmp_path / "run" / "snapshots" / "000002").exists():
            metrics["value_loss"] = metrics["value_loss"].copy()
            metrics["value_loss"][1, 1] = np.nan
        return state, metrics

    monkeypatch.setattr(Lanes, "run", poisoned)
    assert imitate(tmp_path / "run", tiny) == 1
    message = capsys.readouterr().err
    assert "value_loss" in message
    assert "iteration 4" in message
    assert Checkpoints(tmp_path / "run" / "checkpoints").latest() == 2


def damaged(folder, change):
    """A copy of the shipped pendulum demonstrations with one thing wrong."""
    from experiments.reference import shipped

    with np.load(shipped("pendulum")) as archive:
        arrays = change(dict(archive))
    path = folder / "damaged.npz"
    np.savez(path, **arrays)
    return path


REFUSED = {
    "unknown task": (["imitate", "pendulm"], "did you mean pendulum"),
    "unknown method": (["imitate", "pendulum", "--method", "eairll"], "did you mean eairl"),
    "unknown setting": (["imitate", "pendulum", "--set", "lamda_i=1"], "did you mean lambda_i"),
    "no value": (["imitate", "pendulum", "--set", "lambda_i"], "expected name=value"),
    "wrong type": (["imitate", "pendulum", "--set", "num_envs=many"], "expected something like num_envs="),
    "indivisible batch": (["imitate", "pendulum", "--set", "ppo_minibatches=7"], "divisor"),
    "negative rate": (["imitate", "pendulum", "--set", "policy_lr=-1"], "policy_lr"),
    "snapshots": (["imitate", "pendulum", "--set", "iterations=50"], "snapshot_every=25"),
    "no seeds": (["imitate", "pendulum", "--seeds", "0"], "at least 1"),
    "sizes": (["transfer", "pendulum", "point_maze_left"], "same sizes"),
    "unknown rule": (["transfer", "point_maze_left", "point_maze_right", "--rule", "best"], "source_retrain"),
    "unkept iteration": (["transfer", "point_maze_left", "point_maze_right", "--rule", "iteration=7"], "no snapshot"),
    "no reward": (["transfer", "point_maze_left", "point_maze_right", "--reward", "nowhere"], "reward.json"),
    "no expert": (["demos", "pendulum", "--expert", "nowhere"], "eairl expert pendulum"),
    "missing demonstrations": (["imitate", "pendulum", "--demos", "nowhere.npz"], "is not there"),
}


@pytest.mark.parametrize("arguments, hint", REFUSED.values(), ids=REFUSED)
def test_bad_input_is_one_clear_message(arguments, hint, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(*arguments) == 2
    error = capsys.readouterr().err
    assert hint in error
    assert "Traceback" not in error
    assert not list(tmp_path.iterdir()), "nothing is written before the input is checked"


DAMAGES = {
    "another task": (lambda a: a | {"task": np.asarray("ant")}, "ant"),
    "wrong shape": (lambda a: a | {"action": a["action"][:, :-1]}, "expected"),
    "NaN": (lambda a: a | {"obs": np.full_like(a["obs"], np.nan)}, "NaN or infinite at episode 0, step 0"),
    "missing array": (lambda a: {k: v for k, v in a.items() if k != "next_obs"}, "lacks next_obs"),
    "other sizes": (lambda a: a | {"obs": a["obs"][..., :2]}, "expected"),
}


@pytest.mark.parametrize("change, hint", DAMAGES.values(), ids=DAMAGES)
def test_damaged_demonstrations_are_refused(change, hint, tmp_path, capsys):
    assert run("imitate", "pendulum", "--demos", damaged(tmp_path, change), "--out", tmp_path / "run") == 2
    assert hint in capsys.readouterr().err


def test_a_folder_of_another_run_is_refused(tmp_path, tiny, capsys):
    assert imitate(tmp_path / "run", tiny) == 0
    assert run("imitate", "pendulum", "--seeds", 1, "--out", tmp_path / "run", "--set", *tiny) == 2
    assert "different run (seeds: there 2, here 1)" in capsys.readouterr().err
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("")
    assert imitate(tmp_path / "other", tiny) == 2
    assert "no run's folder" in capsys.readouterr().err


def test_a_disk_that_fails_is_reported_and_nothing_is_lost(tmp_path, tiny, monkeypatch, capsys):
    from experiments.folder import Folder

    def full(*_arguments, **_more):
        raise OSError(28, "No space left on device", "metrics.csv")

    with monkeypatch.context() as patch:
        patch.setattr(Folder, "append_metrics", full)
        assert imitate(tmp_path / "run", tiny) == 2
    assert "No space left" in capsys.readouterr().err
    assert imitate(tmp_path / "run", tiny) == 0
    (tmp_path / "file").write_text("")
    assert imitate(tmp_path / "file" / "run", tiny) == 2
    assert "cannot write" in capsys.readouterr().err
