"""`eairl tasks`: the table of tasks."""

from __future__ import annotations

from eairl_jax import InputError, demonstrations, envs
from eairl_jax.envs import registry
from eairl_jax.experiments.display.console import console, print_rows, say
from eairl_jax.experiments.options import Tasks
from eairl_jax.experiments.pipeline.places import make_env, shipped_demonstrations


def run(options: Tasks, command_line: str) -> None:
    """Prints a line for each task, then a sentence about each."""
    del options, command_line  # there is nothing to ask
    rows, summaries = [], []
    for name in envs.TASKS:
        env = make_env(name)
        sizes = [env.observation_size, env.action_size, f"±{env.action_limit:g}", env.episode_length]
        rows.append([name, *map(str, sizes), *_returns(name)])
        summaries.append(_summary(name, type(env).__doc__ or ""))
    print_rows("Tasks", ["task", "obs", "act", "action limit", "steps", "expert", "random"], rows)
    console.print("\n".join(summaries))
    console.print("\n".join(_elsewhere()))
    say("expert: mean true return of the expert that made the shipped demonstrations, sampled, over 500 episodes")


def _elsewhere() -> list[str]:
    """The names of other tasks, and how a task of the user is named."""
    playground = ", ".join(registry.playground_names()) or 'not installed; pip install "eairl-jax[playground]"'
    return [
        "",
        f"brax:NAME, e.g. brax:hopper. NAME: {', '.join(registry.brax_names())}",
        f"playground:NAME, e.g. playground:CheetahRun. NAME: {playground}",
        "FILE.py:FUNCTION, e.g. my_tasks.py:make_env, or MODULE:FUNCTION: a function that returns an environment",
        "arguments follow a question mark: 'brax:ant?backend=mjx&terminate_when_unhealthy=false'",
    ]


def _returns(task: str) -> list[str]:
    """True returns of expert and random actions, as text."""
    try:
        provenance = demonstrations.provenance(shipped_demonstrations(task))
    except InputError:
        return ["-", "-"]
    return [f"{provenance['expert_return']:.2f}", f"{provenance['random_return']:.2f}"]


def _summary(task: str, docstring: str) -> str:
    """The first line of the task's docstring, and what tells this variant from others of the same class."""
    arguments = getattr(envs.TASKS[task], "keywords", {})  # of a functools.partial
    variant = "; ".join(
        f"{name} {', '.join([value] if isinstance(value, str) else value)}" for name, value in arguments.items()
    )
    first_line = docstring.strip().partition("\n")[0]  # `python -OO` leaves no docstring
    return f"{task}: {first_line}" + (f" Here: {variant}." if variant else "")
