"""The command line, `eairl`: reads the arguments, runs the command, and turns every failure into one clear message."""

from __future__ import annotations

import sys

# `python -m` puts the current folder first on the path. Nothing of that folder may be taken for a module of ours.
if __name__ == "__main__" and not sys.flags.safe_path:
    del sys.path[0]

import contextlib
import dataclasses
import errno
import importlib
import os
import shlex
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NoReturn

import tyro

from eairl_jax.errors import InputError
from eairl_jax.experiments.command_line import ASSIGNMENTS, normalised
from eairl_jax.experiments.display.plain import print_anything
from eairl_jax.experiments.options import COMMANDS
from eairl_jax.version import __version__

if TYPE_CHECKING:
    from eairl_jax.processes import Meeting

DESCRIPTION = (
    "Learn rewards from demonstrations, and use them elsewhere: EAIRL and its relatives in JAX. "
    f"Version {__version__} (eairl --version)."
)


# Commands that compute nothing answer at once: importing jax alone takes a second.
WITHOUT_JAX = frozenset({"runs", "watch"})


def main(arguments: list[str] | None = None) -> None:
    """Entry point of `eairl`. Bad input exits with code 2, a failed training with 1, an interruption with 130.

    If whoever reads the output is gone (`eairl runs | head`), the command ends silently with 1, as with rich.
    """
    try:
        try:
            _main(arguments)
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes once more when it ends
        sys.exit(1)


def _main(arguments: list[str] | None) -> None:
    print_anything()
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments == ["--version"]:
        print(f"eairl_jax {__version__}")
        return
    try:
        each_once = normalised(arguments)
    except InputError as e:
        _exit(str(e), 2)
    options = tyro.extras.subcommand_cli_from_dict(COMMANDS, prog="eairl", description=DESCRIPTION, args=each_once)
    (name,) = (name for name, record in COMMANDS.items() if type(options) is record)
    where = _meeting(options)
    if name not in WITHOUT_JAX:
        _configure_jax(says_costs=where is None or not where.process)
    from eairl_jax import Diverged, ProcessLost
    from eairl_jax.experiments.pipeline.interruption import STOPPED, Interrupted, exit_on_sigterm

    command = importlib.import_module(f"eairl_jax.experiments.commands.{name}")
    exit_on_sigterm()
    try:
        with _team(where, options) as leads:
            if leads:
                command.run(options, shlex.join(["eairl", *arguments]))
    except InputError as e:
        _exit(str(e), 2)
    except BrokenPipeError:
        raise
    except OSError as e:
        is_full = e.errno in (errno.ENOSPC, errno.EDQUOT)
        cure = "free some disk" if is_full else "put this right"
        advice = f"what was computed up to the last checkpoint is kept: {cure}, then repeat the command to go on"
        _exit(f"{e.strerror or e} ({e.filename or 'disk'}); {advice}", 2)
    except (Diverged, ProcessLost) as e:
        _exit(str(e), 1)
    except Interrupted as e:
        _exit(STOPPED, e.code)
    except KeyboardInterrupt:
        _exit(STOPPED, 130)


def _meeting(options: Any) -> Meeting | None:
    """Where the command meets other processes; None if it trains nothing, or is alone."""
    if not hasattr(options, "coordinator"):
        return None
    from eairl_jax import processes  # here, because help answers without NumPy

    try:
        return processes.meeting(options.coordinator, options.processes, options.process)
    except InputError as e:
        _exit(str(e), 2)


@contextlib.contextmanager
def _team(where: Meeting | None, options: Any) -> Iterator[bool]:
    """Meets the other processes. Gives whether this process runs the command; the others have served when it ends."""
    if where is None:
        yield True
        return
    from eairl_jax import blocks, processes
    from eairl_jax.experiments.display.console import say
    from eairl_jax.experiments.pipeline.interruption import Interruption

    joined = processes.join(where, _shared(options))
    if isinstance(joined, processes.Team):
        say(f"{len(joined.devices)} processes, with {' + '.join(map(str, joined.devices))} devices")
        with processes.leading(joined):
            yield True
        return
    with Interruption() as interruption:
        failed = blocks.serve(joined, lambda: interruption.asked)
    yield False
    if failed:  # process 0 has said why
        sys.exit(1)


def _shared(options: Any) -> dict[str, str]:
    """What every process must have been given alike, each by its name."""
    shared = {"command": type(options).__name__.lower()}
    for field in dataclasses.fields(options):
        value, name = getattr(options, field.name), f"--{field.name.replace('_', '-')}"
        if name in ASSIGNMENTS:
            shared |= {f"{name} {each.partition('=')[0]}": each.partition("=")[2] for each in value}
        elif field.name not in ("coordinator", "process"):
            shared[name] = " ".join(map(str, value)) if isinstance(value, tuple) else str(value)
    return shared


def _configure_jax(says_costs: bool) -> None:
    """Sets up jax, and perhaps says what the user's own variables cost."""
    from eairl_jax import xla

    for name in ("XDG_CACHE_HOME", "XDG_CONFIG_HOME"):
        if not os.path.isabs(os.environ.get(name, os.sep)):  # the standard says to ignore a relative folder
            del os.environ[name]
    try:
        remarks = xla.costs(os.environ, xla.usable_cores()) if says_costs and "jax" not in sys.modules else []
        xla.configure_jax()
        xla.refuse_double_precision()
    except InputError as e:
        _exit(str(e), 2)
    for remark in remarks:
        print(f"eairl: {remark}", file=sys.stderr)


def _exit(message: str, code: int) -> NoReturn:
    from rich.console import Console
    from rich.text import Text  # no markup: a path may hold brackets

    text = Text.assemble(("eairl:", "bold red"), " ", message)
    Console(stderr=True, highlight=False, emoji=False).print(text, soft_wrap=True)
    sys.exit(code)


if __name__ == "__main__":
    main()
