"""`eairl tasks`: the table of tasks."""

from __future__ import annotations

from rich.table import Table

import envs
from eairl_jax import InputError, demonstrations
from experiments.demos import shipped
from experiments.training import console


def command() -> None:
    """Prints a row a task."""
    table = Table(title="Tasks", title_justify="left")
    columns = ("task", "observation", "action", "limit", "episode", "expert", "random", "what it is")
    for name in columns:
        table.add_column(name, justify="left" if name in ("task", "what it is") else "right", no_wrap=name == "task")
    for name in envs.TASKS:
        env = envs.make(name)
        try:
            said = demonstrations.provenance(shipped(name))
            scores = [f"{said['expert_return']:.2f}", f"{said['random_return']:.2f}"]
        except InputError:
            scores = ["-", "-"]
        summary = (type(env).__doc__ or "").strip().splitlines()[0]
        table.add_row(name, str(env.observation_size), str(env.action_size), f"±{env.action_limit:g}",
                      f"{env.episode_length} steps", *scores, summary)  # fmt: skip
    console.print(table)
    console.print("[dim]expert: mean true return of the demonstrator, sampled, over 500 episodes[/dim]")
