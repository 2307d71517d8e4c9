"""`eairl demos`: episodes of the best seed, which `eairl imitate` reads."""

import json

import numpy as np

from eairl_jax import load_policy


def test_demos_make_what_imitate_reads(expert, tmp_path, tiny, run, capsys, unchanged):
    path = tmp_path / "pendulum.npz"
    with unchanged(expert):  # reading writes nothing
        assert run("demos", "pendulum", "--expert", expert, "--episodes", 20, "--out", path) == 0
    provenance = json.loads(path.with_suffix(".json").read_text())
    with np.load(path, allow_pickle=False) as arrays:
        assert arrays["obs"].shape == (20 * 200, 3)
        assert arrays["lengths"].tolist() == provenance["lengths"] == [200] * 20
        np.testing.assert_allclose(arrays["reward"].reshape(20, 200).sum(axis=1), provenance["returns"], rtol=1e-5)
    assert provenance["expert"]["chosen_seed"] in (0, 1)
    # As many episodes as are shipped: the program of the other imitations fits.
    arguments = ["imitate", "pendulum", "--seeds", 2, "--demos", path, "--out", tmp_path / "run", "--set", *tiny]
    assert run(*arguments) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["expert"] == provenance["expert_return"]


def test_an_imitator_is_no_expert(finished, tmp_path, run, capsys):
    assert run("demos", "pendulum", "--expert", finished, "--out", tmp_path / "no.npz") == 2
    assert "no expert of pendulum" in capsys.readouterr().err
    assert run("demos", "pendulum", "--expert", finished, "--episodes", 0) == 2
    assert "--episodes = 0" in capsys.readouterr().err


def test_demonstrations_of_the_mean_action_are_scored_by_it(expert, tmp_path, run):
    path = tmp_path / "mean.npz"
    assert run("demos", "pendulum", "--expert", expert, "--mean-action", "--episodes", 2, "--out", path) == 0
    assert run("demos", "pendulum", "--expert", expert, "--mean-action", "--episodes", 2, "--out", tmp_path / "b") == 0
    scored = json.loads(path.with_suffix(".json").read_text())
    assert scored["mean_action"]
    assert scored["expert_return"] != scored["expert_return_sampled"]
    with np.load(path) as arrays, np.load(tmp_path / "b.npz") as again:
        np.testing.assert_array_equal(arrays["action"], again["action"])
    policy = load_policy(expert / "policy")
    with np.load(path) as arrays:
        best = [np.abs(policy(arrays["obs"], seed=seed) - arrays["action"]).max() for seed in range(2)]
    assert min(best) < 1e-4
