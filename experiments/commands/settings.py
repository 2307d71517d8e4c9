"""`eairl settings`: what every setting means, its default, and the recipes of a task."""

from __future__ import annotations

from typing import Any

from eairl_jax.arguments import LARGEST, SMALLEST
from eairl_jax.experiments.display.console import Layout, print_rows, say
from eairl_jax.experiments.options import Settings
from eairl_jax.experiments.pipeline.places import make_env
from eairl_jax.experiments.recipes import PURPOSE_DEFAULTS
from eairl_jax.experiments.settings import GROUPS, documentation, sections_of_task

GROUP_TITLES = {
    "config": "Names and counts (Config)",
    "hparams": "Floats (HParams); each can be swept",
    "recipe": "The training as a whole",
}


def run(options: Settings, command_line: str) -> None:
    """Prints a table for each group of settings and, for a task, one of its recipes."""
    del command_line
    if options.task is not None:
        make_env(options.task)  # refuses an unknown task
    texts = documentation()
    for group, defaults in GROUPS.items():
        rows = [[name, text_of(default), texts.get(name, "")] for name, default in defaults.items()]
        print_rows(GROUP_TITLES[group], ["setting", "default", "meaning"], rows, Layout((1, 2), lines=True))
    say(f"every float is 0 or from {SMALLEST:g} to {LARGEST:g}, unless its meaning says another range")
    if options.task is None:
        say("`eairl settings TASK` also shows the recipes of a task; change a setting with --set NAME=VALUE")
    else:
        _print_recipes(options.task)


def _print_recipes(task: str) -> None:
    """What the recipes of a task change, purpose by purpose."""
    rows = [
        [section, "  ".join(f"{name}={text_of(value)}" for name, value in values.items())]
        for section, values in sections(task).items()
    ]
    title = f"Recipes of {task}: what differs from the defaults"
    print_rows(title, ["purpose", "settings"], rows, Layout((1,), lines=True))
    say("a section such as `reward separable` applies on top of `reward`, for that form, method or --tuned")


def sections(task: str) -> dict[str, dict[str, Any]]:
    """The sections of a task's recipes; those of whole purposes contain the purpose's defaults and the task's "all"."""
    own = sections_of_task(task, make_env(task))
    whole = {
        purpose: defaults | own.get("all", {}) | own.get(purpose, {}) for purpose, defaults in PURPOSE_DEFAULTS.items()
    }
    return whole | {section: values for section, values in own.items() if section not in ("all", *whole)}


def text_of(value: Any) -> str:
    """A value as `--set` takes it."""
    if isinstance(value, tuple):
        return ",".join(map(str, value)) or "-"
    return str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)
