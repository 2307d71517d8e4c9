"""Trackers are told what `metrics.csv` holds, and nothing that they do stops a training."""

import csv
import json
import math
import struct
import sys
import time
import types

import numpy as np
import pytest
from tensorboardX.proto import event_pb2

from eairl_jax import InputError
from eairl_jax.experiments.pipeline import trackers
from eairl_jax.experiments.pipeline.trackers import TensorBoard, Training, WandB, tracked

LABELS = [{"seed": 0}, {"seed": 3}]


def events(folder):
    """What TensorBoard shows of a folder: `(step, tag)` to value. A start voids what was written of its step and on."""
    shown = {}
    for path in sorted(folder.iterdir()):
        data, at = path.read_bytes(), 0
        while at < len(data):
            (length,) = struct.unpack("<Q", data[at : at + 8])
            event = event_pb2.Event.FromString(data[at + 12 : at + 12 + length])
            at += 12 + length + 4
            if event.session_log.status == event.session_log.START:
                shown = {key: value for key, value in shown.items() if key[0] < event.step}
            for value in event.summary.value:
                assert (event.step, value.tag) not in shown
                shown[event.step, value.tag] = value.simple_value
    return shown


def chunk(first, length):
    lanes = np.arange(2)[:, None]
    return {"loss": first + np.arange(length) + 0.25 * lanes, "true_return": np.full((2, length), np.nan)}


def training(path, done=0):
    return Training(path, {"task": "pendulum"}, LABELS, 10, done)


def test_events_of_a_chunk_that_is_done_again_are_void(tmp_path):
    for first, chunks in ((0, 2), (3, 2)):  # the second chunk of the first process had no checkpoint
        tracker = TensorBoard(training(tmp_path, first))
        for number in range(chunks):
            tracker.log(first + 3 * number, chunk(first + 3 * number, 3))
        tracker.close()
    for lane, name in enumerate(("seed=0", "seed=3")):
        found = events(tmp_path / "tensorboard" / name)
        losses = {step: value for (step, tag), value in found.items() if tag == "loss"}
        assert losses == {10 * (i + 1): i + 0.25 * lane for i in range(9)}
        assert all(np.isnan(value) for (_, tag), value in found.items() if tag == "true_return")


def test_a_command_tracks_what_its_metrics_hold(trained):
    with open(trained / "metrics.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    for seed in (0, 1):
        found = events(trained / "tensorboard" / f"seed={seed}")
        mine = [row for row in rows if row["seed"] == str(seed)]
        names = sorted(set(mine[0]) - {"seed", "iteration", "env_steps"})
        assert len(found) == len(mine) * len(names)
        for row in mine:
            for name in names:
                np.testing.assert_allclose(found[int(row["env_steps"]), name], float(row[name]), rtol=1e-5)


@pytest.fixture
def wandb(monkeypatch):
    """A module that records what it is told, in place of the library."""
    told = types.SimpleNamespace(started={}, lines={}, is_finished=False)

    class Run:
        def log(self, line, step):
            told.lines[step] = line

        def finish(self):
            told.is_finished = True

    def init(**arguments):
        told.started = arguments
        return Run()

    monkeypatch.setitem(sys.modules, "wandb", types.SimpleNamespace(init=init))
    return told


def test_weights_and_biases_gets_a_line_for_each_iteration(tmp_path, wandb):
    with tracked(["wandb"], training(tmp_path)) as log:
        log(0, chunk(0, 2))
    assert wandb.started["config"] == {"task": "pendulum"}
    assert sorted(wandb.lines) == [1, 2]
    assert wandb.lines[2]["seed=3/loss"] == 1.25
    assert wandb.is_finished


def test_a_training_that_goes_on_stays_one_run_there(tmp_path, wandb):
    seen = []
    for done in (0, 2):
        with tracked(["wandb"], training(tmp_path, done)):
            seen.append((wandb.started["id"], wandb.started["resume"]))
    assert len(set(seen)) == 1
    assert seen[0][1] == "allow"


def log_records(data):
    """The records of a log file of Weights & Biases: LevelDB's log format after a header of 7 bytes."""
    at, block, record = 7, 32768, b""
    while at + 7 <= len(data):
        if block - at % block < 7:  # too short for a header: the rest of a block is empty
            at += block - at % block
            continue
        _crc, length, kind = struct.unpack("<IHB", data[at : at + 7])
        record += data[at + 7 : at + 7 + length]
        at += 7 + length
        if kind in (1, 4):  # whole, or the last part
            yield record
            record = b""


@pytest.mark.extras
def test_the_library_itself_holds_what_it_was_told(tmp_path, monkeypatch):
    pytest.importorskip("wandb")
    from wandb.proto import wandb_internal_pb2

    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")
    with tracked(["wandb"], training(tmp_path)) as log:
        log(0, chunk(0, 2))
        log(2, chunk(2, 300))
    (file,) = tmp_path.glob("wandb/offline-run-*/run-*.wandb")
    assert file.name == f"run-{(tmp_path / 'wandb' / 'id').read_text()}.wandb"
    for _ in range(100):  # the library's own process may write for a moment longer
        records = [wandb_internal_pb2.Record.FromString(data) for data in log_records(file.read_bytes())]
        if records[-1].WhichOneof("record_type") == "exit":
            break
        time.sleep(0.1)
    lines = [
        {"/".join(item.nested_key) or item.key: json.loads(item.value_json) for item in record.history.item}
        for record in records
        if record.WhichOneof("record_type") == "history"
    ]
    assert [line["_step"] for line in lines] == list(range(1, 303))
    for lane, name in enumerate(("seed=0", "seed=3")):
        assert [line[f"{name}/loss"] for line in lines] == [i + 0.25 * lane for i in range(302)]
        assert all(math.isnan(line[f"{name}/true_return"]) for line in lines)
    (settings,) = [record.run.config for record in records if record.WhichOneof("record_type") == "run"]
    assert {update.key: json.loads(update.value_json) for update in settings.update}["task"] == "pendulum"


class Failing:
    def __init__(self, _training):
        self.calls = 0

    def log(self, _first_iteration, _metrics):
        raise OSError("no network")

    def close(self):
        raise OSError("no network")


class Recording(Failing):
    told = ()

    def log(self, first_iteration, metrics):
        Recording.told = (*Recording.told, (first_iteration, metrics["loss"].shape))

    def close(self):
        pass


def test_a_tracker_that_fails_is_left_out_and_the_others_go_on(tmp_path, capsys):
    with tracked([Failing, Recording, lambda _: 1 / 0], training(tmp_path)) as log:
        log(0, chunk(0, 2))
        log(2, chunk(2, 2))
    assert Recording.told == ((0, (2, 2)), (2, (2, 2)))
    printed = capsys.readouterr().out
    assert printed.count("the tracker Failing failed") == 1
    assert printed.count("ZeroDivisionError") == 1


def test_what_cannot_track_is_refused_first(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb", None)
    with pytest.raises(InputError, match=r'pip install "eairl-jax\[wandb\]"'), tracked(["wandb"], training(tmp_path)):
        pass
    with pytest.raises(InputError, match="unknown tracker 'tensorbord'"), tracked(["tensorbord"], training(tmp_path)):
        pass
    assert set(trackers.TRACKERS) == {"tensorboard", "wandb"}
    assert trackers.TRACKERS["wandb"] is WandB
