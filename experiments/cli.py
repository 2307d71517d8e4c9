"""The command line, `eairl`: reads the arguments, runs the command, and turns every failure into one clear message."""

from __future__ import annotations

import errno
import importlib
import shlex
import sys

import tyro

from eairl_jax.experiments.options import COMMANDS


def main(arguments: list[str] | None = None) -> None:
    """Entry point of `eairl`. Bad input exits with code 2, a failed training with 1, an interruption with 130."""
    arguments = sys.argv[1:] if arguments is None else arguments
    options = tyro.extras.subcommand_cli_from_dict(
        COMMANDS,
        prog="eairl",
        description="Learn rewards from demonstrations, and use them elsewhere: EAIRL and its relatives in JAX.",
        args=arguments,
    )
    from eairl_jax.xla import configure_jax, refuse_double_precision

    configure_jax()
    from eairl_jax import Diverged, InputError
    from eairl_jax.experiments.pipeline.interruption import STOPPED, Interrupted, exit_on_sigterm

    (name,) = (name for name, record in COMMANDS.items() if type(options) is record)
    command = importlib.import_module(f"eairl_jax.experiments.commands.{name}")
    exit_on_sigterm()
    try:
        refuse_double_precision()
        command.run(options, shlex.join(["eairl", *arguments]))
    except InputError as e:
        _exit(str(e), 2)
    except OSError as e:
        is_full = e.errno in (errno.ENOSPC, errno.EDQUOT)
        advice = "; what was computed is kept: free some disk, then repeat the command to go on" if is_full else ""
        _exit(f"{e.strerror or e} ({e.filename or 'disk'}){advice}", 2)
    except Diverged as e:
        _exit(str(e), 1)
    except Interrupted as e:
        _exit(STOPPED, e.code)
    except KeyboardInterrupt:
        _exit(STOPPED, 130)


def _exit(message: str, code: int) -> None:
    from rich.console import Console
    from rich.markup import escape  # a path may hold brackets

    Console(stderr=True, highlight=False).print(f"[bold red]eairl:[/bold red] {escape(message)}", soft_wrap=True)
    sys.exit(code)


if __name__ == "__main__":
    main()
