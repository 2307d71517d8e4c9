"""Which reward a rule takes, and which policy is kept, from curves that are made up."""

import dataclasses

import jax
import numpy as np
import pytest

from eairl_jax import envs, save_reward
from eairl_jax.experiments.pipeline import retrain
from eairl_jax.experiments.pipeline.learn import describe, prepare, snapshot_path, untrained
from eairl_jax.experiments.pipeline.retrain import as_target, on_reward, target_settings
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.experiments.pipeline import select
from eairl_jax.experiments.pipeline.select import Rule, choose_reward

SNAPSHOTS, SEEDS = (40, 80, 120), (0, 1)


def metrics(folder, labels, **values):
    """Writes what a training would: a value a lane for each metric, in each of ten iterations."""
    folder.append_metrics(0, 1, labels, {name: np.repeat(np.ravel(v)[:, None], 10, 1) for name, v in values.items()})


def test_the_restart_that_its_own_reward_rates_best_is_kept(tmp_path):
    folder = RunFolder(tmp_path, {})
    labels = [{"restart": restart, "seed": seed} for restart in range(3) for seed in SEEDS]
    metrics(folder, labels, policy_reward=[[1, 6], [3, 5], [2, 4]], true_return=[[9, 1], [2, 8], [9, 9]])
    kept = retrain.best_restarts(folder, 3, 2)
    assert [labels[lane] for lane in kept] == [{"restart": 1, "seed": 0}, {"restart": 0, "seed": 1}]


@pytest.fixture
def learned(tmp_path):
    """A job, and the folder where its rewards were learned: three snapshots, each of its own numbers."""
    (job,) = prepare("point_maze_left", ("airl_s",), ("default",), range(2), None, "reward", ())
    folder, first = RunFolder(tmp_path / "learn", job.settings()), untrained(job)
    for iteration in SNAPSHOTS:
        params = jax.tree.map(lambda leaf, by=iteration: np.asarray(leaf) + by, first)
        save_reward(snapshot_path(folder, iteration), describe(job, params, [iteration] * 2))
    return job, folder


def test_source_retrain_takes_each_seeds_best_snapshot_in_the_source(tmp_path, monkeypatch, learned):
    job, learning = learned
    source = as_target("point_maze_left", envs.make("point_maze_left"), ())
    rule = Rule.parse("source_retrain", job.recipe, source.recipe)
    assert rule.repeats == 2
    seen = {}

    def trained(folder, _title, target, reward, params, labels, _phase):
        seen.update(target=target, reward=reward, params=params, labels=labels)
        # [repeat, snapshot, seed]. Of seed 0's snapshot 80 the second repeat has the higher learned reward, so its true
        # return counts, 7 and not 99; of seed 1's 120 the first, 9.
        learned = [[[1, 1], [1, 1], [1, 2]], [[0, 0], [2, 0], [0, 1]]]
        true = [[[3, 4], [99, 5], [6, 9]], [[50, 50], [7, 50], [50, 1]]]
        metrics(folder, labels, policy_reward=learned, true_return=true)

    monkeypatch.setattr(select, "retrain", trained)
    reward, said = choose_reward(RunFolder(tmp_path / "use", {}), learning, job, rule, source)
    assert said["source_returns"] == [[3, 4], [7, 5], [6, 9]]
    assert said["chosen_iterations"] == [80, 120]
    assert seen["target"].task == "point_maze_left"
    assert seen["target"].recipe.config.iterations == source.recipe.source_retrain_iterations
    # Every lane was given the reward of its label, and each seed's is the one that is taken.
    initial = np.asarray(jax.tree.leaves(untrained(job))[0])
    for label, lane in zip(seen["labels"], jax.tree.leaves(seen["params"])[0], strict=True):
        np.testing.assert_allclose(lane, initial[label["seed"]] + label["snapshot"], rtol=1e-5)
    taken = jax.tree.leaves(reward.params)[0]
    for seed, iteration in enumerate((80, 120)):
        np.testing.assert_allclose(taken[seed], initial[seed] + iteration, rtol=1e-5)


def test_policies_take_actions_as_the_reward_came_to_know_them(learned):
    job, _ = learned
    target = as_target("crippled_ant", envs.make("crippled_ant"), ())
    for actions in ("sampled", "clipped"):
        config = dataclasses.replace(job.recipe.config, actions=actions)
        assert target_settings(on_reward(target, config))["retrain_config"]["actions"] == actions
