"""The host's side of training: chunks, checkpoints between them, metrics, progress, and going on after a kill."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import jax
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from eairl_jax import Algorithm, Checkpoints, Lanes, evaluate
from eairl_jax.envs.mjx_task import MjxTask
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.experiments.recipes import Recipe
from eairl_jax.types import PyTree

console = Console()
RUNS = Path("runs")
EVALUATION_EPISODES = 100

# Phases of an experiment, for `lane_keys`.
LEARN, RETRAIN, SOURCE_RETRAIN, EVALUATE, CLOSENESS = range(5)


class Diverged(RuntimeError):
    """A metric became NaN or infinite; the message says which, where, and what is kept."""


def say(message: str) -> None:
    """A remark to the user: dim, and never wrapped, so that paths can be copied."""
    console.print(message, style="dim", markup=False, soft_wrap=True, highlight=False)


def lane_keys(phase: int, *numbers: Sequence[int]) -> jax.Array:
    """One random key a lane, `[lanes]`, from all that tells it apart.

    Args:
      phase: of the experiment; each draws its own random numbers.
      numbers: of every lane, for example its seed, and its restart.
    """

    def key(*own):
        return functools.reduce(jax.random.fold_in, own, jax.random.PRNGKey(phase))

    return jax.vmap(key)(*(np.asarray(each) for each in numbers))


def train(
    folder: RunFolder,
    title: str,
    lanes: Lanes,
    recipe: Recipe,
    labels: list[dict],
    on_snapshot: Callable[[int, PyTree], None] | None = None,
) -> PyTree:
    """Trains all lanes to the end of the recipe, going on from the folder's last checkpoint.

    A chunk is `recipe.snapshot_every` iterations of one compiled program. After it: its metrics, its snapshot,
    then its checkpoint, so that whatever a checkpoint claims to have been done is on disk.

    Args:
      title: of the progress bar.
      labels: what tells the lanes apart in `metrics.csv`.
      on_snapshot: given `(iteration, state)` after each chunk, the state as NumPy arrays `[lanes, ...]`.

    Returns:
      The final state, NumPy arrays `[lanes, ...]`.

    Raises:
      Diverged: when a metric is no longer finite.
      InputError: if another process is training in the folder.
    """
    with folder.locked():
        config, chunk = recipe.config, recipe.snapshot_every
        checkpoints = Checkpoints(folder.path / "checkpoints")
        state = lanes.init()
        done = checkpoints.latest() or 0
        if done:
            state = lanes.put(checkpoints.restore(done, lanes.take(state)))
            say(f"{title}: going on from iteration {done} of {config.iterations}")
        if done >= config.iterations:
            return lanes.take(state)
        with console.status(f"{title}: compiling"):
            compile_seconds = lanes.compile(state, chunk)
        folder.add_seconds(compile_seconds=compile_seconds)
        with _progress() as progress:
            task = progress.add_task(title, total=config.iterations, completed=done, rate="", score="")
            while done < config.iterations:
                started = time.perf_counter()
                state, metrics = lanes.run(state, chunk)
                taken = time.perf_counter() - started
                _refuse_nan(metrics, done, labels, checkpoints.latest())
                snapshot = lanes.take(state)
                folder.append_metrics(done, config.steps_per_iteration, labels, metrics)
                done += chunk
                if on_snapshot:
                    on_snapshot(done, snapshot)
                checkpoints.save(done, snapshot)
                folder.add_seconds(run_seconds=taken)
                rate = f"{len(labels) * chunk * config.steps_per_iteration / taken:,.0f} env steps/s"
                ended = metrics["true_return"][:, -5:]
                ended = ended[np.isfinite(ended)]
                score = f"true return {ended.mean():.2f}" if ended.size else ""
                progress.update(task, completed=done, rate=rate, score=score)
                if not console.is_terminal:
                    console.print(f"{title}: iteration {done}/{config.iterations}  {rate}  {score}", soft_wrap=True)
        say(f"{title}: compiled in {compile_seconds:.1f} s")
        return lanes.take(state)


def final_returns(
    env: MjxTask,
    algorithm: Algorithm,
    state: PyTree,
    seeds: Sequence[int],
    episodes: int | None = None,
    sampled: bool = True,
) -> np.ndarray:
    """True returns `[lanes, episodes]` of every lane's policy over fresh whole episodes (100 unless told).

    The episodes are a matter of the lane's seed alone, so that a policy's score never depends on its neighbours.
    """
    episodes = episodes or EVALUATION_EPISODES

    def one(state, key):
        act = lambda obs, key: algorithm.act(state, obs, key if sampled else None)  # noqa: E731
        return evaluate(key, env, act, episodes, env.episode_length)[0]

    state = jax.tree.map(jax.numpy.asarray, state)
    return np.asarray(jax.jit(jax.vmap(one))(state, lane_keys(EVALUATE, seeds)))


def _progress() -> Progress:
    return Progress(
        TextColumn("[bold]{task.description}"),
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


def _refuse_nan(metrics: dict, done: int, labels: list[dict], kept: int | None) -> None:
    for name, values in metrics.items():
        # No episode may have ended yet, and then there is no true return.
        bad = np.isinf(values) if name == "true_return" else ~np.isfinite(values)
        if bad.any():
            lane, t = np.argwhere(bad)[np.argwhere(bad)[:, 1].argmin()]
            where = ", ".join(f"{k} {v}" for k, v in labels[lane].items())
            last = f"the checkpoint of iteration {kept} is kept" if kept else "no checkpoint had been written yet"
            raise Diverged(
                f"{name} became {values[lane, t]} at iteration {done + t + 1} ({where}); {last}. "
                "Try a lower learning rate (--set policy_lr=..., discriminator_lr=...) in a new --out"
            )


def default_out(name: str) -> Path:
    """Where a run goes unless the user says otherwise."""
    return RUNS / name
