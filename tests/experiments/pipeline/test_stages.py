"""Which reward a rule takes, and which policy is kept, from curves that are made up."""

import dataclasses

import jax
import numpy as np
import pytest

from eairl_jax import InputError, LearnedReward, save_reward
from eairl_jax.experiments.options import Transfer
from eairl_jax.experiments.pipeline import run, stages
from eairl_jax.experiments.pipeline.experiment import Rule, Use, make_target, transfers
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.experiments.pipeline.stages import Score, choose_reward, describe, snapshot_path, untrained

SNAPSHOTS, SEEDS = (40, 80, 120), (0, 1)


def metrics(folder, labels, **values):
    """Writes what a training would: a value a lane for each metric, in each of ten iterations."""
    folder.append_metrics(0, 1, labels, {name: np.repeat(np.ravel(v)[:, None], 10, 1) for name, v in values.items()})


def test_the_restart_that_its_own_reward_rates_best_is_kept(tmp_path):
    folder = RunFolder(tmp_path, {})
    labels = [{"restart": restart, "seed": seed} for restart in range(3) for seed in SEEDS]
    metrics(folder, labels, policy_reward=[[1, 6], [3, 5], [2, 4]], true_return=[[9, 1], [2, 8], [9, 9]])
    kept = stages.best_restarts(folder, 3, 2)
    assert [labels[lane] for lane in kept] == [{"restart": 1, "seed": 0}, {"restart": 0, "seed": 1}]


@pytest.fixture
def learned(tmp_path):
    """An experiment, and the folder where its rewards were learned: three snapshots, each of other numbers."""
    (experiment,) = transfers(Transfer("point_maze_left", "point_maze_right", method=("airl_s",), seeds=2))
    folder, first = RunFolder(tmp_path / "learn", experiment.learning_settings()), untrained(experiment)
    for iteration in SNAPSHOTS:
        params = jax.tree.map(lambda leaf, by=iteration: np.asarray(leaf) + by, first)
        save_reward(snapshot_path(folder, iteration), describe(experiment, params, [iteration] * 2))
    return experiment, folder


def test_source_retrain_takes_each_seeds_best_snapshot_in_the_source(tmp_path, monkeypatch, learned):
    experiment, learning = learned
    assert experiment.use.rule.repeats == 2
    asked = {}

    def made_up(folder, _title, target, reward, labels, _phase):
        asked.update(target=target, params=reward.params, labels=labels)
        # [repeat, snapshot, seed]. Of seed 0's snapshot 80 the second repeat has the higher learned reward, so its true
        # return counts, 7 and not 99; of seed 1's 120 the first, 9.
        learned = [[[1, 1], [1, 1], [1, 2]], [[0, 0], [2, 0], [0, 1]]]
        true = [[[3, 4], [99, 5], [6, 9]], [[50, 50], [7, 50], [50, 1]]]
        metrics(folder, labels, policy_reward=learned, true_return=true)

    monkeypatch.setattr(stages, "retrain", made_up)
    reward, facts = choose_reward(RunFolder(tmp_path / "use", {}), learning, experiment, experiment.use)
    assert facts["source_returns"] == [[3, 4], [7, 5], [6, 9]]
    assert facts["chosen_iterations"] == [80, 120]
    back_home = experiment.use.back_home
    assert asked["target"].task == "point_maze_left"
    assert asked["target"].recipe.config.iterations == back_home.recipe.source_retrain_iterations
    # Every lane was given the reward of its label, and each seed's is the one that is taken.
    initial = np.asarray(jax.tree.leaves(untrained(experiment))[0])
    for label, lane in zip(asked["labels"], jax.tree.leaves(asked["params"])[0], strict=True):
        np.testing.assert_allclose(lane, initial[label["seed"]] + label["snapshot"], rtol=1e-5)
    chosen = jax.tree.leaves(reward.params)[0]
    for seed, iteration in enumerate((80, 120)):
        np.testing.assert_allclose(chosen[seed], initial[seed] + iteration, rtol=1e-5)


def test_source_retrain_never_looks_at_the_target(tmp_path, monkeypatch, learned):
    """The choice is the same whatever the target is: its environment is not even there."""
    experiment, learning = learned

    def made_up(folder, _title, target, _reward, labels, _phase):
        assert target.env is experiment.source.env
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
    monkeypatch.setattr(stages, "make_rl", lambda _env, config, _reward: trained.append(config))
    monkeypatch.setattr(stages, "Lanes", lambda *_args, **_more: None)
    monkeypatch.setattr(stages, "train", lambda *_: None)
    stages.retrain(RunFolder(tmp_path / "use", {}), "", target, reward, [{"restart": 0, "seed": 0}], 1)
    assert [config.actions for config in trained] == [actions]


def test_another_reward_at_the_same_place_is_another_run(tmp_path, monkeypatch, learned):
    experiment, _learning = learned
    target = make_target("point_maze_left")
    monkeypatch.setattr(stages, "score", lambda *_: Score(np.zeros((2, 4)), np.zeros(2)))
    monkeypatch.setattr(stages, "ceiling", lambda *_: [1.0, 1.0])
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
        folder.keep_metrics(0)
        folder.append_metrics(0, 1, [{"seed": 0}, {"seed": 1}], {"accuracy": accuracy})
        assert stages.saturated_lanes(folder, experiment) == names, iterations
