"""Makes the golden artefacts of a version: files that every later version must read, and what they must give.

    python tests/golden/make.py v2

NEVER make a committed folder again: its files stand for the files that users have. A version that writes files of
another form gets a new folder, and `test_golden.py` tests all folders. Where a test fails, mend the code that reads.
"""

# ruff: noqa: E402

from __future__ import annotations

import json
import runpy
import shutil
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
if __name__ == "__main__":  # XLA compiles with the flags of the tests
    runpy.run_path(str(HERE.parent / "conftest.py"))

import jax
import jaxlib
import numpy as np

from eairl_jax import (
    Config,
    Demonstrations,
    HParams,
    LearnedPolicy,
    LearnedReward,
    PolicyParams,
    RewardParams,
    demonstrations,
    discriminator,
    methods,
    save_policy,
    save_reward,
)
from eairl_jax.actor_critic import ActorCritic
from eairl_jax.experiments.pipeline import run as pipeline
from eairl_jax.experiments.pipeline import train
from eairl_jax.experiments.pipeline.experiment import Experiment
from eairl_jax.experiments.pipeline.places import Reference, Source, make_env, shipped_demonstrations
from eairl_jax.experiments.settings import Recipe
from eairl_jax.normalize import ObsStats
from eairl_jax.version import __version__

OBS, ACTION, SEEDS = 4, 2, (5, 6)
FORMS = {
    "sa": {"reward_form": "sa"},
    "s": {"reward_form": "s", "method": "airl_s"},
    "separable": {"reward_form": "separable", "action_part": "net"},
    "quadratic": {"reward_form": "separable", "action_part": "quadratic"},
    "absorbing": {"reward_form": "sa", "method": "airl_sa", "horizon": "absorbing"},
    "raw": {"reward_form": "sa", "method": "gail", "reward_obs": "raw"},
}
POLICIES = {
    "plain": {},
    "stds": {"state_dependent_std": True, "policy_activation": "tanh"},
    "absorbing": {"horizon": "absorbing"},
}
SIZES = {
    "num_envs": 2, "rollout_length": 50, "iterations": 4, "episode_length": 200, "hidden": (4,), "policy_hidden": (4,),
    "value_hidden": (4,), "ppo_epochs": 2, "ppo_minibatches": 2, "history_length": 1, "discriminator_updates": 2,
    "discriminator_batch": 8, "empowerment_updates": 2, "empowerment_batch": 8,
}  # fmt: skip
EVALUATED = 2
"""Episodes by which the golden run's policies are scored."""


def experiment(demos: Path, recipe: Recipe) -> Experiment:
    """EAIRL on the pendulum with two seeds."""
    loaded = demonstrations.load(demos, "pendulum")
    source = Source("pendulum", make_env("pendulum"), loaded, demos, Reference(-150.0, -1200.0))
    return Experiment(source, recipe, range(2))


def recipe_of(settings: dict) -> Recipe:
    """The recipe in the `config.json` of a golden run, whatever the recipes of today say."""
    return Recipe(Config.from_json(settings["config"]), HParams(**settings["hparams"]), settings["snapshot_every"])


def make_rewards(folder: Path) -> None:
    """A saved reward of each form, with inputs and outputs."""
    rng = np.random.default_rng(0)
    expected = {"obs": rng.normal(1, 2, (7, OBS)).astype(np.float32), "action": rng.normal(size=(7, ACTION))}
    expected["action"] = expected["action"].astype(np.float32)
    for name, changes in FORMS.items():
        config = Config(episode_length=10, hidden=(5, 4), **changes)
        size = OBS + (config.horizon == "absorbing")
        params, full = [], methods.with_method_defaults(config)
        for seed in SEEDS:
            drawn = discriminator.init(jax.random.PRNGKey(seed), size, ACTION, full)
            kept = {part: drawn[part] for part in drawn if part in ("g", "k")}
            stats = rng.normal(size=size), rng.uniform(0.5, 2.0, size), np.array(40.0)
            params.append(RewardParams(kept, ObsStats(*(np.asarray(x, np.float32) for x in stats))))
        stacked = jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *params)
        described = {"task": "toy", "obs_size": OBS, "action_size": ACTION, "action_limit": 1.0, "seeds": list(SEEDS)}
        more = {"method": config.method, "reward_form": config.reward_form, "iterations": [9, 9], "hparams": {}}
        reward = LearnedReward(described | more, config, stacked)
        save_reward(folder / name, reward)
        expected[name] = np.stack([reward(expected["obs"], expected["action"], lane) for lane in range(len(SEEDS))])
        if config.horizon == "absorbing":
            expected["after_end"] = np.array([reward.after_end(lane) for lane in range(len(SEEDS))])
    np.savez(folder / "expected.npz", **expected)


def make_policies(folder: Path) -> None:
    """A saved policy of each form, with inputs and mean actions."""
    rng = np.random.default_rng(1)
    expected = {"obs": rng.normal(1, 2, (7, OBS)).astype(np.float32)}
    for name, changes in POLICIES.items():
        config = Config(episode_length=10, policy_hidden=(5, 4), **changes)
        size = OBS + (config.horizon == "absorbing")
        networks, params = ActorCritic.build(ACTION, config, 1.0), []
        for seed in SEEDS:
            actor = networks.actor.init(jax.random.PRNGKey(seed), np.zeros(size))
            drawn = jax.tree.map(lambda x: (x + rng.normal(0, 0.1, x.shape)).astype(np.float32), actor)
            stats = rng.normal(size=size), rng.uniform(0.5, 2.0, size), np.array(40.0)
            stats = ObsStats(*(np.asarray(x, np.float32) for x in stats))
            params.append(PolicyParams(drawn, np.float32(-0.5), stats))
        stacked = jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *params)
        described = {"task": "toy", "obs_size": OBS, "action_size": ACTION, "action_limit": 1.0, "seeds": list(SEEDS)}
        policy = LearnedPolicy(described, config, stacked)
        save_policy(folder / name, policy)
        expected[name] = np.stack([policy(expected["obs"], seed=lane) for lane in range(len(SEEDS))])
    np.savez(folder / "expected.npz", **expected)


def make_demonstrations(folder: Path) -> None:
    """Demonstrations of format 1, of format 2, and of episodes that end early and hold no rewards."""
    folder.mkdir(parents=True)
    whole = demonstrations.load(shipped_demonstrations("pendulum"), "pendulum")
    two = Demonstrations(*(np.asarray(x)[:400] for x in whole[:-1]), np.array([200, 200], np.int32))
    about = {"task": "pendulum", "expert_return": -150.0, "random_return": -1200.0}
    demonstrations.save(folder / "format2.npz", two, about)
    arrays = {
        name: np.float64(x).reshape(2, 200, *x.shape[1:])[:, :30]
        for name, x in two._asdict().items()
        if name != "lengths"
    }
    arrays["terminated"] = arrays["terminated"] > 0
    np.savez_compressed(folder / "format1.npz", **arrays, task="pendulum")
    first, rest = slice(0, 30), slice(200, 207)
    rows = [np.concatenate([x[first], x[rest]]) for x in two[:-1]]
    ragged = Demonstrations(*rows, np.array([30, 7], np.int32))._replace(reward=None)
    ragged.terminated[-1] = 1.0
    demonstrations.save(folder / "ragged.npz", ragged, {"task": "pendulum"})
    names = ("format1", "format2", "ragged")
    prints = {name: demonstrations.fingerprint(demonstrations.load(folder / f"{name}.npz")) for name in names}
    (folder / "fingerprints.json").write_text(json.dumps(prints, indent=2) + "\n")


def make_runs(folder: Path) -> None:
    """A finished run, and the same run as it was after half of its iterations."""
    train.EVALUATION_EPISODES = EVALUATED
    recipe = Recipe(Config(**SIZES), HParams(policy_lr=0.01, entropy_weight=0.01, lambda_i=0.01), 2)
    made = experiment(folder / "demonstrations" / "format2.npz", recipe)
    with tempfile.TemporaryDirectory() as temporary:
        whole = Path(temporary) / "whole"
        pipeline.run(made, whole, "python tests/golden/make.py")
        shutil.copytree(whole, folder / "finished", ignore=shutil.ignore_patterns("2", "snapshots", "*.png", ".lock"))
        shutil.copytree(
            whole,
            folder / "unfinished",
            ignore=shutil.ignore_patterns("4", "reward", "000004", "*.png", ".lock", "summary*"),
        )
    metrics = folder / "unfinished" / "metrics.csv"
    metrics.write_text("".join(metrics.read_text().splitlines(keepends=True)[: 1 + 2 * 2]))


def main(name: str) -> None:
    """Makes a folder beside this file."""
    folder = HERE / name
    if folder.exists():
        sys.exit(f"{folder} exists: its files stand for those that users have, and are never made again")
    make_rewards(folder / "rewards")
    make_policies(folder / "policies")
    make_demonstrations(folder / "demonstrations")
    make_runs(folder)
    versions = {"eairl_jax": __version__, "numpy": np.__version__, "jax": jax.__version__, "jaxlib": jaxlib.__version__}
    (folder / "made.json").write_text(json.dumps(versions, indent=2) + "\n")


if __name__ == "__main__":
    main(sys.argv[1])
