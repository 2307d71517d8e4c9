"""Which reward a rule takes, and with what it is used."""

import dataclasses

import jax
import numpy as np
import pytest

from eairl_jax import (
    InputError,
    LearnedReward,
    save_reward,
)
from eairl_jax.experiments.options import Transfer
from eairl_jax.experiments.pipeline import retraining, run, stages
from eairl_jax.experiments.pipeline.experiment import Rule, Use, transfers
from eairl_jax.experiments.pipeline.places import make_target
from eairl_jax.experiments.pipeline.retraining import Score, Training, retrain
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.experiments.pipeline.stages import choose_reward, describe, snapshot_path, untrained
from eairl_jax.experiments.pipeline.train import RETRAIN

SNAPSHOTS, SEEDS = (40, 80, 120), (0, 1)


@pytest.fixture
def learned(tmp_path):
    """An experiment, and the folder where its rewards were learned: three snapshots, each of other numbers."""
    (experiment,) = transfers(Transfer("point_maze_left", "point_maze_right", method=("airl_s",), seeds=2))
    folder, first = RunFolder(tmp_path / "learn", experiment.learning_settings()), untrained(experiment)
    for iteration in SNAPSHOTS:
        params = jax.tree.map(lambda leaf, by=iteration: np.asarray(leaf) + by, first)
        save_reward(snapshot_path(folder, iteration), describe(experiment, params, [iteration] * 2))
    return experiment, folder


def test_source_retrain_takes_each_seeds_best_snapshot_in_the_source(tmp_path, monkeypatch, learned, metrics):
    experiment, learning = learned
    assert experiment.use.rule.repeats == 2
    asked = {}

    def made_up(folder, _title, training):
        asked.update(target=training.target, params=training.reward.params, labels=training.labels)
        labels = training.restarts(training.target.recipe.restarts)
        # [repeat, snapshot, seed]. Of seed 0's snapshot 80 the second repeat has the higher learned reward, so its true
        # return counts, 7 and not 99; of seed 1's 120 the first, 9.
        learned = [[[1, 1], [1, 1], [1, 2]], [[0, 0], [2, 0], [0, 1]]]
        true = [[[np.nan, 4], [99, 5], [6, 9]], [[50, 50], [7, 50], [50, 1]]]  # in one no episode ended
        metrics(folder, labels, policy_reward=learned, true_return=true)

    monkeypatch.setattr(stages, "retrain", made_up)
    reward, facts = choose_reward(RunFolder(tmp_path / "use", {}), learning, experiment, experiment.use)
    assert facts["source_returns"] == [[None, 4], [7, 5], [6, 9]]
    assert facts["chosen_iterations"] == [80, 120]
    back_home = experiment.use.back_home
    assert asked["target"].task == "point_maze_left"
    recipe = asked["target"].recipe
    assert recipe.config.iterations == back_home.recipe.source_retrain_iterations
    assert (recipe.restarts, recipe.trials) == (2, back_home.recipe.trials // 2)
    # Every label names its reward, and each seed's is the one that is taken.
    initial = np.asarray(jax.tree.leaves(untrained(experiment))[0])
    for label, lane in zip(asked["labels"], jax.tree.leaves(asked["params"])[0], strict=True):
        np.testing.assert_allclose(lane, initial[label["seed"]] + label["snapshot"], rtol=1e-5)
    chosen = jax.tree.leaves(reward.params)[0]
    for seed, iteration in enumerate((80, 120)):
        np.testing.assert_allclose(chosen[seed], initial[seed] + iteration, rtol=1e-5)


def test_source_retrain_never_looks_at_the_target(tmp_path, monkeypatch, learned, metrics):
    """The choice is the same whatever the target is: its environment is not even there."""
    experiment, learning = learned

    def made_up(folder, _title, training):
        assert training.target.env is experiment.source.env
        labels = training.restarts(2)
        metrics(folder, labels, policy_reward=np.arange(12), true_return=np.arange(12)[::-1])

    monkeypatch.setattr(stages, "retrain", made_up)
    blind = Use(None, experiment.use.back_home, experiment.use.rule)
    _, facts = choose_reward(RunFolder(tmp_path / "use", {}), learning, experiment, blind)
    assert facts["chosen_iterations"] == [40, 40]


@pytest.mark.parametrize("actions", ["sampled", "clipped"])
def test_policies_are_trained_with_the_actions_that_the_reward_knows(monkeypatch, tmp_path, learned, actions):
    """The target's recipe says clipped; the reward decides, in what is trained and in what is recorded."""
    experiment, learning = learned
    reward, _ = choose_reward(None, learning, experiment, dataclasses.replace(experiment.use, rule=Rule("last")))
    reward = LearnedReward(reward.description, dataclasses.replace(reward.config, actions=actions), reward.params)
    target = make_target("crippled_ant")
    assert target.recipe.config.actions == "clipped"
    assert target.for_reward(reward.config).settings()["retrain_config"]["actions"] == actions
    trained = []
    monkeypatch.setattr(retraining, "make_rl", lambda _env, config, *_more: trained.append(config))
    monkeypatch.setattr(retraining, "Lanes", lambda *_args, **_more: None)
    monkeypatch.setattr(retraining, "train", lambda *_args, **_more: None)
    retrain(RunFolder(tmp_path / "use", {}), "", Training(target, reward, [{"seed": 0}, {"seed": 1}], RETRAIN))
    assert [config.actions for config in trained] == [actions]


def test_another_reward_at_the_same_place_is_another_run(tmp_path, monkeypatch, learned):
    experiment, _learning = learned
    target = make_target("point_maze_left")
    worthless = retraining.Worth(np.zeros((1, 2)), {retraining.RANDOM: np.zeros(2)})
    monkeypatch.setattr(retraining, "score", lambda *_: Score(np.zeros((2, 4)), np.zeros(2), worthless))
    monkeypatch.setattr(retraining, "ceiling", lambda *_: retraining.Ceiling([1.0, 1.0], []))
    reward = describe(experiment, untrained(experiment), [0, 0])
    path = tmp_path / "run" / "reward"
    for _ in range(2):
        assert run.reuse(path, reward, target, tmp_path).returns == [0.0, 0.0]
    other = LearnedReward(reward.description, reward.config, jax.tree.map(lambda leaf: leaf + 1, reward.params))
    with pytest.raises(InputError, match="different run"):
        run.reuse(path, other, target, tmp_path)


def test_a_saturated_discriminator_is_named(tmp_path, learned):
    experiment, _ = learned
    folder = RunFolder(tmp_path / "saturated", {})
    accuracy = np.full((2, 4), 0.98)
    for iterations, names in ((0, []), (2, []), (3, ["seed 1"]), (4, ["seed 1"])):
        accuracy[1, :iterations] = 0.995
        folder.keep_metrics(0, [])
        folder.append_metrics(0, 1, [{"seed": 0}, {"seed": 1}], {"accuracy": accuracy})
        assert stages.saturated_lanes(folder, experiment) == names, iterations
