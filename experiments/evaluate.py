"""`eairl evaluate`: score the policies of a run on fresh episodes, in MJX and, as a referee, in the C engine."""

from __future__ import annotations

from pathlib import Path

import jax
import numpy as np
from rich.table import Table

from eairl_jax import InputError
from eairl_jax.artefact import write_json
from experiments import policies
from experiments.folder import machine
from experiments.policies import Policies
from experiments.training import EVALUATE, console, final_returns, lane_keys, say


def command(run: Path, engine: str, episodes: int, mean_action: bool, json: Path | None, line: str) -> None:
    """Prints a row a seed: the mean true return in each engine, and how far they are apart."""
    if episodes < 2:
        raise InputError(f"--episodes {episodes}: expected at least 2, for a standard error")
    found = policies.load(run)
    returns = {"MJX": final_returns(found.env, found.algorithm, found.state, found.seeds, episodes, not mean_action)}
    if engine == "c":
        with console.status(f"{found.task}: {episodes} episodes a seed in the C engine"):
            returns["C engine"] = referee_returns(found, episodes, not mean_action)
    how = "mean action" if mean_action else "sampled policy"
    table = Table(title=f"{run.name} in {found.task}: true return, {how}, {episodes} episodes", title_justify="left")
    for name in ("seed", *returns, *(["C over MJX"] if len(returns) > 1 else [])):
        table.add_column(name, justify="right", no_wrap=True)
    for lane, seed in enumerate(found.seeds):
        table.add_row(str(seed), *_cells({name: each[lane] for name, each in returns.items()}))
    if len(found.seeds) > 1:
        table.add_section()
        table.add_row("all", *_cells({name: each.ravel() for name, each in returns.items()}))
    console.print(table)
    say("mean ± standard error over episodes; both engines start them alike and draw the same noise of the policy")
    if json:
        json.parent.mkdir(parents=True, exist_ok=True)
        figures = {name: each.tolist() for name, each in returns.items()}
        write_json(json, {"command": line, "task": found.task, "seeds": found.seeds, "machine": machine(),
                          "returns": figures})  # fmt: skip


def referee_returns(found: Policies, episodes: int, sampled: bool = True) -> np.ndarray:
    """True returns `[seeds, episodes]` in the C engine, of episodes that start as those of `final_returns` do."""
    referees = [found.env.referee() for _ in range(episodes)]
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
    lanes = [jax.tree.map(lambda leaf, lane=lane: jax.numpy.asarray(leaf[lane]), found.state)
             for lane in range(len(found.seeds))]  # fmt: skip
    return np.stack([run(state, key) for state, key in zip(lanes, keys, strict=True)])


def _cells(returns: dict[str, np.ndarray]) -> list[str]:
    cells = [f"{each.mean():.2f} ± {each.std(ddof=1) / np.sqrt(len(each)):.2f}" for each in returns.values()]
    if len(returns) > 1:
        mjx, c = (each.mean() for each in returns.values())
        cells.append(f"{(c - mjx) / abs(mjx):+.1%}")
    return cells
