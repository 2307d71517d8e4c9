"""The rules `d_rex` and `ssrr`: new rewards from noisy episodes of the policies that imitate."""

import dataclasses
import json
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from eairl_jax import Config, HParams, InputError, load_reward, make_irl
from eairl_jax.experiments.options import Transfer
from eairl_jax.experiments.pipeline import ranked, stages
from eairl_jax.experiments.pipeline.experiment import transfers
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.noise_ranking import RANKINGS, noise_of_episodes

FAST = {name: dataclasses.replace(each, updates=20) for name, each in RANKINGS.items()}
OF_BC = ("iterations=2", "snapshot_every=2")


@pytest.fixture
def choose(tmp_path, tiny, retrain_settings, monkeypatch):
    """`(method, rule) -> (choice, folder)`: a tiny learning of the pendulum's reward, and the rule's reward of it."""
    monkeypatch.setattr(ranked, "RANKINGS", FAST)
    read = {"airl_s": tuple(each for each in tiny if "empowerment" not in each), "bc": OF_BC}

    def chosen(method, rule):
        settings = {"set": read[method], "retrain_set": tuple(retrain_settings)}
        (experiment,) = transfers(Transfer("pendulum", "pendulum", (method,), seeds=2, rule=(rule,), **settings))
        folder = RunFolder(tmp_path / rule, experiment.settings())
        learning = RunFolder(tmp_path / "learning", experiment.learning_settings())
        for each in (folder, learning):
            each.prepare()
        return stages.choose_reward(folder, learning, experiment, experiment.use), folder.path

    return chosen


def test_a_ranking_gives_each_seed_a_new_reward_of_the_same_form(choose, tmp_path):
    (reward, facts), folder = choose("airl_s", "ssrr")
    assert facts == {"chosen_iterations": [4, 4]}
    before = load_reward(tmp_path / "learning" / "snapshots" / "000004")
    obs, action = np.array([1.0, 0.0, 0.5]), np.zeros(1)
    assert len({float(each(obs, action, seed)) for each in (reward, before) for seed in (0, 1)}) == 4
    assert {(each.description["reward_form"], *each.description["seeds"]) for each in (reward, before)} == {("s", 0, 1)}
    written, shape = json.loads((folder / ranked.FILE).read_text()), (2, len(noise_of_episodes()))
    for name in ("true_returns", "ratings_before", "ratings_fitted", "ratings_after"):
        assert np.shape(written[name]) == shape, name
    assert (folder / ranked.PICTURE).is_file()
    (again, _), _ = choose("airl_s", "ssrr")  # after a kill
    jax.tree.map(np.testing.assert_array_equal, again.params, reward.params)


def test_behaviour_cloning_has_d_rex_and_no_ssrr(choose):
    with pytest.raises(InputError, match=r"bc learns no reward, and the rule ssrr needs one.*--rule policy or d_rex"):
        choose("bc", "ssrr")
    (reward, _), folder = choose("bc", "d_rex")
    assert (reward.description["method"], reward.description["reward_form"]) == ("bc", "s")
    assert json.loads((folder / ranked.FILE).read_text())["ratings_before"] is None


def test_a_reward_of_an_absorbing_state_reads_its_entry(toy, monkeypatch):
    """The observations of the reward, and so their normaliser, have an entry more than the task's."""
    monkeypatch.setattr(ranked, "RANKINGS", FAST)
    env, config = (
        toy(ends_at=3),
        Config(num_envs=2, rollout_length=5, ppo_minibatches=1, method="airl_s", horizon="absorbing", history_length=1),
    )
    algorithm = make_irl(env, config)
    state = jax.vmap(lambda key: algorithm.init(key, HParams()))(jax.random.split(jax.random.PRNGKey(0), 1))
    experiment = SimpleNamespace(source=SimpleNamespace(env=env), config=config, seeds=[0])
    for kind in RANKINGS:
        fitted = ranked.fit(experiment, algorithm, state, kind)
        assert fitted.params.obs_stats.mean.shape == (1, env.observation_size + 1)
        assert np.isfinite(fitted.facts["ratings_after"]).all()


@pytest.mark.slow
def test_a_transfer_by_a_ranking_ends_with_a_score_and_a_page(tmp_path, tiny, retrain_settings, run, monkeypatch):
    monkeypatch.setattr(ranked, "RANKINGS", FAST)
    arguments = ["transfer", "pendulum", "pendulum", "--rule", "d_rex", "--seeds", 2, "--out", tmp_path]
    assert run(*arguments, "--set", *tiny, "--retrain-set", *retrain_settings) == 0
    (folder,) = tmp_path.glob("transfer-*-d_rex")
    assert np.isfinite(json.loads((folder / "summary.json").read_text())["returns"]).all()
    assert "Noisy episodes" in (folder / "index.html").read_text()  # beside their picture


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
