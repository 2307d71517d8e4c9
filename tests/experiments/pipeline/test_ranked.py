"""The rules `d_rex` and `ssrr`: new rewards from noisy episodes of the policies that imitate."""

import dataclasses
import json

import numpy as np
import pytest

from eairl_jax import Config, load_reward
from eairl_jax.experiments.pipeline import ranked
from eairl_jax.noise_ranking import RANKINGS, noise_of_episodes

FAST = {name: dataclasses.replace(each, updates=20) for name, each in RANKINGS.items()}


@pytest.fixture
def transfer(tiny, retrain_settings, run, monkeypatch):
    """`(out, method, *rules) -> exit code` of a tiny transfer of the pendulum's reward to the pendulum."""
    monkeypatch.setattr(ranked, "RANKINGS", FAST)
    read = {"airl_s": [each for each in tiny if "empowerment" not in each], "bc": ["iterations=2", "snapshot_every=2"]}

    def command(out, method, *rules):
        arguments = ["transfer", "pendulum", "pendulum", "--method", method, "--seeds", 2, "--rule", *rules]
        return run(*arguments, "--out", out, "--set", *read[method], "--retrain-set", *retrain_settings)

    return command


def only(folder, pattern):
    (found,) = folder.glob(pattern)
    return found


def test_a_ranking_gives_each_seed_a_new_reward_of_the_same_form(tmp_path, transfer):
    assert transfer(tmp_path, "airl_s", "ssrr") == 0
    folder = only(tmp_path, "transfer-*-ssrr")
    rewards = [load_reward(folder / "reward"), load_reward(only(tmp_path, "learn-*") / "snapshots" / "000004")]
    obs, action = np.array([1.0, 0.0, 0.5]), np.zeros(1)
    assert len({float(reward(obs, action, seed)) for reward in rewards for seed in (0, 1)}) == 4
    assert {(each.description["reward_form"], *each.description["seeds"]) for each in rewards} == {("s", 0, 1)}
    facts = json.loads((folder / ranked.FILE).read_text())
    shape = (2, len(noise_of_episodes()))
    for name in ("true_returns", "ratings_before", "ratings_fitted", "ratings_after"):
        assert np.shape(facts[name]) == shape, name
    assert "Noisy episodes" in (folder / "index.html").read_text()  # beside their picture
    (folder / "summary.json").unlink()  # killed before the end: the same reward again
    before = (folder / "reward" / "reward.npz").read_bytes()
    assert transfer(tmp_path, "airl_s", "ssrr") == 0
    assert (folder / "reward" / "reward.npz").read_bytes() == before


def test_behaviour_cloning_has_d_rex_and_no_ssrr(tmp_path, transfer, capsys):
    assert transfer(tmp_path / "refused", "bc", "ssrr") == 2
    error = capsys.readouterr().err
    assert "bc learns no reward, and the rule ssrr needs one" in error
    assert "--rule policy or d_rex" in error
    assert not (tmp_path / "refused").exists()
    assert transfer(tmp_path / "run", "bc", "d_rex") == 0
    reward = load_reward(only(tmp_path / "run", "transfer-*-d_rex") / "reward")
    assert (reward.description["method"], reward.description["reward_form"]) == ("bc", "s")


def test_the_reward_keeps_the_form_of_its_method():
    assert ranked.reward_config(Config(method="airl_sa")).reward_form == "sa"
    assert ranked.reward_config(Config(method="eairl", reward_form="separable")).reward_form == "separable"
    assert ranked.reward_config(Config(method="bc")).reward_form == "s"


def test_a_first_reward_that_ignores_noise_is_said(capsys):
    ranked._warn_of_flat([3, 4], np.array([[0.0, 0.0], [1.0, -1.0]]))
    said = " ".join(capsys.readouterr().out.split())
    assert "WARNING: seed 3: by the learned reward, episodes are not worse with more random actions" in said
    ranked._warn_of_flat([3], np.array([[1.0, -1.0]]))
    assert capsys.readouterr().out == ""
