"""The host's side of training: chunks, checkpoints between them, metrics, progress, going on after a kill, scores."""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.text import Text

from eairl_jax import Algorithm, Checkpoints, Diverged, InputError, Lanes, evaluate
from eairl_jax.envs.mjx_task import Task
from eairl_jax.experiments.display.console import console, say
from eairl_jax.experiments.pipeline import divergence, trackers
from eairl_jax.experiments.pipeline.interruption import Interruption
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.experiments.settings import Recipe
from eairl_jax.lanes import KEPT_PROGRAMS
from eairl_jax.programs import Program
from eairl_jax.types import Key, PyTree

RUNS = Path("runs")
EVALUATION_EPISODES = 100

# Phases of an experiment, for `lane_keys`.
LEARN, RETRAIN, SOURCE_RETRAIN, EVALUATE, CLOSENESS, PLAN, JUDGE, DIAGNOSE, RANK = range(9)

# What tells a lane from the others: its seed, its restart, its point of a sweep, ...
Lane = dict[str, float]


@dataclass(frozen=True)
class Start:
    """The states with which a training begins, if not with those of `Lanes.init`.

    Attributes:
      iteration: iterations that these states have behind them.
      states: makes the states, NumPy arrays `[lanes, ...]`. The function is called whenever the folder has no
        checkpoint yet, so it must return the same states after a kill.
    """

    iteration: int
    states: Callable[[], PyTree]


def lane_keys(phase: int, *numbers: Sequence[float]) -> Key:
    """One random key for each lane, `[lanes]`, from everything that tells the lane apart.

    Args:
      phase: of the experiment; each phase draws other random numbers.
      numbers: sequences of one length: the lanes' seeds, and for example their restarts.
    """

    def key(*lane_numbers):
        return functools.reduce(jax.random.fold_in, lane_numbers, jax.random.PRNGKey(phase))

    return jax.vmap(key)(*(np.asarray(each) for each in numbers))


def take_lanes(tree: PyTree, lanes: np.ndarray | Sequence[int]) -> PyTree:
    """The given lanes of every leaf `[lanes, ...]`, as NumPy arrays."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[lanes], tree)


def train(
    folder: RunFolder,
    title: str,
    lanes: Lanes,
    recipe: Recipe,
    labels: list[Lane],
    on_snapshot: Callable[[int, PyTree], None] | None = None,
    start: Start | None = None,
) -> PyTree:
    """Trains all lanes to the end of the recipe, going on from the folder's last checkpoint.

    A chunk is `recipe.snapshot_every` iterations of one compiled program. After a chunk its metrics are written, then
    its snapshot, then its checkpoint. So everything that a checkpoint claims to have been done is on disk.

    Args:
      title: what the progress bar shows.
      labels: what tells the lanes apart in `metrics.csv`.
      on_snapshot: called with `(iteration, state)` after each chunk, the state as NumPy arrays `[lanes, ...]`.
      start: the states to begin with; those of `lanes.init` if None.

    Returns:
      The final state, NumPy arrays `[lanes, ...]`; of a dropped lane (`divergence`) its last good state.

    Raises:
      Diverged: when a metric or the state is no longer finite, and `recipe.on_nan` is "stop" or no lane is left.
      InputError: if another process is training in the folder.
    """
    with folder.locked():
        iterations, chunk = recipe.last_iteration, recipe.snapshot_every
        _refuse_cleaned(folder.path)
        checkpoints = Checkpoints(folder.path / "checkpoints")
        first = start.iteration if start else 0
        restored = checkpoints.restore_newest(lanes.blank)
        for damaged in restored.damaged:
            say(f"{title}: the checkpoint of iteration {damaged} is damaged, it is made again")
        done = restored.iteration or first
        if restored.iteration is not None:
            state = lanes.put(restored.state)
            say(f"{title}: going on from iteration {done} of {iterations}")
        else:
            state = lanes.put(start.states()) if start else lanes.init()
        if done >= iterations:
            return lanes.take(state)
        folder.keep_metrics((done - first) * len(labels), labels)
        steps = recipe.config.steps_per_iteration
        tracked = trackers.tracked(folder.track, trackers.Training(folder.path, folder.settings, labels, steps, done))
        with contextlib.ExitStack() as stack:
            tell_trackers = stack.enter_context(tracked)
            with console.status(Text(f"{title}: compiling")):
                compile_seconds = lanes.compile(state, chunk)
            folder.add_seconds(compile_seconds=compile_seconds)
            report = stack.enter_context(_Report(title, recipe, len(labels), done))
            interruption = stack.enter_context(Interruption())
            guard = divergence.Guard(folder, title, labels, recipe.on_nan, lanes.take(state))
            while done < iterations:
                started = time.perf_counter()
                state, metrics = lanes.run(state, chunk, check=False)
                seconds = time.perf_counter() - started
                reached = lanes.take(state)
                snapshot, metrics = guard.checked(done, reached, metrics, checkpoints.latest())
                if snapshot is not reached:
                    state = lanes.put(snapshot)
                folder.append_metrics(done, steps, labels, metrics)
                tell_trackers(done, metrics)
                done += chunk
                if on_snapshot:
                    on_snapshot(done, snapshot)
                checkpoints.save(done, snapshot)
                folder.add_seconds(run_seconds=seconds)
                report.update(done, seconds, metrics["true_return"])
                interruption.stop_if_asked()
        say(f"{title}: compiled in {compile_seconds:.1f} s")
        return lanes.take(state)


def _refuse_cleaned(path: Path) -> None:
    """Raises `InputError` if a run is finished and its checkpoints were removed: it would begin anew."""
    if (path / "summary.json").exists() and not (path / "checkpoints").exists():
        raise InputError(
            f"{path} is finished and has no checkpoints any more (`eairl clean`), so it cannot go on: choose another "
            "folder with --out, or remove this one to train anew"
        )


class _Report:
    """Shows how far a training is: a bar in a terminal, a line for each chunk elsewhere."""

    def __init__(self, title: str, recipe: Recipe, lanes: int, done: int):
        self._title, self._iterations = title, recipe.last_iteration
        self._steps = lanes * recipe.snapshot_every * recipe.config.steps_per_iteration
        self._progress = Progress(
            TextColumn("{task.description}", style="bold", markup=False),
            BarColumn(),
            TextColumn("{task.completed}/{task.total} iterations"),
            TextColumn("{task.fields[rate]}"),
            TextColumn("{task.fields[score]}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
        )
        self._task = self._progress.add_task(title, total=self._iterations, completed=done, rate="", score="")

    def __enter__(self) -> _Report:
        self._progress.start()
        return self

    def __exit__(self, *_exception) -> None:
        self._progress.stop()

    def update(self, done: int, seconds: float, true_return: np.ndarray) -> None:
        """Shows a finished chunk; `true_return` is `[lanes, chunk]`."""
        rate = f"{self._steps / seconds:,.0f} env steps/s"
        last = true_return[:, -5:]
        last = last[np.isfinite(last)]
        score = f"true return {last.mean():.2f}" if last.size else ""
        self._progress.update(self._task, completed=done, rate=rate, score=score)
        if not console.is_terminal:
            console.print(f"{self._title}: iteration {done}/{self._iterations}  {rate}  {score}", soft_wrap=True)


def final_returns(
    env: Task,
    algorithm: Algorithm,
    state: PyTree,
    seeds: Sequence[float],
    episodes: int | None = None,
    sampled: bool = True,
) -> np.ndarray:
    """True returns `[lanes, episodes]` of every lane's policy over fresh whole episodes.

    The episodes depend on the lane's seed alone, so a policy's score never depends on the lanes beside it.

    Args:
      episodes: `EVALUATION_EPISODES` if None.
      sampled: whether the policy samples its actions or takes its mean action.

    Raises:
      Diverged: if a return is not finite.
    """
    program = returns_program(env, algorithm, episodes, sampled)
    returns = np.asarray(program(jax.tree.map(jax.numpy.asarray, state), lane_keys(EVALUATE, seeds)))
    if not np.isfinite(returns).all():
        lane, episode = np.argwhere(~np.isfinite(returns))[0]
        raise Diverged(
            f"the policy of seed {seeds[lane]} has a true return of {returns[lane, episode]} in episode {episode}: the "
            "policy or the simulation has diverged, so there is no score",
            "true_return",
            int(lane),
            int(episode),
            float(returns[lane, episode]),
        )
    return returns


def returns_program(env: Task, algorithm: Algorithm, episodes: int | None = None, sampled: bool = True) -> Program:
    """The program of `final_returns`: `(state, keys) -> returns [lanes, episodes]`. The last ones stay compiled."""
    return _returns_program(env, algorithm, episodes or EVALUATION_EPISODES, sampled)


@functools.lru_cache(KEPT_PROGRAMS)
def _returns_program(env: Task, algorithm: Algorithm, episodes: int, sampled: bool) -> Program:

    def lane_returns(state, key):
        def act(obs, key):
            return algorithm.act(state, obs, key if sampled else None)

        return evaluate(key, env, act, episodes, env.episode_length)[0]

    return Program(jax.vmap(lane_returns))


def scores(
    folder: RunFolder,
    recipe: Recipe,
    env: Task,
    algorithm: Algorithm,
    state: PyTree,
    labels: list[Lane],
    sampled: bool = True,
) -> np.ndarray:
    """Mean true return `[lanes]` of every lane's policy; NaN for a lane that was dropped before, or is dropped here.

    Args:
      folder: whose `dropped.json` says which lanes were dropped.
      recipe: `recipe.on_nan` says whether a policy is dropped that has no finite return.
      labels: what tells the lanes apart; each has a seed.
      sampled: as in `final_returns`.

    Raises:
      Diverged: if a return is not finite and `recipe.on_nan` is "stop", or if no lane is left.
    """
    while True:
        kept = divergence.kept(folder, labels)
        seeds = [labels[lane]["seed"] for lane in kept]
        try:
            returns = final_returns(env, algorithm, take_lanes(state, kept), seeds, sampled=sampled)
        except Diverged as e:
            if recipe.on_nan == "stop":
                raise
            label = labels[kept[e.lane]]
            folder.drop([divergence.entry(label, divergence.EVALUATION, e.metric, recipe.last_iteration, e.value)])
            continue
        means = np.full(len(labels), np.nan)
        means[kept] = returns.mean(axis=1)
        return means
