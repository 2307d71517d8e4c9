"""Runs beside each other: their curves, their scores, and how sure the difference is."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eairl_jax import InputError, schema
from eairl_jax.experiments.pipeline import more_seeds, overview, points, records, statistics
from eairl_jax.experiments.pipeline.following import Reader
from eairl_jax.storage import read_json

METRIC = "true_return"
POINTS = 150
"""The most points of a curve that is drawn."""
SUMMARY = schema.record(
    {"returns": schema.list_of(schema.number(), low=1)},
    {
        "seeds": schema.list_of(schema.whole(0), low=1),
        "points": schema.list_of(schema.table_of(schema.number())),
        "dropped": records.DROPPED_LIST,
        "expert": schema.optional(schema.number()),
        "random": schema.number(),
    },
)


@dataclass(frozen=True)
class Compared:
    """A run, or one point of a sweep.

    Attributes:
      name: of the run's folder, and of the point.
      task, method: what it trains.
      iterations: done so far.
      scores: `[seeds]` true returns at the end; of a run that is not finished, means of the last tenth so far.
      curve: `[lanes, iterations]` of the metric; NaN where it is unknown.
      steps: environment steps of a seed in one iteration.
      expert, random: what scores are normalised by; None if unknown.
      is_finished: whether the scores are those of the result.
    """

    name: str
    task: str
    method: str
    iterations: int
    scores: np.ndarray
    curve: np.ndarray
    steps: int
    expert: float | None
    random: float | None
    is_finished: bool

    def normalized(self, metric: str) -> Compared:
        """The same with scores, and a curve of the true return, on a scale from 0 (random actions) to 1 (expert).

        Raises:
          InputError: if the run does not know the returns of both.
        """
        if self.expert is None or self.random is None:
            raise InputError(
                f"the runs are of different tasks, and {self.name} has no normalised score: compare runs of one task, "
                "or finished imitations and transfers of tasks whose expert is known"
            )
        low, span = self.random, self.expert - self.random
        curve = (self.curve - low) / span if metric == METRIC else self.curve
        return dataclasses.replace(self, scores=(self.scores - low) / span, curve=curve)


def read(path: Path, metric: str) -> list[Compared]:
    """What a run holds to be compared; of a sweep each point.

    Raises:
      InputError: if the folder is no run's, or holds no metrics yet, or not this one.
    """
    if not (path / "config.json").is_file():
        raise InputError(f"{path} is no run's folder: give folders of `eairl expert`, imitate, sweep or transfer")
    found = overview.read(path, path.name)
    if found.problem:
        raise InputError(f"{path}: {found.problem}")
    summary = read_json(path / "summary.json", SUMMARY, records.AGAIN) if found.is_finished else {}
    settings, lanes, steps = records.settings(path), Lanes(), 0
    for folder in (path, *more_seeds.finished(path)):
        steps = lanes.add(folder, metric) or steps
    compared = []
    for point in settings.get("sweep") or [{}]:
        chosen = lanes.of(point)
        scores = _scores(summary, point) if summary else _late(lanes.of(point, METRIC))
        if len(scores):
            name = ", ".join(filter(None, [path.resolve().name, points.name(point)]))
            reference = summary.get("expert"), summary.get("random")
            compared.append(
                Compared(
                    name, found.task, found.method, found.done, scores, chosen, steps, *reference, found.is_finished
                )
            )
    return compared


class Lanes:
    """Metrics of lanes, by what tells the lanes apart."""

    def __init__(self) -> None:
        self._values: dict[tuple[tuple[str, float], ...], dict[str, dict[int, float]]] = {}

    def add(self, folder: Path, metric: str) -> int:
        """Reads the `metrics.csv` of a folder. Returns the environment steps of an iteration.

        Raises:
          InputError: if there are no metrics yet, or if they are damaged, or if the metric is none of them.
        """
        reader = Reader(folder)
        try:
            rows = reader.news()
        except FileNotFoundError:
            raise InputError(f"{folder} has no metrics yet: wait until its first iterations are done") from None
        if not reader.names:
            raise reader.no_table()
        if metric not in reader.names:
            raise InputError(f"--metric {metric}: {reader.path} has {', '.join(reader.names)}")
        first = len(reader.labels)
        columns = {name: first + 2 + reader.names.index(name) for name in {metric, METRIC} & set(reader.names)}

        def keep(row: list[str]) -> int:
            label = tuple(zip(reader.labels, map(float, row[:first]), strict=True))
            iteration, env_steps = int(row[first]), int(row[first + 1])
            lane = self._values.setdefault(label, {metric: {}, METRIC: {}})
            for name, column in columns.items():
                lane[name][iteration] = float(row[column])
            return env_steps // iteration

        steps = [reader.parsed(row, keep) for row in rows]
        return steps[-1] if steps else 0

    def of(self, point: dict[str, float], metric: str | None = None) -> np.ndarray:
        """`[lanes, iterations]` of the lanes of a point, from iteration 1 on; NaN where a value is unknown."""
        lanes = [
            (values[metric] if metric else next(iter(values.values())))
            for label, values in self._values.items()
            if all(np.isclose(dict(label).get(name, np.nan), value) for name, value in point.items())
        ]
        last = max((max(lane, default=0) for lane in lanes), default=0)
        curve = np.full((len(lanes), last), np.nan)
        for row, lane in zip(curve, lanes, strict=True):
            for iteration, value in lane.items():
                row[iteration - 1] = value if np.isfinite(value) else np.nan
        return curve


def _scores(summary: dict, point: dict[str, float]) -> np.ndarray:
    """The returns of a result; those of one point of a sweep, without the seeds that were dropped there."""
    if not point:
        return np.array(summary["returns"])
    known = summary["points"]
    of_points = points.returns(known, summary["seeds"], summary["returns"], summary.get("dropped", []))
    return np.array(of_points[known.index(point)] if point in known else [], float)


def _late(curve: np.ndarray) -> np.ndarray:
    """The mean of each lane's last tenth; lanes in which no episode has ended are left out."""
    late = np.ma.masked_invalid(curve[:, -max(1, curve.shape[1] // 10) :]).mean(axis=1)
    return np.ma.compressed(late)


def thinned(curve: np.ndarray, steps: int) -> tuple[np.ndarray, int]:
    """A curve `[lanes, iterations]` as at most `POINTS` means over equally many iterations.

    Args:
      steps: environment steps of an iteration.

    Returns:
      The means `[lanes, points]`, NaN where nothing is known, and the environment steps between two of them.
    """
    each = -(-curve.shape[1] // POINTS) or 1
    whole = curve.shape[1] // each * each
    parts = np.ma.masked_invalid(curve[:, :whole].reshape(len(curve), -1, each)).mean(axis=2)
    return np.ma.filled(parts, np.nan), steps * each


def middle(compared: Compared) -> statistics.Estimate:
    """The interquartile mean over the seeds."""
    return statistics.interquartile_mean([compared.scores])


def improvement(compared: Compared, first: Compared) -> statistics.Estimate:
    """The probability that a seed of this run scores above a seed of the first; ties count half."""
    return statistics.probability_of_improvement([compared.scores], [first.scores])


def check_comparable(compared: Sequence[Compared], metric: str) -> list[Compared]:
    """The runs with scores that can be compared: normalised ones if the tasks differ.

    Raises:
      InputError: if there is one run alone, or if tasks differ and a run has no normalised score.
    """
    if len(compared) < 2:
        raise InputError("nothing to compare: give at least two runs, or a sweep")
    if len({each.task for each in compared}) == 1:
        return list(compared)
    return [each.normalized(metric) for each in compared]
