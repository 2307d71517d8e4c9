"""Files of earlier versions are read, and give what they gave.

What is read is bit-equal: episodes, checkpoints, lines of metrics. What is computed has a tolerance: another XLA,
another processor, and even another arrangement of the same equations, add in another order. `REWARD` is a hundred
roundings of float32. Metrics after four iterations differed by at most 8e-6, relative to their value or to 1, between
XLA's optimised and unoptimised code, and between AVX and SSE; `METRICS` is a hundred times as much. An accuracy is a
count of 16 samples. It could move by a sixteenth, and in none of these comparisons it did.
"""

import csv
import json
import runpy
import shutil
from pathlib import Path

import jax
import numpy as np
import pytest

from eairl_jax import Checkpoints, demonstrations, learned_reward, load_policy, load_reward
from eairl_jax.experiments.pipeline import policies, run, stages
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.experiments.pipeline.train import final_returns
from eairl_jax.storage import read_json

HERE = Path(__file__).parent
MAKE = runpy.run_path(str(HERE / "make.py"))
REWARD, METRICS = 1e-5, 1e-3


@pytest.fixture(scope="module", params=sorted(path.name for path in HERE.glob("v*")))
def golden(request):
    """The folder of a version."""
    return HERE / request.param


def check(found, expected, tolerance):
    """Equal within `tolerance` of the value or of 1."""
    np.testing.assert_allclose(found, expected, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("form", MAKE["FORMS"])
def test_a_saved_reward_gives_what_it_gave(golden, form):
    with np.load(golden / "rewards" / "expected.npz") as expected:
        obs, action, values = expected["obs"], expected["action"], expected[form]
        after_end = expected["after_end"] if form == "absorbing" else None
    reward = load_reward(golden / "rewards" / form, obs.shape[-1], action.shape[-1])
    assert reward.description["seeds"] == [5, 6]
    for lane, value in enumerate(values):
        check(reward(obs, action, lane), value, REWARD)
        if after_end is not None:
            check(reward.after_end(lane), after_end[lane], REWARD)
    assert np.abs(values[0] - values[1]).max() > 0.01


@pytest.mark.parametrize("form", MAKE["POLICIES"])
def test_a_saved_policy_acts_as_it_did(golden, form):
    with np.load(golden / "policies" / "expected.npz") as expected:
        obs, actions = expected["obs"], expected[form]
    policy = load_policy(golden / "policies" / form)
    for lane, action in enumerate(actions):
        check(policy(obs, seed=lane), action, REWARD)
        check(policy.numpy(lane)(obs), action, REWARD)
    assert np.std(actions) > 0.1


@pytest.mark.parametrize("name", ["format1", "format2", "ragged"])
def test_demonstrations_are_read_as_they_were(golden, name):
    """The name of a run holds the fingerprint, so the fingerprint of a file stays what it was."""
    demos = demonstrations.load(golden / "demonstrations" / f"{name}.npz", "pendulum", obs_size=3, action_size=1)
    assert demonstrations.fingerprint(demos) == read_json(golden / "demonstrations" / "fingerprints.json")[name]
    whole = demonstrations.load(golden / "demonstrations" / "format2.npz")
    np.testing.assert_array_equal(demos.obs[:30], whole.obs[:30])
    assert demos.lengths.tolist() == {"format1": [30, 30], "format2": [200, 200], "ragged": [30, 7]}[name]
    assert demos.terminated.sum() == (name == "ragged")
    assert (demos.reward is None) == (name == "ragged")


@pytest.fixture
def experiment(golden):
    """The experiment of the golden runs, with the settings that their `config.json` holds."""
    settings = read_json(golden / "finished" / "config.json")["settings"]
    return MAKE["experiment"](golden / "demonstrations" / "format2.npz", MAKE["recipe_of"](settings))


def columns(folder):
    """The columns of `metrics.csv`."""
    with open(folder / "metrics.csv", newline="", encoding="utf-8") as f:
        lines = list(csv.DictReader(f))
    return {name: [float(line[name]) for line in lines] for name in lines[0]}


def check_metrics(folder, golden):
    """All metrics that the version wrote are still written, and are equal."""
    found, expected = columns(folder), columns(golden / "finished")
    assert not set(expected) - set(found)
    for name, values in expected.items():
        check(found[name], values, METRICS)


def test_a_run_gives_the_metrics_that_it_gave(golden, experiment, tmp_path):
    stages.learn(RunFolder(tmp_path / "run", experiment.settings()), experiment)
    check_metrics(tmp_path / "run", golden)


def test_an_unfinished_run_goes_on(golden, experiment, tmp_path):
    folder = shutil.copytree(golden / "unfinished", tmp_path / "run")
    before = (folder / "metrics.csv").read_bytes()
    assert Checkpoints(folder / "checkpoints").latest() == 2
    stages.learn(RunFolder(folder, experiment.settings()), experiment)
    assert Checkpoints(folder / "checkpoints").latest() == 4
    assert (folder / "metrics.csv").read_bytes().startswith(before)
    check_metrics(folder, golden)
    rewards = [
        load_reward(path)
        for path in (stages.snapshot_path(RunFolder(folder, experiment.settings()), 4), golden / "finished" / "reward")
    ]
    for found, expected in zip(*(jax.tree.leaves(reward.params) for reward in rewards), strict=True):
        check(found, expected, METRICS)


def test_a_finished_run_is_read_and_its_policies_act_as_they_did(golden, experiment, tmp_path):
    folder = shutil.copytree(golden / "finished", tmp_path / "run")
    recorded = json.loads((folder / "summary.json").read_text())
    result = run.run(experiment, folder)
    assert (result.returns, result.seeds, result.name) == (recorded["returns"], [0, 1], "eairl-sa")
    assert (folder / "curves.png").exists()
    trained = policies.load(folder)
    rewards = learned_reward(trained.state), load_reward(folder / "reward").params
    jax.tree.map(np.testing.assert_array_equal, *rewards)
    returns = final_returns(trained.env, trained.algorithm, trained.state, trained.seeds, MAKE["EVALUATED"]).mean(
        axis=1
    )
    check(returns, recorded["returns"], METRICS)
