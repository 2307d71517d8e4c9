"""Every example runs as it stands, only shorter. Compiling them takes minutes, so all but two tests are slow ones."""

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

from eairl_jax import demonstration_files, demonstrations, load_reward
from eairl_jax.experiments.cli import main
from eairl_jax.methods import METHODS

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
ITERATIONS = "2"


@pytest.fixture
def example(monkeypatch, tmp_path, no_trace):
    """Runs an example in an empty folder and returns its names; a method that it adds is gone after the test."""

    def run(name, *arguments):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        return runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")

    return run


def test_no_example_is_longer_than_60_lines():
    lengths = {path.name: len(path.read_text(encoding="utf-8").splitlines()) for path in EXAMPLES.glob("*.py")}
    assert len(lengths) == 11
    assert max(lengths.values()) <= 60, lengths


def test_rewards_transfer_in_tables_where_the_theorem_says_so(example, capsys):
    results = example("which_sources_are_enough")["results"]
    assert [predicted for predicted, _ in results.values()].count(True) == 3
    for case, (predicted, lost) in results.items():
        assert (lost < 1e-9) == predicted, case
    assert "two sources, another target" in capsys.readouterr().out


@pytest.mark.slow
def test_a_reward_is_learned_saved_and_used(example, tmp_path, capsys):
    learned = example("learn_a_reward", ITERATIONS)["reward"]
    used = example("use_a_saved_reward", str(tmp_path / "runs" / "my-reward"), ITERATIONS)
    demos = np.ones((3, 2))
    for seed in (0, 1):
        np.testing.assert_array_equal(learned(demos, demos, seed=seed), used["reward"](demos, demos, seed=seed))
    assert used["metrics"]["policy_reward"].shape == (2, 2)
    assert np.isfinite(used["metrics"]["true_return"]).all()
    assert "seed 1: learned reward" in capsys.readouterr().out


@pytest.mark.slow
def test_a_sweep_has_a_lane_for_each_value_and_seed(example, capsys):
    names = example("vmapped_sweep", ITERATIONS, "1")
    assert names["returns"].shape == (2, 1)
    assert names["lanes"].hparams.lambda_i.tolist() == pytest.approx([0.01, 1.0])
    assert "lambda_i 1.0: true return" in capsys.readouterr().out


@pytest.mark.slow
def test_a_task_of_your_own_can_be_demonstrated_and_imitated(example):
    names = example("task_of_your_own", ITERATIONS)
    assert names["demos"].obs.shape == (500, 2)
    assert names["demos"].lengths.tolist() == [50] * 10
    assert np.isfinite(names["metrics"]["true_return"]).all()


@pytest.mark.slow
def test_a_method_of_your_own_trains(example):
    names = example("method_of_your_own", ITERATIONS)
    assert np.isfinite(names["metrics"]["policy_reward"]).all()
    h = np.array([-1.0, 0.0, 1.0])
    np.testing.assert_allclose(METHODS["fairl"].policy_reward(h), -np.exp(h) * h, rtol=1e-6)


def test_f_irls_loss_falls_where_trajectories_like_the_experts_are_paid_more(example):
    loss = example("f_irl")["reverse_kl"]
    r, log_ratio = np.random.default_rng(0).normal(size=(2, 8, 5))
    expected = np.cov((1 - log_ratio).sum(axis=1), r.sum(axis=1), bias=True)[0, 1] / 5
    np.testing.assert_allclose(loss(r, log_ratio), expected, rtol=1e-5)
    assert loss(log_ratio, log_ratio) < 0 < loss(-log_ratio, log_ratio)


@pytest.mark.slow
def test_f_irl_trains_from_the_command_line(tmp_path):
    sizes = ["iterations=2", "snapshot_every=2", "num_envs=4", "history_length=0", "discriminator_batch=400"]
    out = ["--seeds", "1", "--out", str(tmp_path / "run"), "--set", *sizes]
    main(["imitate", "pendulum", "--method", f"{EXAMPLES / 'f_irl.py'}:f_irl", *out])
    reward = load_reward(tmp_path / "run" / "reward")
    assert np.isfinite(reward(np.ones((3, 3)), np.zeros((3, 1)))).all()


@pytest.mark.slow
@pytest.mark.extras
def test_a_policy_in_gymnasium_becomes_demonstrations(example, tmp_path, monkeypatch, capsys):
    pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    sizes = ["iterations=2", "snapshot_every=2", "num_envs=4", "rollout_length=16", "ppo_minibatches=4"]
    main(["expert", "half_cheetah", "--seeds", "1", "--out", str(tmp_path / "expert"), "--set", *sizes])
    names = example("demonstrations_from_gymnasium", str(tmp_path / "expert"), "half_cheetah/test-v0", "2")
    demos, facts = demonstration_files.read("minari:half_cheetah/test-v0", action_limit=1.0)
    assert demos.lengths.tolist() == [500, 500]
    assert facts.outside == 0
    np.testing.assert_allclose(demonstrations.returns(demos), names["returns"], rtol=1e-4)
