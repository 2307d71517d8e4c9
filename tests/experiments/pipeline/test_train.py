"""A training goes on where it was killed, and stops at a NaN."""

import errno
import json
import os
import shutil
import socket
import subprocess
import sys
import time

import jax
import numpy as np
import pytest

from eairl_jax import Checkpoints, InputError, Lanes, checkpoint, load_policy, load_reward, processes
from eairl_jax.experiments.pipeline import policies, train
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.storage import named_leaves


def test_a_killed_run_goes_on_bit_identically(finished, tmp_path, tiny, monkeypatch, imitate):
    class Killed(Checkpoints):
        """Dies before the second checkpoint: the second chunk's metrics are on disk, its state is not."""

        def save(self, iteration, state):
            if iteration == 4:
                raise KeyboardInterrupt
            super().save(iteration, state)

    monkeypatch.setattr(train, "Checkpoints", Killed)
    assert imitate(tmp_path / "killed", tiny) == 130
    assert Checkpoints(tmp_path / "killed" / "checkpoints").latest() == 2
    monkeypatch.setattr(train, "Checkpoints", Checkpoints)
    assert imitate(tmp_path / "killed", tiny) == 0
    for name in ("metrics.csv", "reward/reward.npz"):
        assert (tmp_path / "killed" / name).read_bytes() == (finished / name).read_bytes(), name
    states = [read_state(folder) for folder in (finished, tmp_path / "killed")]
    assert states[0].keys() == states[1].keys()
    for name, leaf in states[0].items():
        np.testing.assert_array_equal(leaf, states[1][name], err_msg=name)


def test_chunks_of_another_length_give_the_same_run(finished, tmp_path, tiny, imitate, metrics_lines):
    """Up to rounding: programs of other lengths may add in another order."""
    one_chunk = [setting.replace("snapshot_every=2", "snapshot_every=4") for setting in tiny]
    assert one_chunk != list(tiny)
    assert imitate(tmp_path / "one", one_chunk) == 0
    two_chunks, one_chunk = metrics_lines(finished), metrics_lines(tmp_path / "one")
    assert len(two_chunks) == len(one_chunk) == 8
    for a, b in zip(two_chunks, one_chunk, strict=True):
        values = [[float(value) for value in line.values()] for line in (a, b)]
        np.testing.assert_allclose(*values, rtol=1e-2, atol=1e-3)


def read_state(folder):
    """The last checkpoint's leaves."""
    import orbax.checkpoint as ocp

    manager = ocp.CheckpointManager((folder / "checkpoints").resolve())
    return manager.restore(4, args=ocp.args.StandardRestore())


def poison(monkeypatch, of_chunk, in_state=False):
    """From now on the metric `value_loss` of seed 1, or a weight of its policy, is NaN at the end of a chunk."""
    run_lanes = Lanes.run

    def poisoned(self, state, length, check=True):
        chunk = int(np.asarray(state.agent.iteration)[0]) // length + 1
        state, metrics = run_lanes(self, state, length, check)
        if chunk == of_chunk and in_state:
            leaves, tree = jax.tree.flatten(self.take(state))
            names = list(named_leaves(self.take(state)))
            weight = names.index("agent/policy/nets/params/actor/params/MLP_0/Dense_0/kernel")
            leaves[weight] = leaves[weight].copy()
            leaves[weight][1, 0, 0] = np.nan
            state = self.put(jax.tree.unflatten(tree, leaves))
        elif chunk == of_chunk:
            metrics["value_loss"] = metrics["value_loss"].copy()
            metrics["value_loss"][1, 1] = np.nan
        return state, metrics

    monkeypatch.setattr(Lanes, "run", poisoned)


def test_nan_stops_the_run_or_drops_its_seed(
    finished, tmp_path, tiny, monkeypatch, capsys, run, imitate, metrics_lines
):
    folder = tmp_path / "nan"
    with monkeypatch.context() as patch:
        poison(patch, of_chunk=2)
        assert imitate(folder, tiny) == 1
        message = capsys.readouterr().err
        assert "value_loss became nan at iteration 4 (seed 1); the checkpoint of iteration 2 is kept" in message
        assert "--on-nan skip" in message
        assert Checkpoints(folder / "checkpoints").latest() == 2
        assert not (folder / "dropped.json").exists()
        assert imitate(folder, tiny, "--on-nan", "skip") == 0
    why = "value_loss became nan at iteration 4 of eairl-sa in pendulum"
    printed = " ".join(capsys.readouterr().out.split())
    assert "going on from iteration 2" in printed
    assert f"eairl-sa: mean of 1 of 2 seeds; dropped: seed 1 ({why})" in printed
    summary, whole = (json.loads((path / "summary.json").read_text()) for path in (folder, finished))
    assert summary["seeds"] == [0]
    assert summary["returns"] == whole["returns"][:1]
    assert summary["mean"] == whole["returns"][0]
    reason = {"training": "eairl-sa in pendulum", "quantity": "value_loss", "iteration": 4, "value": "nan"}
    assert summary["dropped"] == [{"seed": 1, **reason}]
    assert load_reward(folder / "reward").description["seeds"] == [0]
    assert policies.load(folder).seeds == load_policy(folder / "policy").description["seeds"] == [0]
    lines, wanted = metrics_lines(folder), metrics_lines(finished)
    assert lines[:-1] == wanted[:-1]  # the last line is the one that is not finite
    assert lines[-1]["iteration"] == "4"
    assert lines[-1]["value_loss"] == lines[-1]["true_return"] == "nan"
    assert imitate(folder, tiny) == 0  # read again
    assert f"dropped: seed 1 ({why})" in " ".join(capsys.readouterr().out.split())


def test_a_run_that_goes_on_knows_which_seeds_were_dropped(finished, tmp_path, tiny, monkeypatch, capsys, imitate):
    """NaN in the state alone, in the first chunk; then the run is killed, and goes on without the NaN."""

    def killed(*_arguments):
        raise KeyboardInterrupt

    folder, metrics = tmp_path / "nan", RunFolder.append_metrics
    with monkeypatch.context() as patch:
        poison(patch, of_chunk=1, in_state=True)
        patch.setattr(
            RunFolder, "append_metrics", lambda self, done, *more: killed() if done else metrics(self, done, *more)
        )
        assert imitate(folder, tiny, "--on-nan", "skip") == 130
    assert imitate(folder, tiny) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert (
        "dropped: seed 1 (agent/policy/nets/params/actor/params/MLP_0/Dense_0/kernel became nan at iteration 2"
        in printed
    )
    summary, whole = (json.loads((path / "summary.json").read_text()) for path in (folder, finished))
    assert (summary["seeds"], summary["returns"]) == ([0], whole["returns"][:1])


def test_a_disk_that_fails_is_reported_and_nothing_is_lost(finished, tmp_path, tiny, monkeypatch, capsys, imitate):
    """A used-up quota (a full disk is alike), and a removed folder: one message that says where, and what to do."""
    folder, reserve, run_lanes = tmp_path / "other", checkpoint.reserve, Lanes.run

    def at_the_second_checkpoint(path, size):
        if (path / "2").exists():
            raise OSError(errno.EDQUOT, os.strerror(errno.EDQUOT), str(path))
        reserve(path, size)

    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "reserve", at_the_second_checkpoint)
        assert imitate(folder, tiny) == 2
    message = capsys.readouterr().err
    assert f"quota exceeded ({folder / 'checkpoints'})" in message
    assert "free some disk, then repeat the command to go on" in message
    assert imitate(folder, tiny) == 0
    assert "going on from iteration 2" in capsys.readouterr().out
    assert (folder / "metrics.csv").read_bytes() == (finished / "metrics.csv").read_bytes()

    def removed(*arguments, **more):
        shutil.rmtree(folder)
        return run_lanes(*arguments, **more)

    (folder / "summary.json").unlink()
    shutil.rmtree(folder / "checkpoints" / "4")
    with monkeypatch.context() as patch:
        patch.setattr(Lanes, "run", removed)
        assert imitate(folder, tiny) == 2
    assert f"{folder} was removed" in capsys.readouterr().err
    (tmp_path / "file").write_text("")
    assert imitate(tmp_path / "file" / "run", tiny) == 2
    assert "cannot write" in capsys.readouterr().err


def test_a_damaged_checkpoint_is_made_again(finished, tmp_path, tiny, capsys, imitate):
    """The newest checkpoint of a run is damaged: the run goes on from the one before, to the same bits."""
    wanted = {name: (finished / name).read_bytes() for name in ("metrics.csv", "reward/reward.npz")}
    for path in (finished / "checkpoints" / "4").rglob("manifest.ocdbt"):
        path.write_bytes(b"")
    with pytest.raises(InputError, match=r"last checkpoint .* \(4\) is damaged"):
        policies.load(finished)
    (finished / "summary.json").unlink()
    (finished / "reward" / "reward.npz").unlink()
    assert imitate(finished, tiny) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "the checkpoint of iteration 4 is damaged" in printed
    assert "going on from iteration 2" in printed
    assert {name: (finished / name).read_bytes() for name in wanted} == wanted


def test_every_phase_and_every_seed_draws_other_random_numbers():
    keys = [np.asarray(train.lane_keys(phase, seeds)) for phase in range(8) for seeds in ([0, 1, 2], [3])]
    assert len(np.unique(np.concatenate(keys), axis=0)) == 8 * 4
    # What the lanes beside a seed are does not matter.
    np.testing.assert_array_equal(train.lane_keys(3, [7, 1])[1], train.lane_keys(3, [1])[0])


# Several processes ---------------------------------------------------------------------------------------------------

LANES = 4
SHORT = ("iterations=30", "snapshot_every=2")


class Train:
    """Runs `eairl expert pendulum` of four seeds in processes of their own, with one cache of compiled programs."""

    def __init__(self, cache, settings):
        self._settings = [each for each in settings if not each.startswith(("iterations", "snapshot"))]
        self._environ = {name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"}
        self._environ |= {"JAX_PLATFORMS": "cpu", "XDG_CACHE_HOME": str(cache), "NPROC": str(2 * LANES)}

    def start(self, out, *more, devices=LANES):
        """Starts a process."""
        command = [sys.executable, "-m", "eairl_jax.experiments.cli", "expert", "pendulum", "--seeds", str(LANES)]
        return subprocess.Popen(
            [*command, "--out", str(out), *more, "--set", *self._settings, *SHORT],
            env=self._environ | {"JAX_NUM_CPU_DEVICES": str(devices)},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def start_two(self, out):
        """Starts two processes, with half of the devices each."""
        with socket.create_server(("127.0.0.1", 0)) as server:
            where = ("--coordinator", f"127.0.0.1:{server.getsockname()[1]}", "--processes", "2", "--process")
        return [self.start(out, *where, str(i), devices=LANES // 2) for i in range(2)]


def ended(process, code=0):
    """What a process printed; it must end with the code."""
    printed = process.communicate(timeout=300)[0]
    assert process.returncode == code, printed
    return printed


@pytest.fixture(scope="module")
def in_processes(tmp_path_factory, rl_settings):
    """`Train`, and the folder of a run of one process."""
    train = Train(tmp_path_factory.mktemp("cache"), rl_settings)
    folder = tmp_path_factory.mktemp("one") / "run"
    ended(train.start(folder))
    return train, folder


@pytest.fixture
def as_one(in_processes):
    """Asserts that a run has come to the bits of the run of one process."""
    _, one = in_processes

    def check(folder):
        assert (folder / "metrics.csv").read_bytes() == (one / "metrics.csv").read_bytes()
        states = [Checkpoints(each / "checkpoints")._manager.restore(30) for each in (folder, one)]
        jax.tree.map(np.testing.assert_array_equal, *states)
        summaries = [json.loads((each / "summary.json").read_text()) for each in (folder, one)]
        assert summaries[0]["returns"] == summaries[1]["returns"]

    return check


@pytest.mark.slow
def test_one_process_goes_on_where_two_were_when_one_of_them_died(in_processes, as_one, tmp_path):
    train, _ = in_processes
    leader, worker = train.start_two(tmp_path / "run")
    while not (tmp_path / "run/checkpoints/2/sha256.txt").exists():
        assert leader.poll() is None, leader.communicate()[0]
        time.sleep(0.02)
    worker.kill()
    printed = ended(leader, 1)
    assert printed.startswith("2 processes, with 2 + 2 devices\n")
    assert printed.splitlines()[-1].startswith("eairl: process 1 of 2 (")
    assert printed.endswith(") has ended: start all processes again: a training goes on from its last checkpoint\n")
    assert worker.communicate()[0] == ""
    assert "going on from iteration" in ended(train.start(tmp_path / "run"))
    as_one(tmp_path / "run")


@pytest.mark.slow
def test_two_processes_go_on_where_one_was(in_processes, as_one, tmp_path):
    """The run of one process is put back to its last checkpoint but one. The lines of metrics after that are void."""
    train, one = in_processes
    folder = shutil.copytree(one, tmp_path / "run")
    shutil.rmtree(folder / "checkpoints/30")
    (folder / "summary.json").unlink()
    leader, worker = train.start_two(folder)
    assert "run: going on from iteration 28 of 30" in ended(leader)
    assert ended(worker) == ""
    as_one(folder)


def test_a_team_learns_from_demonstrations_what_a_process_alone_learns(trained, tmp_path, imitate, tiny):
    with processes.leading(processes.Team([], [2])):  # a team of this process alone, with its two devices
        assert imitate(tmp_path / "run", tiny) == 0
    assert (tmp_path / "run" / "metrics.csv").read_bytes() == (trained / "metrics.csv").read_bytes()


@pytest.mark.parametrize("more", [(), ("--more-seeds", 2)])
def test_a_run_of_fewer_seeds_than_processes_is_refused_before_anything_is_computed(more, tmp_path, run, tiny, capsys):
    with processes.leading(processes.Team([], [1] * 3)):
        code = run("imitate", "pendulum", "--seeds", 2, *more, "--out", tmp_path / "run", "--set", *tiny)
    assert code == 2
    assert "3 processes are too many for 2 lanes" in capsys.readouterr().err
    assert not (tmp_path / "run/metrics.csv").exists()
