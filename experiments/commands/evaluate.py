"""`eairl evaluate`: score the policies of a run on fresh episodes, in MJX and in MuJoCo's C engine."""

from __future__ import annotations

from pathlib import Path

import jax
import numpy as np
from rich.text import Text

from eairl_jax import InputError
from eairl_jax.arguments import count
from eairl_jax.envs import c_engine
from eairl_jax.envs.mjx_task import MjxTask
from eairl_jax.experiments.display import page, score_page
from eairl_jax.experiments.display.console import Layout, console, print_rows, say
from eairl_jax.experiments.display.plots import Dots
from eairl_jax.experiments.options import Evaluate
from eairl_jax.experiments.pipeline import policies
from eairl_jax.experiments.pipeline.places import make_env
from eairl_jax.experiments.pipeline.policies import Policies
from eairl_jax.experiments.pipeline.run_folder import check_writable, machine
from eairl_jax.experiments.pipeline.train import EVALUATE, RUNS, final_returns, lane_keys
from eairl_jax.storage import write_json

MOST_EPISODES = 100_000
ENGINES = {"c": "C engine", "exact": "C engine, exact"}


def run(options: Evaluate, command_line: str) -> None:
    """Prints a line for each seed: the mean true return in each engine, and how far the engines are apart."""
    episodes, sampled = options.episodes, not options.mean_action
    count("--episodes", episodes, 0, MOST_EPISODES)
    if episodes < 2:
        raise InputError(f"--episodes {episodes}: expected at least 2, for a standard error")
    trained = policies.load(options.run_folder, may_be_unfinished=True)
    folder = _page_folder(options)
    if options.json:
        check_writable(options.json)
    env = _c_engine_task(trained, options.engine)
    engine = "MJX" if isinstance(trained.env, MjxTask) else "JAX"
    returns = {engine: final_returns(trained.env, trained.algorithm, trained.state, trained.seeds, episodes, sampled)}
    if env is not None:
        with console.status(Text(f"{trained.task}: {episodes} episodes of each seed in the C engine")):
            returns[ENGINES[options.engine]] = c_engine_returns(trained, env, episodes, sampled)
    policy = "sampled policy" if sampled else "mean action"
    title = f"{trained.task}: true return, {policy}, {episodes} episodes a seed"
    columns, rows = _table(trained.seeds, returns)
    print_rows(title, columns, rows, Layout(folded=(), apart=int(len(trained.seeds) > 1)))
    for note in _notes(returns):
        say(note)
    if folder:
        table = page.Table("Scores", columns, rows, "; ".join(_notes(returns)))
        names = [f"seed {seed}" for seed in trained.seeds]
        panels = [
            Dots(engine, "true return, a dot an episode", dict(zip(names, each, strict=True)))
            for engine, each in returns.items()
        ]
        facts = {"command": command_line}
        score_page.write(folder, options.run_folder.resolve().name, title, [table], panels, facts)
        say(f"in {folder}/; index.html shows all of it")
    if options.json:
        content = {"command_line": command_line, "task": trained.task, "seeds": trained.seeds, "machine": machine()}
        figures = {engine: each.tolist() for engine, each in returns.items()}
        write_json(options.json, content | {"returns": figures})


def _page_folder(options: Evaluate) -> Path | None:
    """Where the figure and the page are written; None if that is the default and it cannot be written.

    Raises:
      InputError: if the folder that the user names cannot be written.
    """
    name = "-".join(["evaluate", options.run_folder.resolve().name, *(["mean"] if options.mean_action else [])])
    folder = options.out or RUNS / name
    try:
        check_writable(folder / "index.html")
    except InputError as e:
        if options.out:
            raise
        say(f"no figure and no page: {e}")
        return None
    return folder


def _c_engine_task(trained: Policies, engine: str) -> MjxTask | None:
    """The task for the C engine; None if the engine is not asked for.

    Raises:
      InputError: if the task is none that the C engine can simulate.
    """
    if engine not in ENGINES:
        return None
    if not isinstance(trained.env, MjxTask):
        raise InputError(
            f"--engine {engine}: the C engine needs a task that derives from eairl_jax.envs.mjx_task.MjxTask, which "
            f"{trained.task} does not: leave --engine out"
        )
    env = make_env(trained.task, fidelity="exact") if engine == "exact" else trained.env
    assert isinstance(env, MjxTask)
    return env


def c_engine_returns(trained: Policies, env: MjxTask, episodes: int, sampled: bool) -> np.ndarray:
    """True returns `[seeds, episodes]` in the C engine of `env`; episodes start as those of `final_returns` do."""
    engines = [c_engine.make(env) for _ in range(episodes)]
    limit, length = env.action_limit, env.episode_length

    @jax.jit
    def act(state, obs, key):
        return jax.numpy.clip(trained.algorithm.act(state, obs, key if sampled else None), -limit, limit)

    def seed_returns(state, key) -> np.ndarray:
        reset_key, key = jax.random.split(key)
        starts = map(np.asarray, jax.vmap(env.initial)(jax.random.split(reset_key, episodes)))
        obs = np.stack([engine.start(*start) for engine, *start in zip(engines, *starts, strict=True)])
        total = np.zeros(episodes)
        for step_key in jax.random.split(key, length):
            actions = np.asarray(act(state, obs.astype(np.float32), step_key))
            steps = [engine.step(action) for engine, action in zip(engines, actions, strict=True)]
            obs = np.stack([obs for obs, _ in steps])
            total += [reward for _, reward in steps]
        return total

    keys = lane_keys(EVALUATE, trained.seeds)
    return np.stack([seed_returns(trained.lane(lane), key) for lane, key in enumerate(keys)])


def _table(seeds: list[int], returns: dict[str, np.ndarray]) -> tuple[list[str], list[list[str]]]:
    """`(titles of the columns, rows)`; `returns` holds `[seeds, episodes]` by engine."""
    titles = ["seed", *returns, *(["C over MJX"] if len(returns) > 1 else [])]
    rows = []
    for lane, seed in enumerate(seeds):
        lane_returns = [each[lane] for each in returns.values()]
        cells = [f"{each.mean():.2f} ± {each.std(ddof=1) / np.sqrt(each.size):.2f}" for each in lane_returns]
        rows.append([str(seed), *cells, *_difference(lane_returns)])
    if len(seeds) > 1:
        means = [each.mean(axis=1) for each in returns.values()]
        rows.append(["all", *(f"{each.mean():.2f} ± {each.std():.2f}" for each in means), *_difference(means)])
    return titles, rows


def _notes(returns: dict[str, np.ndarray]) -> list[str]:
    alike = ["episodes start alike in both engines, and the policy draws the same noise"] if len(returns) > 1 else []
    return ["a seed: mean ± standard error over its episodes; all: mean ± standard deviation over seeds", *alike]


def _difference(returns: list[np.ndarray]) -> list[str]:
    """How much more the C engine pays than MJX, as a cell; none if there is one engine."""
    if len(returns) < 2:
        return []
    mjx, c = (each.mean() for each in returns)
    return [f"{(c - mjx) / abs(mjx):+.1%}"]
