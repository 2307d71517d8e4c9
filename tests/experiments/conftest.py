"""Small settings that every command can be driven with in seconds."""

import shutil

import pytest

from eairl_jax.experiments import cli

TINY = (
    "num_envs=2",
    "rollout_length=20",
    "ppo_epochs=1",
    "ppo_minibatches=1",
    "hidden=4",
    "policy_hidden=4",
    "value_hidden=4",
    "history_length=1",
    "discriminator_updates=1",
    "discriminator_batch=8",
    "empowerment_updates=1",
    "empowerment_batch=8",
    "iterations=4",
    "snapshot_every=2",
)


@pytest.fixture
def tiny(monkeypatch):
    """`--set` arguments of a tiny run; evaluations are a few episodes."""
    monkeypatch.setattr("eairl_jax.experiments.pipeline.train.EVALUATION_EPISODES", 2)
    monkeypatch.setattr("eairl_jax.experiments.commands.demos.SCORE_EPISODES", 2)
    monkeypatch.setattr("eairl_jax.experiments.pipeline.scores.SCORE_EPISODES", 2)
    return TINY


@pytest.fixture(scope="session")
def trained(tmp_path_factory):
    """The folder of a tiny `imitate`, for `finished` to copy: trained once a session."""
    folder = tmp_path_factory.mktemp("trained") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("eairl_jax.experiments.pipeline.train.EVALUATION_EPISODES", 2)
        cli.main(["imitate", "pendulum", "--seeds", "2", "--out", str(folder), "--set", *TINY])
    return folder


@pytest.fixture
def finished(trained, tmp_path):
    """A finished run of two seeds of one's own."""
    return shutil.copytree(trained, tmp_path / "run")
