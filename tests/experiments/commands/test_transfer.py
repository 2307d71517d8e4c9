"""`eairl transfer`: from demonstrations to a score in another task."""

import json
import re

import numpy as np
import pytest

from eairl_jax import METHODS, load_policy, load_reward


def test_transfer_scores_a_chosen_reward(tmp_path, tiny, capsys, run, retrain_settings):
    arguments = ["transfer", "point_maze_left", "point_maze_right", "--reward-form", "separable", "--seeds", 2]
    settings = ["--set", *tiny, "--retrain-set", *retrain_settings]
    assert run(*arguments, "--rule", "last", "--out", tmp_path / "run", *settings) == 0
    (folder,), (learned,) = ((tmp_path / "run").glob(f"{name}-*") for name in ("transfer", "learn"))
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["target"] == "point_maze_right"
    chosen = summary["chosen_iterations"]
    assert chosen == [4, 4]
    reward = load_reward(folder / "reward")
    assert reward.description["iterations"] == chosen
    for seed, iteration in enumerate(chosen):
        snapshot = load_reward(learned / "snapshots" / f"{iteration:06d}")
        obs, action = np.array([0.1, 0.2]), np.array([0.3, -0.4])
        assert reward(obs, action, seed) == snapshot(obs, action, seed)
    assert len(summary["ceiling"]) == 2
    # The policies that were kept of the restarts can be scored again, also by the C engine.
    figures = tmp_path / "figures.json"
    assert run("evaluate", folder, "--engine", "c", "--episodes", 2, "--json", figures) == 0
    returns = json.loads(figures.read_text())["returns"]
    np.testing.assert_allclose(np.mean(returns["MJX"], axis=1), summary["returns"], rtol=1e-5)
    np.testing.assert_allclose(returns["C engine"], returns["MJX"], rtol=0.02)
    # And the artefact can be put to use again.
    assert run("transfer", "point_maze_right", "point_maze_left", "--reward", folder / "reward") == 2
    assert "was learned in point_maze_left, not in point_maze_right" in capsys.readouterr().err
    again = ["transfer", "point_maze_left", "point_maze_right", "--reward", folder / "reward"]
    assert run(*again, "--out", tmp_path / "again", "--retrain-set", *retrain_settings) == 0
    (folder,) = (tmp_path / "again").glob("reuse-*")
    reused = json.loads((folder / "summary.json").read_text())
    assert reused["returns"] == summary["returns"]


ARTEFACTS = {"reward": load_reward, "policy": load_policy}


def printed(capsys):
    return " ".join(capsys.readouterr().out.split())


@pytest.mark.slow
def test_a_seed_that_was_dropped_in_learning_has_no_part_in_what_follows(tmp_path, tiny, capsys, run, retrain_settings):
    arguments = ["transfer", "point_maze_left", "point_maze_right", "--reward-form", "separable", "--seeds", 2]
    settings, figures = ["--set", *tiny, "--retrain-set", *retrain_settings], tmp_path / "figures.json"
    assert run(*arguments, "--rule", "last", "--out", tmp_path / "run", *settings) == 0
    (folder,), (learned,) = ((tmp_path / "run").glob(f"{name}-*") for name in ("transfer", "learn"))
    summary = json.loads((folder / "summary.json").read_text())
    assert run("evaluate", folder, "--episodes", 2, "--json", figures) == 0
    returns = json.loads(figures.read_text())["returns"]
    reason = {"training": "learning", "quantity": "accuracy", "iteration": 2, "value": "nan"}
    (learned / "dropped.json").write_text(json.dumps({"dropped": [{"seed": 0} | reason]}))
    for path in (learned / "summary.json", folder / "summary.json", folder / "policy" / "policy.json"):
        path.unlink()
    capsys.readouterr()
    for _ in range(2):  # scored, and read
        assert run(*arguments, "--rule", "last", "--out", tmp_path / "run", *settings) == 0
        assert "dropped: seed 0 (accuracy became nan at iteration 2 of learning)" in printed(capsys)
    rest = json.loads((folder / "summary.json").read_text())
    assert rest["seeds"] == [1]
    for name in ("returns", "imitation_returns", "chosen_iterations", "learned_rewards", "learned_share"):
        np.testing.assert_allclose(rest[name], summary[name][1:], rtol=1e-5, err_msg=name)
    assert rest["ceiling"] == summary["ceiling"]
    assert [load(folder / name).description["seeds"] for name, load in ARTEFACTS.items()] == [[1], [1]]
    assert run("evaluate", folder, "--episodes", 2, "--json", figures) == 0
    np.testing.assert_allclose(json.loads(figures.read_text())["returns"]["MJX"], returns["MJX"][1:], rtol=1e-5)


@pytest.mark.slow
def test_every_method_moves_its_reward_to_the_crippled_ant(tmp_path, tiny, run, retrain_settings):
    arguments = ["transfer", "ant", "crippled_ant", "--method", *METHODS, "--seeds", 1, "--restarts", 1]
    longer = [s for s in tiny if not s.startswith("rollout_length")]
    settings = ["--set", *longer, "rollout_length=500", "--retrain-set", *retrain_settings]
    assert run(*arguments, "--rule", "last", "--out", tmp_path, *settings) == 0
    folders = list(tmp_path.glob("transfer-ant-to-crippled_ant-*"))
    assert len(folders) == len(METHODS)
    for folder in folders:
        assert np.isfinite(json.loads((folder / "summary.json").read_text())["returns"]).all()
        assert load_reward(folder / "reward").description["task"] == "ant"


@pytest.mark.slow
def test_one_reward_is_learned_from_two_sources_and_used_in_a_third_task(tmp_path, tiny, capsys, run, retrain_settings):
    mazes = "point_maze_left+point_maze_right"
    arguments = ["transfer", mazes, "point_maze_middle", "--seeds", 2, "--restarts", 1, "--out", tmp_path]
    settings = ["--set", *tiny, "own_part=0.1", "--retrain-set", *retrain_settings]
    assert run(*arguments, "--rule", "source_retrain", "random", *settings) == 0
    folders = sorted(tmp_path.glob("transfer-*"))
    assert len(folders) == 2
    for folder in folders:
        summary = json.loads((folder / "summary.json").read_text())
        assert (summary["task"], summary["target"]) == (mazes, "point_maze_middle")
        assert np.isfinite(summary["returns"]).all()
        reward = load_reward(folder / "reward")
        assert reward.description["obs_size"] == 2
        assert np.isfinite(reward(np.zeros((3, 2)), np.zeros((3, 2)), seed=1)).all()
    (learned,) = tmp_path.glob("learn-*")
    policy = load_policy(tmp_path / folders[0].name / "policy")
    assert policy.description["obs_size"] == 2  # of the third task
    # The same reward can be used again, in a task of its own.
    again = ["transfer", mazes, "point_maze_left", "--reward", folders[0] / "reward", "--out", tmp_path / "again"]
    assert run(*again, "--retrain-set", *retrain_settings) == 0
    assert (learned / "snapshots").is_dir()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["pendulum+pendulum", "pendulum", "--rule", "policy"],
            "--rule policy: the policy of pendulum.pendulum reads which source it is in",
        ),
        (["pendulum", "pendulum+pendulum"], "a reward is used in one task at a time"),
        (["pendulum+swimmer", "pendulum"], "need the same observation_size, and these have 3, 8"),
        (["pendulum+pendulum", "pendulum", "--rule", "last", "--demos", "a.npz"], "1 file for the 2 tasks"),
        (["pendulum+pendulum", "swimmer", "--rule", "last"], "observations of 3, actions of 1\\) does not fit swimmer"),
    ],
)
def test_impossible_sources_are_refused(capsys, tmp_path, run, arguments, message):
    assert run("transfer", *arguments, "--out", tmp_path) == 2
    assert re.search(message, " ".join(capsys.readouterr().err.split()))
