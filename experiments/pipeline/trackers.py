"""Trackers: the metrics of a training, chunk by chunk, for TensorBoard, Weights & Biases, or a program of the user.

A tracker is told of a chunk after `metrics.csv` and before the checkpoint. So after a kill it is told of the chunk
again, and it must take what it is told for the only truth about these iterations.
"""

from __future__ import annotations

import contextlib
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from eairl_jax import InputError, storage
from eairl_jax.config import choose
from eairl_jax.experiments.display.console import say
from eairl_jax.extras import required

Lane = dict[str, float]


@dataclass(frozen=True)
class Training:
    """What is tracked.

    Attributes:
      path: the run's folder.
      settings: of the run.
      labels: what tells the lanes apart, e.g. {"seed": 0}.
      steps: environment steps of an iteration.
      done: iterations that are done already.
    """

    path: Path
    settings: dict[str, Any]
    labels: Sequence[Lane]
    steps: int
    done: int


class Tracker(Protocol):
    """What is told of every chunk."""

    def log(self, first_iteration: int, metrics: dict[str, np.ndarray]) -> None:
        """A chunk.

        Args:
          first_iteration: iterations before the chunk.
          metrics: arrays `[lanes, length]`.
        """

    def close(self) -> None:
        """The training has ended, or was stopped."""


class TensorBoard:
    """Event files in the run's folder, `tensorboard/seed=0/` and so on; the step is that of the environment.

    What an earlier process wrote after its last checkpoint is void: the event with which a file starts says so.
    """

    def __init__(self, training: Training):
        from tensorboardX.proto import event_pb2, summary_pb2
        from tensorboardX.record_writer import RecordWriter

        self._event, self._summary, self._steps = event_pb2.Event, summary_pb2.Summary, training.steps
        first, now = training.done * training.steps + 1, time.time()
        start = event_pb2.SessionLog(status=event_pb2.SessionLog.START)
        self._files = []
        for label in training.labels:
            folder = training.path / "tensorboard" / lane_name(label)
            folder.mkdir(parents=True, exist_ok=True)
            file = RecordWriter(str(folder / f"events.out.tfevents.{int(now)}.{training.done}"))
            file.write(self._event(wall_time=now, file_version="brain.Event:2").SerializeToString())
            file.write(self._event(wall_time=now, step=first, session_log=start).SerializeToString())
            self._files.append(file)

    def log(self, first_iteration: int, metrics: dict[str, np.ndarray]) -> None:
        """One event for each lane and iteration, with all metrics: an event for each metric costs far more."""
        now, length = time.time(), next(iter(metrics.values())).shape[1]
        numbers = {name: np.asarray(x).tolist() for name, x in metrics.items()}  # NumPy's numbers are slow one by one
        for lane, file in enumerate(self._files):
            for t in range(length):
                values = [self._summary.Value(tag=name, simple_value=x[lane][t]) for name, x in numbers.items()]
                step = (first_iteration + t + 1) * self._steps
                event = self._event(wall_time=now, step=step, summary=self._summary(value=values))
                file.write(event.SerializeToString())
            file.flush()

    def close(self) -> None:
        """Closes the files."""
        for file in self._files:
            file.close()


class WandB:
    """A run of Weights & Biases. Metrics are named after the lane, "seed=0/true_return"; the step is the iteration.

    A training that goes on stays the same run there: `wandb/id` in the run's folder holds its name.
    """

    def __init__(self, training: Training):
        wandb = required("wandb", "wandb")
        self._labels = training.labels
        identity = training.path / "wandb" / "id"
        if not identity.exists():
            identity.parent.mkdir(exist_ok=True)
            with storage.replacing(identity) as path:
                path.write_text(uuid.uuid4().hex[:8], encoding="utf-8")
        self._run = wandb.init(
            project="eairl_jax",
            name=training.path.name,
            id=identity.read_text(encoding="utf-8"),
            resume="allow",
            dir=str(training.path),
            config=training.settings,
        )

    def log(self, first_iteration: int, metrics: dict[str, np.ndarray]) -> None:
        """One line for each iteration."""
        for t in range(next(iter(metrics.values())).shape[1]):
            line = {
                f"{lane_name(label)}/{name}": float(each[lane, t])
                for lane, label in enumerate(self._labels)
                for name, each in metrics.items()
            }
            self._run.log(line, step=first_iteration + t + 1)

    def close(self) -> None:
        """Ends the run."""
        self._run.finish()


TRACKERS: dict[str, Callable[[Training], Tracker]] = {"tensorboard": TensorBoard, "wandb": WandB}
Track = str | Callable[[Training], Tracker]


def lane_name(label: Lane) -> str:
    """For example "seed=0"."""
    return ",".join(f"{name}={value}" for name, value in label.items())


@contextlib.contextmanager
def tracked(track: Sequence[Track], training: Training) -> Iterator[Callable[[int, dict[str, np.ndarray]], None]]:
    """Opens trackers; gives the function that tells all of them of a chunk.

    A tracker that fails is left out from then on, with one warning. It never stops a training.

    Args:
      track: names in `TRACKERS`, or functions that make a `Tracker`.

    Raises:
      InputError: for an unknown name, or a library that is not installed.
    """
    live: dict[str, Tracker] = {}

    def guarded(name: str, call: Callable[[], Any]) -> Any:
        try:
            return call()
        except InputError:
            raise
        except Exception as e:  # whatever a tracker raises
            say(f"the tracker {name} failed and is left out from now on: {type(e).__name__}: {e}")
            live.pop(name, None)

    def log(first_iteration: int, metrics: dict[str, np.ndarray]) -> None:
        for name, tracker in list(live.items()):
            guarded(name, lambda tracker=tracker: tracker.log(first_iteration, metrics))

    for each in track:
        if isinstance(each, str):
            choose("tracker", each, TRACKERS)
        name = each if isinstance(each, str) else getattr(each, "__name__", str(each))
        make = TRACKERS[each] if isinstance(each, str) else each
        opened = guarded(name, lambda make=make: make(training))
        if opened is not None:
            live[name] = opened
    try:
        yield log
    finally:
        for name, tracker in list(live.items()):
            guarded(name, tracker.close)
