"""`eairl tasks`: the table of tasks."""

from __future__ import annotations

from rich.table import Table

from eairl_jax import InputError, demonstrations, envs
from eairl_jax.experiments.pipeline.scores import shipped
from eairl_jax.experiments.pipeline.train import console


def command() -> None:
    """Prints a row a task."""
    table = Table(title="Tasks", title_justify="left")
    for name in ("task", "obs", "act", "action limit", "steps", "expert", "random"):
        table.add_column(name, justify="left" if name == "task" else "right", no_wrap=True)
    summaries = []
    for name in envs.TASKS:
        env = envs.make(name)
        try:
            said = demonstrations.provenance(shipped(name))
            scores = [f"{said['expert_return']:.2f}", f"{said['random_return']:.2f}"]
        except InputError:
            scores = ["-", "-"]
        sizes = [env.observation_size, env.action_size, f"±{env.action_limit:g}", env.episode_length]
        table.add_row(name, *map(str, sizes), *scores)
        made = getattr(envs.TASKS[name], "keywords", {})  # of a partial: what tells variants of one class apart
        variant = "; ".join(
            f"{key} {', '.join([value] if isinstance(value, str) else value)}" for key, value in made.items()
        )
        summary = (type(env).__doc__ or "").strip().splitlines()[0]
        summaries.append(f"{name}: {summary}" + (f" Here: {variant}." if variant else ""))
    console.print(table)
    console.print("\n".join(summaries))
    console.print("[dim]expert: mean true return of the shipped demonstrator, sampled, over 500 episodes[/dim]")
