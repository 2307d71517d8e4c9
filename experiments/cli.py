"""The command line, `eairl`: arguments by tyro, one clear message and exit code 2 for bad input."""

from __future__ import annotations

import errno
import functools
import os
import shlex
import sys
from dataclasses import dataclass, fields
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal

import tyro
from tyro.conf import Positional, arg, subcommand

own_default = functools.partial(arg, help_behavior_hint="")  # said by the help, or nothing: no "(default: None)"
Task = Annotated[Positional[str], arg(metavar="TASK", help="Name of a task; `eairl tasks` lists them.")]
Set = Annotated[
    tuple[str, ...],
    own_default(
        name="set",
        metavar="NAME=VALUE",
        help="Override any setting of Config or HParams, e.g. gamma=0.99 iterations=400.",
    ),
]
Methods = Annotated[
    tuple[str, ...],
    arg(metavar="NAME", help="One or more of eairl, eairl_release, airl_sa, airl_s, gail, gan_gcl, bc (to imitate); "
        "each gets a row in the table."),
]  # fmt: skip
Forms = Annotated[
    tuple[str, ...],
    arg(metavar="FORM", help="What the reward sees: sa (the paper's r(s,a)), s, separable (g(s) + k(a), recommended "
        "for transfer), default (the method's own). Several give several rows."),
]  # fmt: skip
Out = Annotated[
    Path | None,
    own_default(metavar="DIR", help="RunFolder of the run. Default: runs/ and a name made of the arguments."),
]
Demos = Annotated[
    Path | None, own_default(metavar="FILE", help="Demonstrations (.npz). Default: the 20 episodes that we ship.")
]
Optimizer = Annotated[Literal["ppo", "trpo"], arg(help="How policies are trained.")]
Tuned = Annotated[
    bool,
    arg(help="Settings of ours instead of the paper's, found on the ant with seeds 0 and 1: --first-seed 20 is fair."),
]
Seeds = Annotated[int, arg(help="Independent runs, trained side by side.")]
FirstSeed = Annotated[int, arg(help="Number of the first of them; another one than 0 gives fresh random numbers.")]


def seed_range(command) -> range:
    """The seeds of a command."""
    return range(command.first_seed, command.first_seed + command.seeds)


def refuse_of_learning(given: list[str]) -> None:
    """Raises `InputError` for options of learning where a saved reward is used, which was learned."""
    from eairl_jax import InputError

    if given:
        options = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        raise InputError(f"{options}: of learning a reward, but --reward gives one that is learned; leave it out")


@dataclass
class Tasks:
    """List the tasks: sizes, episode length, and what the shipped expert and random actions score."""

    def run(self, line: str) -> None:
        from eairl_jax.experiments.commands import tasks

        tasks.command()


@dataclass
class Expert:
    """Train experts on a task's own reward, by PPO or TRPO.

    The best of the seeds is what `eairl demos` then collects demonstrations from.
    """

    task: Task
    seeds: Seeds = 4
    optimizer: Optimizer = "ppo"
    out: Out = None
    set: Set = ()

    def run(self, line: str) -> None:
        from eairl_jax.experiments.commands import expert

        expert.command(self.task, self.seeds, self.out, (f"optimizer={self.optimizer}", *self.set), line)


@dataclass
class Collect:
    """Collect demonstrations from a trained expert: an .npz of whole episodes and a .json of where they came from."""

    task: Task
    expert: Annotated[
        Path | None, own_default(metavar="DIR", help="RunFolder of `eairl expert`. Default: runs/expert-TASK.")
    ] = None
    episodes: int = 20
    """How many episodes."""
    seed: int = 0
    """Of the episodes' randomness."""
    out: Annotated[Path | None, own_default(metavar="FILE", help="Where to write. Default: demos/TASK.npz.")] = None

    def run(self, line: str) -> None:
        from eairl_jax.experiments.commands import demos

        demos.command(self.task, self.expert, self.episodes, self.seed, self.out, line)


@dataclass
class Imitate:
    """Learn a policy, and with it a reward, from demonstrations of one task.

    Uses the paper's imitation settings (entropy weight and lambda_I 0.001), unless --tuned. A run that was interrupted
    goes on from its last checkpoint when the same command is given again.
    """

    task: Task
    method: Methods = ("eairl",)
    reward_form: Forms = ("default",)
    tuned: Tuned = False
    seeds: Seeds = 5
    first_seed: FirstSeed = 0
    optimizer: Optimizer = "ppo"
    demos: Demos = None
    out: Out = None
    set: Set = ()

    def run(self, line: str) -> None:
        from eairl_jax.experiments.pipeline import learn

        learn.command(self.task, self.method, self.reward_form, seed_range(self), self.demos, self.out,
                        (f"optimizer={self.optimizer}", *self.set), line, self.tuned)  # fmt: skip


@dataclass
class Sweep:
    """Train one method with many values of its floats, all in one compiled program: one table and one figure.

    A setting with a list of values is swept; several such settings make a grid. For example
    `eairl sweep pendulum --method eairl --set lambda_i=0,0.001,0.1,1 --seeds 5`.
    """

    task: Task
    method: Annotated[str, arg(metavar="NAME", help="One method.")] = "eairl"
    reward_form: Annotated[str, arg(metavar="FORM", help="sa, s, separable or default.")] = "default"
    seeds: Seeds = 5
    first_seed: FirstSeed = 0
    optimizer: Optimizer = "ppo"
    demos: Demos = None
    out: Out = None
    set: Annotated[
        tuple[str, ...], own_default(name="set", metavar="NAME=A,B,C", help="What to sweep, and any other setting.")
    ] = ()

    def run(self, line: str) -> None:
        from eairl_jax.experiments.commands import sweep

        sweep.command(self.task, (self.method,), (self.reward_form,), seed_range(self), self.demos, self.out,
                      (f"optimizer={self.optimizer}", *self.set), line)  # fmt: skip


@dataclass
class Transfer:
    """Learn a reward in SOURCE, freeze it, train a fresh policy on it alone in TARGET, score by TARGET's true reward.

    Beside every row stands the ceiling: the true reward, retrained under the same budget. A run that was interrupted
    goes on from its last checkpoint when the same command is given again.
    """

    source: Annotated[Positional[str], arg(metavar="SOURCE", help="Task that was demonstrated.")]
    target: Annotated[Positional[str], arg(metavar="TARGET", help="Task in which the reward is used.")]
    method: Methods = ("eairl",)
    reward_form: Forms = ("default",)
    tuned: Tuned = False
    seeds: Seeds = 5
    first_seed: FirstSeed = 0
    rule: Annotated[
        tuple[str, ...],
        arg(metavar="RULE", help="Which iteration's reward is taken: last, iteration=N, or source_retrain (retrain on "
            "every kept snapshot in SOURCE and take the best by SOURCE's true return). To compare with: random (the "
            "reward before learning) and policy (no reward: the imitating policy as it is). None looks at TARGET. "
            "Several give several rows, from one learning."),
    ] = ("source_retrain",)  # fmt: skip
    optimizer: Optimizer = "ppo"
    demos: Demos = None
    reward: Annotated[
        Path | None,
        own_default(metavar="DIR", help="Use this saved reward (a run's reward/ folder) instead of learning one."),
    ] = None
    out: Annotated[
        Path | None, own_default(metavar="DIR", help="Where the rows' folders are made. Default: runs/.")
    ] = None
    set: Set = ()
    retrain_set: Annotated[
        tuple[str, ...],
        own_default(metavar="NAME=VALUE", help="Like --set, for the policies that are trained on the reward."),
    ] = ()
    restarts: Annotated[
        int | None,
        own_default(help="Policies trained in TARGET for each score; the best of them by the learned reward is kept. "
                    "Default: the task's own (mazes 4, walkers 1)."),
    ] = None  # fmt: skip

    def run(self, line: str) -> None:
        from eairl_jax.experiments.pipeline import transfer

        if self.reward is not None:
            learning = ("method", "reward_form", "tuned", "seeds", "first_seed", "rule", "demos", "set")
            defaults = {field.name: field.default for field in fields(self)}
            refuse_of_learning([name for name in learning if getattr(self, name) != defaults[name]])
        by = f"optimizer={self.optimizer}"
        transfer.command(
            self.source, self.target, self.method, self.reward_form, seed_range(self), self.rule, self.demos,
            self.reward, self.out, (by, *self.set), (by, *self.retrain_set), self.restarts, line,
            self.tuned,
        )  # fmt: skip


@dataclass
class Reproduce:
    """Train the paper's tables and figures, or go on with them: runs that are in --out already are kept.

    20 demonstrations, the last iteration's reward (and `source_retrain`), no selection on a target task, seeds 20 and
    on, by which no setting's value was chosen. Results are written after every row, the cheapest first.
    """

    name: Annotated[
        Positional[Literal["table1", "table2", "figure2", "appendix-c", "ablations", "all"]],
        arg(help="Reward transfer, imitation, curves of transfer, paths and gaits, EAIRL with one setting changed."),
    ]
    quick: bool = False
    """A small version, in minutes and by the same code: two seeds, 20 iterations, pendulum and mazes."""
    seeds: Seeds = 5
    task: Annotated[tuple[str, ...], own_default(metavar="NAME", help="Only these (source) tasks.")] = ()
    out: Annotated[Path | None, own_default(metavar="DIR", help="Where the runs are. Default: runs/reproduce.")] = None
    results: Annotated[Path | None, own_default(metavar="DIR", help="Where the results are written. Default: "
                                        "experiments/results; of --quick, where the runs are.")] = None  # fmt: skip

    def run(self, line: str) -> None:
        from eairl_jax.experiments.paper import plan

        plan.command(self.name, self.quick, self.seeds, self.task, self.out, self.results, line)


@dataclass
class Report:
    """Show what was reproduced: one web page of all results, the paper's beside them. It needs no network."""

    results: Annotated[Path | None, own_default(metavar="DIR", help="The results of `eairl reproduce`. Default: "
                                        "experiments/results.")] = None  # fmt: skip
    out: Annotated[Path | None, own_default(metavar="FILE", help="Where to write. Default: runs/report.html.")] = None

    def run(self, line: str) -> None:
        from eairl_jax.experiments.paper import report

        report.command(self.results, self.out)


@dataclass
class Evaluate:
    """Score the policies of a finished run on fresh episodes: an expert's, an imitation's or a transfer's.

    `--engine c` also runs them in the C engine, through Gymnasium's environments where there are such, with every
    contact and a solver that converges.
    """

    run_folder: Annotated[Positional[Path], arg(metavar="RUN", help="RunFolder of a finished run.")]
    engine: Annotated[
        Literal["mjx", "c", "exact"],
        arg(help="mjx alone; or beside it c, the C engine with the task's own integrator; or exact, with Gymnasium's "
            "(RK4 for ants and swimmer, where the task takes Euler's)."),
    ] = "mjx"  # fmt: skip
    episodes: int = 20
    """Episodes a seed."""
    mean_action: bool = False
    """Take the policy's mean action instead of sampling."""
    json: Annotated[Path | None, own_default(metavar="FILE", help="Write every episode's return here as well.")] = None

    def run(self, line: str) -> None:
        from eairl_jax.experiments.commands import evaluate

        evaluate.command(self.run_folder, self.engine, self.episodes, self.mean_action, self.json, line)


@dataclass
class View:
    """Play an episode of a finished run: a web page that needs no network, a strip of frames, and a movie.

    The pictures need OpenGL (without a display EGL, which `MUJOCO_GL` chooses otherwise); the page does not.
    """

    run_folder: Annotated[Positional[Path], arg(metavar="RUN", help="RunFolder of a finished run.")]
    seed: Annotated[int | None, own_default(help="Whose policy. Default: the run's first.")] = None
    out: Annotated[Path | None, own_default(metavar="DIR", help="Where to write. Default: RUN/view.")] = None

    def run(self, line: str) -> None:
        from eairl_jax.experiments.commands import view

        view.command(self.run_folder, self.seed, self.out)


@dataclass
class Bench:
    """Measure a whole iteration beside the simulation in it, its stages, five seeds beside one, and compiling."""

    task: Task
    method: Methods = ("eairl",)
    reward_form: Forms = ("default",)
    demos: Demos = None
    json: Annotated[Path | None, own_default(metavar="FILE", help="Write all figures here as well.")] = None
    iterations: int = 20
    """Iterations a measurement."""
    set: Set = ()

    def run(self, line: str) -> None:
        from eairl_jax.experiments.commands import bench

        bench.command(self.task, self.method, self.reward_form, self.demos, self.json, self.set, self.iterations, line)


Command = (
    Annotated[Tasks, subcommand("tasks")]
    | Annotated[Expert, subcommand("expert")]
    | Annotated[Collect, subcommand("demos")]
    | Annotated[Imitate, subcommand("imitate")]
    | Annotated[Sweep, subcommand("sweep")]
    | Annotated[Transfer, subcommand("transfer")]
    | Annotated[Reproduce, subcommand("reproduce")]
    | Annotated[Report, subcommand("report")]
    | Annotated[Evaluate, subcommand("evaluate")]
    | Annotated[View, subcommand("view")]
    | Annotated[Bench, subcommand("bench")]
)


def main(arguments: list[str] | None = None) -> None:
    """Entry point of `eairl`."""
    arguments = sys.argv[1:] if arguments is None else arguments
    command = tyro.cli(
        Command,  # pyright: ignore
        prog="eairl",
        description="Learn rewards from demonstrations, and use them elsewhere: EAIRL and its relatives in JAX.",
        args=arguments,
    )
    configure_jax()
    from eairl_jax import InputError
    from eairl_jax.experiments.pipeline.train import Diverged

    try:
        command.run(shlex.join(["eairl", *arguments]))
    except InputError as e:
        _fail(str(e), 2)
    except OSError as e:
        advice = "; what was computed before is kept: free the disk, then repeat the command to go on"
        is_full = e.errno in (errno.ENOSPC, errno.EDQUOT)
        _fail(f"{e.strerror or e} ({e.filename or 'disk'}){advice if is_full else ''}", 2)
    except Diverged as e:
        _fail(str(e), 1)
    except KeyboardInterrupt:
        _fail("stopped; a training goes on from its last checkpoint when its command is given again", 130)


def configure_jax() -> None:
    """Lets lanes use every CPU core, and keeps compiled programs from one command to the next.

    A CPU core becomes a device of its own. XLA's thread pool must then be larger than the number of devices, or
    programs that wait for each other's subtasks in it hang; NPROC is how it learns its size.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    os.environ.setdefault("NPROC", str(2 * cores + 2))
    # One device, one thread: with XLA's scheduler for concurrency a loop's small kernels hop from core to core.
    flags = ["--xla_cpu_multi_thread_eigen=false"]
    if version("jaxlib").startswith("0.10."):  # XLA aborts at a flag that it does not know
        # Loops are compiled into one kernel if nothing in them needs XLA's runtime (`envs.one_kernel`), as its YNN
        # library does: the walkers' simulation is then 1.6 to 2.6 times as fast. Compiling the ant's takes a minute.
        flags += [
            "--xla_cpu_enable_concurrency_optimized_scheduler=false",
            "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000",
            "--xla_cpu_experimental_ynn_fusion_type=",
        ]
    os.environ.setdefault("XLA_FLAGS", " ".join(flags))
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    import jax

    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "eairl_jax"
    jax.config.update("jax_num_cpu_devices", cores)
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


def _fail(message: str, code: int) -> None:
    from rich.console import Console
    from rich.markup import escape  # a path may hold brackets

    Console(stderr=True, highlight=False).print(f"[bold red]eairl:[/bold red] {escape(message)}", soft_wrap=True)
    sys.exit(code)


if __name__ == "__main__":
    main()
