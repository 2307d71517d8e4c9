"""`eairl clean`: removes the checkpoints of finished runs, or says which it would remove."""

from __future__ import annotations

import dataclasses

from eairl_jax import InputError
from eairl_jax.experiments.display.console import Layout, console, print_rows, say
from eairl_jax.experiments.options import Clean
from eairl_jax.experiments.pipeline import cleaning


def run(options: Clean, command_line: str) -> None:
    """Prints a line for each run that holds checkpoints, and removes them with `--yes`."""
    del command_line
    directory = options.directory
    if not directory.is_dir():
        raise InputError(f"no folder {directory}: give the folder that holds the runs")
    found = list(cleaning.find(directory))
    if not found:
        say(f"no checkpoints in {directory}")
        return
    if options.yes:
        with console.status("removing"):
            found = [each if each.reason else dataclasses.replace(each, reason=cleaning.remove(each)) for each in found]
    freed = [each for each in found if not each.reason]
    titles, rows = ("run", "MB", ""), []
    for each in found:
        name = each.path.relative_to(directory).as_posix()
        done = "removed" if options.yes else "would be removed"
        rows.append([each.path.name if name == "." else name, f"{each.size / 1e6:.1f}", each.reason or done])
    print_rows(f"Checkpoints in {directory}", titles, rows, Layout(folded=(0, 2)))
    total = sum(each.size for each in freed) / 1e6
    if options.yes:
        say(f"{total:.1f} MB are free again. The runs keep results, curves, rewards and policies")
    elif freed:
        say(f"nothing was removed; `eairl clean {directory} --yes` frees {total:.1f} MB")
        say("the runs then keep results, curves, rewards and policies, but cannot go on beyond their end")
    else:
        say("nothing can be removed")
