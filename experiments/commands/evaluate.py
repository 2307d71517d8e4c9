"""`eairl evaluate`: score the policies of a run on fresh episodes, in MJX and, as a referee, in the C engine."""

from __future__ import annotations

from pathlib import Path

import jax
import numpy as np
from rich.table import Table

from eairl_jax import InputError
from eairl_jax.envs.mjx_task import MjxTask
from eairl_jax.experiments.pipeline import policies
from eairl_jax.experiments.pipeline.policies import Policies
from eairl_jax.experiments.pipeline.run_folder import machine, writable
from eairl_jax.experiments.pipeline.train import EVALUATE, console, final_returns, lane_keys, say
from eairl_jax.experiments.recipes import make_env
from eairl_jax.storage import write_json

ENGINES = {"c": "C engine", "exact": "C engine, exact"}


def command(run: Path, engine: str, episodes: int, mean_action: bool, json: Path | None, line: str) -> None:
    """Prints a row a seed: the mean true return in each engine, and how far they are apart."""
    if episodes < 2:
        raise InputError(f"--episodes {episodes}: expected at least 2, for a standard error")
    found = policies.load(run)
    judge = make_env(found.task, fidelity="exact") if engine == "exact" else found.env
    if json:
        writable(json)
    sampled = not mean_action
    returns = {"MJX": final_returns(found.env, found.algorithm, found.state, found.seeds, episodes, sampled)}
    if engine in ENGINES:
        with console.status(f"{found.task}: {episodes} episodes a seed in the C engine"):
            returns[ENGINES[engine]] = referee_returns(found, judge, episodes, sampled)
    how = "sampled policy" if sampled else "mean action"
    table = Table(title=f"{found.task}: true return, {how}, {episodes} episodes a seed", title_justify="left")
    for name in ("seed", *returns, *(["C over MJX"] if len(returns) > 1 else [])):
        table.add_column(name, justify="right", no_wrap=True)
    for lane, seed in enumerate(found.seeds):
        own = {name: each[lane] for name, each in returns.items()}
        cells = [f"{each.mean():.2f} ± {each.std(ddof=1) / np.sqrt(episodes):.2f}" for each in own.values()]
        table.add_row(str(seed), *cells, *_difference(own))
    if len(found.seeds) > 1:
        table.add_section()
        means = {name: each.mean(axis=1) for name, each in returns.items()}
        table.add_row("all", *(f"{each.mean():.2f} ± {each.std():.2f}" for each in means.values()), *_difference(means))
    console.print(table)
    say("a seed: mean ± standard error over episodes; all: mean ± std over seeds")
    if len(returns) > 1:
        say("both engines start the episodes alike and draw the same noise of the policy")
    if json:
        figures = {name: each.tolist() for name, each in returns.items()}
        write_json(json, {"command": line, "task": found.task, "seeds": found.seeds, "machine": machine(),
                          "returns": figures})  # fmt: skip


def referee_returns(found: Policies, judge: MjxTask, episodes: int, sampled: bool) -> np.ndarray:
    """True returns `[seeds, episodes]` by the referee of `judge`; episodes start as those of `final_returns` do."""
    referees = [judge.referee() for _ in range(episodes)]
    limit, length = found.env.action_limit, found.env.episode_length

    @jax.jit
    def act(state, obs, key):
        return jax.numpy.clip(found.algorithm.act(state, obs, key if sampled else None), -limit, limit)

    def run(state, key) -> np.ndarray:
        reset_key, key = jax.random.split(key)
        starts = zip(*map(np.asarray, jax.vmap(found.env.initial)(jax.random.split(reset_key, episodes))), strict=True)
        obs = np.stack([referee.start(*start) for referee, start in zip(referees, starts, strict=True)])
        total = np.zeros(episodes)
        for step_key in jax.random.split(key, length):
            actions = np.asarray(act(state, obs.astype(np.float32), step_key))
            steps = [referee.step(action) for referee, action in zip(referees, actions, strict=True)]
            obs = np.stack([obs for obs, _ in steps])
            total += [reward for _, reward in steps]
        return total

    keys = lane_keys(EVALUATE, found.seeds)
    return np.stack([run(found.lane(lane), key) for lane, key in enumerate(keys)])


def _difference(returns: dict[str, np.ndarray]) -> list[str]:
    if len(returns) < 2:
        return []
    mjx, c = (each.mean() for each in returns.values())
    return [f"{(c - mjx) / abs(mjx):+.1%}"]
