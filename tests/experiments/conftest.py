"""Small settings that every command can be driven with in seconds, and the ways to drive one."""

import contextlib
import csv
import re
import shutil

import numpy as np
import pytest

from eairl_jax.experiments import cli
from eairl_jax.plans import Search

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
# Those of `TINY` that reinforcement learning has too.
RL_SETTINGS = tuple(a for a in TINY if not a.startswith(("history", "discriminator", "empowerment", "hidden")))
# The same for retraining, without trials, which would be compiled too.
RETRAIN_SETTINGS = (*RL_SETTINGS, "trials=0")
SEARCH = Search(plans=32, repeats=2, updates=10, batch=16)
SIZES = {
    "eairl_jax.experiments.pipeline.retraining.SEARCH": SEARCH,
    "eairl_jax.experiments.pipeline.retraining.JUDGED_EPISODES": 2,
    "eairl_jax.experiments.pipeline.diagnosis.JUDGED_EPISODES": 2,
    "eairl_jax.experiments.pipeline.diagnosis.EXPERT_CLONE": SEARCH,
    "eairl_jax.experiments.pipeline.train.EVALUATION_EPISODES": 2,
    "eairl_jax.experiments.commands.demos.SCORE_EPISODES": 2,
    "eairl_jax.experiments.pipeline.places.SCORE_EPISODES": 2,
}


@pytest.fixture
def tiny(monkeypatch):
    """`--set` arguments of a tiny run; evaluations are a few episodes."""
    for name, size in SIZES.items():
        monkeypatch.setattr(name, size)
    return TINY


@pytest.fixture
def metrics():
    """Writes what a training would: `(folder, labels, name=[lanes])`, the same in each of ten iterations."""

    def write(folder, labels, **values):
        every = {name: np.repeat(np.ravel(each)[:, None], 10, 1) for name, each in values.items()}
        folder.append_metrics(0, 1, labels, every)

    return write


@pytest.fixture(scope="session")
def rl_settings():
    """Those of `tiny` that reinforcement learning has too."""
    return list(RL_SETTINGS)


@pytest.fixture
def retrain_settings():
    """Those of `tiny` that retraining has too, without trials."""
    return list(RETRAIN_SETTINGS)


def run_tiny(folder, command, settings, *more):
    """Runs `eairl COMMAND pendulum` with two seeds and small evaluations, and returns its folder."""
    with pytest.MonkeyPatch.context() as patch:
        for name, size in SIZES.items():
            patch.setattr(name, size)
        cli.main([command, "pendulum", "--seeds", "2", "--out", str(folder), *more, "--set", *settings])
    return folder


@pytest.fixture(scope="session")
def trained(tmp_path_factory):
    """The folder of a tiny `imitate`, for `finished` to copy: trained once a session."""
    return run_tiny(tmp_path_factory.mktemp("trained") / "run", "imitate", TINY, "--track", "tensorboard")


@pytest.fixture(scope="session")
def expert(tmp_path_factory):
    """The folder of a tiny `eairl expert pendulum` of two seeds: trained once a session."""
    return run_tiny(tmp_path_factory.mktemp("expert") / "expert", "expert", RL_SETTINGS)


@pytest.fixture
def finished(trained, tmp_path):
    """A finished run of two seeds, to be changed at will."""
    return shutil.copytree(trained, tmp_path / "run")


@pytest.fixture(scope="session")
def run():
    """Runs `eairl` with arguments and returns its exit code."""

    def run_command(*arguments):
        try:
            cli.main([str(a) for a in arguments])
        except SystemExit as e:
            return e.code
        return 0

    return run_command


@pytest.fixture(scope="session")
def imitate(run):
    """`(out, settings, *more) -> exit code` of a tiny `eairl imitate pendulum`."""
    return lambda out, settings, *more: run(
        "imitate", "pendulum", "--seeds", 2, *more, "--out", out, "--set", *settings
    )


@pytest.fixture(scope="session")
def metrics_lines():
    """The lines of a folder's `metrics.csv`, as text."""

    def read(folder):
        with open(folder / "metrics.csv", newline="") as f:
            return list(csv.DictReader(f))

    return read


@pytest.fixture(scope="session")
def unchanged():
    """`with unchanged(folder):` fails if a file was written, or made and removed, in the folder."""

    def state_of(folder):
        stats = {path: path.stat() for path in (folder, *folder.rglob("*"))}
        return {path: (each.st_mtime_ns, each.st_size, each.st_ino) for path, each in stats.items()}

    @contextlib.contextmanager
    def compare(folder):
        before = state_of(folder)
        yield
        assert state_of(folder) == before

    return compare


@pytest.fixture(scope="session")
def table():
    """What was printed; the lines of its tables fit the 80 columns of a terminal, and their cells are whole."""

    def printed_table(capsys):
        printed = capsys.readouterr().out
        lines = [line for line in printed.splitlines() if re.search("[─━│┃]", line)]
        assert lines
        assert max(map(len, lines)) <= 80
        assert "…" not in "".join(lines)
        return printed

    return printed_table


@pytest.fixture(autouse=True)
def columns(monkeypatch):
    """A terminal of 80 columns."""
    monkeypatch.setenv("COLUMNS", "80")
