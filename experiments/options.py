"""What each command can be asked. tyro makes the arguments and the help of `eairl` from these records.

This file imports no jax, so that help is fast. `commands/NAME.py` holds what the command NAME does with its record.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

# An option whose help says what its default is, or that needs no default: tyro adds no "(default: None)".
explained = functools.partial(arg, help_behavior_hint="")

Task = Annotated[
    Positional[str],
    arg(
        metavar="TASK",
        help="Name of a task: one of ours, brax:NAME, playground:NAME, or FILE.py:FUNCTION for a task of yours. `eairl "
        "tasks` lists the tasks.",
    ),
]
Set = Annotated[
    tuple[str, ...],
    explained(
        name="set",
        metavar="NAME=VALUE",
        help="Change any setting, e.g. gamma=0.99 iterations=400. `eairl settings` lists the settings.",
    ),
]
Methods = Annotated[
    tuple[str, ...],
    arg(
        metavar="NAME",
        help="One or more of eairl, eairl_release, airl_sa, airl_s, gail, gaifo, gan_gcl, bc (to imitate), "
        "or FILE.py:NAME for a method of yours; each method gets a line in the table.",
    ),
]
Forms = Annotated[
    tuple[str, ...],
    arg(
        metavar="FORM",
        help="What the reward is a function of: sa (the paper's r(s,a)), s, separable (g(s) + k(a), recommended for "
        "transfer), or default (the form that the method's authors use). Each form gets a line in the table.",
    ),
]
Out = Annotated[
    Path | None,
    explained(metavar="DIR", help="Folder of the run. Default: a folder in runs/, named after the arguments."),
]
Demos = Annotated[
    Path | None,
    explained(
        metavar="FILE",
        help="Demonstrations (.npz). Default: the 20 episodes that come with the package, or demos/TASK.npz.",
    ),
]
Optimizer = Annotated[Literal["ppo", "trpo"], arg(help="The algorithm that trains policies.")]
Tuned = Annotated[
    bool,
    arg(
        help="Use this project's settings instead of the paper's. They were found on the ant with seeds 0 and 1, so "
        "compare with --first-seed 20."
    ),
]
Seeds = Annotated[int, arg(help="Number of independent runs. They are trained side by side.")]
FirstSeed = Annotated[int, arg(help="Number of the first seed. Another number gives other random numbers.")]
Horizon = Annotated[
    Literal["fixed", "absorbing", "variable"] | None,
    explained(
        help="What follows when the task ends an episode, while learning. fixed: the simulation goes on until the time "
        "limit. absorbing: an absorbing state, for expert and policy. variable: nothing; the sign "
        "of the reward then decides how long a policy wants to live. Default: absorbing. Without effect in tasks that "
        "never end an episode."
    ),
]
Track = Annotated[
    tuple[Literal["tensorboard", "wandb"], ...],
    explained(
        help="Also send the metrics to these. tensorboard: event files in the run's folder (`tensorboard --logdir "
        "runs`). wandb: Weights & Biases. A tracker that fails never stops a run."
    ),
]
OnNan = Annotated[
    Literal["stop", "skip"],
    arg(
        help="What happens when a value becomes NaN or infinite. stop: the command stops, and the last good checkpoint "
        "is kept. skip: the seed is dropped and the others go on; the table and summary.json say which seed and why."
    ),
]
More = Annotated[
    int,
    arg(
        help="Train this many iterations beyond the planned end, at the final rates. A finished run goes on from its "
        "last checkpoint; summary.json says so."
    ),
]
MoreSeeds = Annotated[
    int,
    arg(
        help="Train this many seeds beyond --seeds. A finished run keeps what it has; its table, reward and policy "
        "then hold all seeds."
    ),
]
Cluster = Annotated[
    Literal["slurm", "local"] | None,
    explained(
        help="Train as jobs of a cluster, one for each program. slurm: the queue; a pre-empted job goes on from its "
        "checkpoint. local: processes of this machine, all at once. The command without --cluster prints the table "
        "when the jobs are done."
    ),
]
ClusterSet = Annotated[
    tuple[str, ...],
    explained(
        metavar="NAME=VALUE",
        help="Parameters of the jobs as submitit names them, e.g. timeout_min=600 slurm_partition=gpu gpus_per_node=1.",
    ),
]
Program = Annotated[
    int | None,
    explained(
        metavar="N",
        help="Train only this one of the command's programs, 0 the first, and print no table: to spread a command over "
        "machines by hand. Jobs of --cluster are started with it.",
    ),
]
Net = Annotated[
    str | None,
    explained(
        metavar="CODE",
        help="Of a reward with a network of yours, that network: FILE.py:NAME or MODULE:NAME, as --set net=... named "
        "it. No code is run because a saved reward names it.",
    ),
]
Coordinator = Annotated[
    str | None,
    explained(
        metavar="HOST:PORT",
        help="To train with several processes that are started by hand: the host of process 0, and a free port on it. "
        "Processes that srun, mpirun or Kubernetes start find each other without these three options.",
    ),
]
Processes = Annotated[
    int | None,
    explained(
        metavar="N",
        help="With --coordinator: how many processes there are. 1 alone: this process needs no others, whatever has "
        "started it.",
    ),
]
Process = Annotated[
    int | None,
    explained(
        metavar="I",
        help="With --coordinator: the number of this process, from 0. Process 0 reads and writes all files.",
    ),
]
Json = Annotated[Path | None, explained(metavar="FILE", help="Write all figures to this file as well.")]


@dataclass(frozen=True)
class Tasks:
    """List the tasks: sizes, episode length, and the returns of the shipped expert and of random actions."""


@dataclass(frozen=True)
class Settings:
    """Explain every setting: what it means, its default and, for a TASK, the values of its recipes."""

    task: Annotated[Positional[str | None], explained(metavar="TASK", help="Also show the recipes of this task.")] = (
        None
    )


@dataclass(frozen=True)
class Expert:
    """Train experts on a task's own reward, by PPO or TRPO.

    `eairl demos` then collects demonstrations from the best seed.
    """

    task: Task
    seeds: Seeds = 4
    optimizer: Optimizer = "ppo"
    more: More = 0
    track: Track = ()
    on_nan: OnNan = "stop"
    coordinator: Coordinator = None
    processes: Processes = None
    process: Process = None
    out: Out = None
    set: Set = ()


@dataclass(frozen=True)
class Collect:
    """Collect demonstrations from a trained expert, or convert demonstrations of other libraries with --from.

    Either way the result is episodes (.npz) and their provenance (.json), or a Minari data set with --to minari:NAME.
    """

    task: Task
    expert: Annotated[
        Path | None, explained(metavar="DIR", help="Folder of `eairl expert`. Default: runs/expert-TASK.")
    ] = None
    episodes: int = 20
    """Number of episodes."""
    seed: int = 0
    """Seed of the episodes' random numbers."""
    mean_action: bool = False
    """Demonstrate the expert's mean action instead of samples, for example where a sample makes it fall."""
    out: Annotated[Path | None, explained(metavar="FILE", help="File to write. Default: demos/TASK.npz.")] = None
    source: Annotated[
        str | None,
        explained(
            name="from",
            metavar="SOURCE",
            help="Convert these demonstrations: minari:NAME (a local data set), the folder of a Minari data set, a "
            "folder saved by HuggingFace's datasets (trajectories of imitation), .hdf5 (flat columns, as in D4RL), "
            ".npz, or shipped (those that come with the package).",
        ),
    ] = None
    to: Annotated[
        str | None,
        explained(metavar="DEST", help="With --from: a .npz, or minari:NAME-v0. Default: demos/TASK.npz."),
    ] = None
    format: Annotated[
        Literal["minari", "hf", "hdf5", "npz"] | None,
        explained(help="With --from: the format of SOURCE. Default: it is found from SOURCE."),
    ] = None
    obs_key: Annotated[
        str | None,
        explained(
            metavar="KEY",
            help="With --from: of dictionary observations, the entry to use, or flatten for all entries in the order "
            "of their names.",
        ),
    ] = None
    max_episodes: Annotated[
        int | None, explained(metavar="N", help="With --from: read the first N episodes. Default: all.")
    ] = None


@dataclass(frozen=True)
class Imitate:
    """Learn a policy, and with it a reward, from demonstrations of one task.

    The settings are the paper's for imitation (entropy weight and lambda_I 0.001), unless --tuned is given. A run that
    was interrupted goes on from its last checkpoint when the same command is given again.
    """

    task: Task
    method: Methods = ("eairl",)
    reward_form: Forms = ("default",)
    tuned: Tuned = False
    seeds: Seeds = 5
    first_seed: FirstSeed = 0
    horizon: Horizon = None
    optimizer: Optimizer = "ppo"
    demos: Demos = None
    more: More = 0
    more_seeds: MoreSeeds = 0
    track: Track = ()
    on_nan: OnNan = "stop"
    cluster: Cluster = None
    cluster_set: ClusterSet = ()
    program: Program = None
    coordinator: Coordinator = None
    processes: Processes = None
    process: Process = None
    out: Out = None
    set: Set = ()


@dataclass(frozen=True)
class Sweep:
    """Train one method with many values of its settings: one table and one figure.

    A setting with a list of values is swept. Several such settings make a grid. For example
    `eairl sweep pendulum --method eairl --set lambda_i=0,0.001,0.1,1 --seeds 5`. All floats are trained side by side in
    one compiled program. Names and whole numbers, such as activation=relu,tanh, need a program for each value. The
    reward and the policies of each point are kept in points/.
    """

    task: Task
    method: Annotated[str, arg(metavar="NAME", help="One method, as in `eairl imitate`.")] = "eairl"
    reward_form: Annotated[str, arg(metavar="FORM", help="sa, s, separable or default.")] = "default"
    seeds: Seeds = 5
    first_seed: FirstSeed = 0
    horizon: Horizon = None
    optimizer: Optimizer = "ppo"
    demos: Demos = None
    track: Track = ()
    on_nan: OnNan = "stop"
    cluster: Cluster = None
    cluster_set: ClusterSet = ()
    program: Program = None
    coordinator: Coordinator = None
    processes: Processes = None
    process: Process = None
    out: Out = None
    set: Annotated[
        tuple[str, ...],
        explained(name="set", metavar="NAME=A,B,C", help="Settings to sweep, and any other setting (NAME=VALUE)."),
    ] = ()


@dataclass(frozen=True)
class Search:
    """Search the floats of a method for values with a high score in the task that is demonstrated.

    A setting with a range is searched, for example
    `eairl search pendulum --set lambda_i=log:1e-4..1 entropy_weight=log:1e-4..0.3 --trials 64`. Optuna's TPE proposes
    the trials. A generation of trials is trained side by side, and all generations use one compiled program. A trial's
    score is the mean over its seeds. The best score of many trials is optimistic: at the end stands the command that
    trains the best setting with other seeds. The same command again goes on where it was stopped.
    """

    task: Task
    method: Annotated[str, arg(metavar="NAME", help="One method, as in `eairl imitate`.")] = "eairl"
    reward_form: Annotated[str, arg(metavar="FORM", help="sa, s, separable or default.")] = "default"
    objective: Annotated[
        str,
        arg(
            metavar="NAME",
            help="What is to be high. true_return: the true return that the policy has in TASK after learning, from 0 "
            "(random actions) to 1 (the expert) where an expert is known. There is no other: the score of a transfer's "
            "target must choose no setting.",
        ),
    ] = "true_return"
    trials: Annotated[
        int, arg(help="Number of settings to try: a multiple of --generation. A larger number goes on.")
    ] = 64
    generation: Annotated[int, arg(help="Trials that are trained side by side, and proposed together.")] = 8
    seeds: Seeds = 5
    first_seed: FirstSeed = 0
    horizon: Horizon = None
    optimizer: Optimizer = "ppo"
    demos: Demos = None
    out: Out = None
    set: Annotated[
        tuple[str, ...],
        explained(
            name="set",
            metavar="NAME=RANGE",
            help="Settings to search: LOW..HIGH, log:LOW..HIGH (the logarithm is searched) or A,B,C. And any other "
            "setting (NAME=VALUE).",
        ),
    ] = ()


@dataclass(frozen=True)
class Transfer:
    """Learn a reward in SOURCE, freeze it, train a fresh policy on it alone in TARGET, score by TARGET's true reward.

    The table also shows the ceiling: the same training on the true reward. A run that was interrupted goes on from its
    last checkpoint when the same command is given again.
    """

    source: Annotated[Positional[str], arg(metavar="SOURCE", help="Task that was demonstrated, or several: TASK+TASK.")]
    target: Annotated[Positional[str], arg(metavar="TARGET", help="Task in which the reward is used.")]
    method: Methods = ("eairl",)
    reward_form: Forms = ("default",)
    tuned: Tuned = False
    seeds: Seeds = 5
    first_seed: FirstSeed = 0
    rule: Annotated[
        tuple[str, ...],
        arg(
            metavar="RULE",
            help="The reward that is used: of an iteration, by last, iteration=N, or source_retrain (train policies in "
            "SOURCE on every kept snapshot and use the best by SOURCE's true return); or a new one, fitted to episodes "
            "of the imitating policy in which more and more actions are random, by d_rex (less noise is better) or "
            "ssrr (follow the learned reward's ratings). To compare with: random (the reward before learning) and "
            "policy (no reward: the imitating policy is scored in TARGET). No rule looks at TARGET. Several rules "
            "share one learning and get a line each.",
        ),
    ] = ("source_retrain",)
    horizon: Horizon = None
    optimizer: Optimizer = "ppo"
    demos: Demos = None
    reward: Annotated[
        Path | None,
        explained(metavar="DIR", help="Use this saved reward (the reward/ folder of a run) and learn none."),
    ] = None
    net: Net = None
    track: Track = ()
    on_nan: OnNan = "stop"
    cluster: Cluster = None
    cluster_set: ClusterSet = ()
    program: Program = None
    coordinator: Coordinator = None
    processes: Processes = None
    process: Process = None
    out: Annotated[Path | None, explained(metavar="DIR", help="Folder for the runs' folders. Default: runs/.")] = None
    set: Set = ()
    retrain_set: Annotated[
        tuple[str, ...],
        explained(metavar="NAME=VALUE", help="Like --set, for the policies that are trained on the reward."),
    ] = ()
    restarts: Annotated[
        int | None,
        explained(
            help="Policies trained in TARGET for each score. The best by the learned reward is kept. "
            "Default: the task's recipe (mazes 4, walkers 1)."
        ),
    ] = None


@dataclass(frozen=True)
class Reproduce:
    """Train the paper's tables and figures. Runs that are in --out already are kept, unfinished ones go on.

    20 demonstrations, the last iteration's reward (and `source_retrain`), nothing selected on a target task, seeds 20
    and on, by which no setting was chosen. Results are written after every run, the cheapest first.
    """

    name: Annotated[
        Positional[
            Literal["table1", "table2", "figure2", "appendix-c", "ablations", "sources", "imperfect", "styles", "all"]
        ],
        arg(
            help="Reward transfer; imitation; curves of the transfer; paths and gaits; EAIRL with one setting changed; "
            "rewards from one source and from two; rewards from imperfect demonstrations; rewards from demonstrators "
            "of different styles; all of them."
        ),
    ]
    quick: bool = False
    """Train a small version in minutes, by the same code: two seeds, 20 iterations, pendulum and mazes."""
    seeds: Seeds = 5
    task: Annotated[tuple[str, ...], explained(metavar="NAME", help="Only these (source) tasks.")] = ()
    on_nan: OnNan = "stop"
    cluster: Cluster = None
    cluster_set: ClusterSet = ()
    program: Program = None
    out: Annotated[Path | None, explained(metavar="DIR", help="Folder of the runs. Default: runs/reproduce.")] = None
    results: Annotated[
        Path | None,
        explained(
            metavar="DIR",
            help="Folder of the results. Default: the results/ folder of the project; with --quick, --out.",
        ),
    ] = None
    coordinator: Coordinator = None
    processes: Processes = None
    process: Process = None


@dataclass(frozen=True)
class Report:
    """Write one web page of all results beside the paper's. The page needs no network."""

    results: Annotated[
        Path | None,
        explained(metavar="DIR", help="Results of `eairl reproduce`. Default: the results/ folder of the project."),
    ] = None
    out: Annotated[Path | None, explained(metavar="FILE", help="File to write. Default: runs/report.html.")] = None


@dataclass(frozen=True)
class Evaluate:
    """Score the policies of a run on fresh episodes: an expert's, an imitation's or a transfer's.

    An expert or an imitation may still train: the policies are then those of its newest checkpoint.

    `--engine c` also runs the policies in MuJoCo's C engine (in Gymnasium's environments where they exist), with every
    contact and a solver that converges.
    """

    run_folder: Annotated[Positional[Path], arg(metavar="RUN", help="Folder of a run.")]
    engine: Annotated[
        Literal["mjx", "c", "exact"],
        arg(
            help="mjx: MJX alone. c: also the C engine with the task's integrator. exact: also the C engine with "
            "Gymnasium's integrator (RK4 for ants and swimmer, where the task uses Euler's method)."
        ),
    ] = "mjx"
    episodes: int = 20
    """Episodes of each seed."""
    mean_action: bool = False
    """Take the policy's mean action instead of a sample."""
    out: Annotated[
        Path | None, explained(metavar="DIR", help="Folder of the figure and the page. Default: runs/evaluate-...")
    ] = None
    json: Json = None


@dataclass(frozen=True)
class Correlate:
    """Compare a learned reward with the true one: do their returns of the same episodes agree?

    Take episodes that the reward was not learned from, of good and of bad policies. An episode's return is the sum of
    its rewards.
    """

    reward: Annotated[
        Positional[Path], arg(metavar="REWARD", help="Folder of a learned reward, or of a run that has one.")
    ]
    demos: Annotated[
        tuple[Path, ...],
        arg(
            metavar="FILE",
            help="Episodes with actions and true rewards, of any format that `eairl demos --from` reads.",
        ),
    ]
    json: Json = None


@dataclass(frozen=True)
class Export:
    """Write the learned reward and the policy of a run as programs that need none of this library.

    StableHLO runs wherever jax runs: on CPU, CUDA, ROCm and TPU. ONNX runs in onnxruntime: in C++, in a browser, on a
    robot. The normaliser and the clipping of actions are inside. A JSON beside each program says how to call it.
    """

    run_folder: Annotated[Positional[Path], arg(metavar="RUN", help="Folder of a finished run.")]
    out: Annotated[Path, arg(metavar="DIR", help="Folder to write into.")]
    what: Annotated[
        tuple[Literal["reward", "policy"], ...],
        explained(help="Default: what the run holds. An expert has no learned reward."),
    ] = ()
    format: Annotated[tuple[Literal["stablehlo", "onnx"], ...], arg(help="ONNX needs jax2onnx (`make onnx`).")] = (
        "stablehlo",
    )
    seed: Annotated[int | None, explained(help="A seed of the run. Default: the run's first.")] = None
    net: Net = None


@dataclass(frozen=True)
class Runs:
    """List the runs in a folder: task, method, seeds, iterations done, score, age and size; the newest first.

    A score in brackets is that of the last iteration of a run that is not finished.
    """

    directory: Annotated[Positional[Path], arg(metavar="DIR", help="Folder that holds runs.")] = Path("runs")
    json: Json = None


@dataclass(frozen=True)
class Compare:
    """Compare runs: their curves over each other, their scores, and how sure the difference is.

    A sweep is compared by its points. Runs of different tasks are compared by their normalised scores. A run may still
    train: its scores are then means of the last tenth so far.
    """

    run_folders: Annotated[Positional[tuple[Path, ...]], arg(metavar="RUN", help="Folders of runs.")]
    metric: Annotated[str, arg(metavar="NAME", help="The metric of the curves, a column of metrics.csv.")] = (
        "true_return"
    )
    out: Annotated[
        Path | None, explained(metavar="DIR", help="Folder of the figure and the page. Default: runs/compare-...")
    ] = None


@dataclass(frozen=True)
class Clean:
    """Remove the checkpoints of finished runs. Without --yes nothing is removed, and a table says what would be.

    A run without checkpoints keeps results, curves, rewards and policies. It cannot go on beyond its end.
    """

    directory: Annotated[Positional[Path], arg(metavar="DIR", help="Folder that holds runs.")] = Path("runs")
    yes: Annotated[bool, arg(help="Remove them.")] = False


@dataclass(frozen=True)
class Watch:
    """Show the curves of a run while it trains. The run is only read.

    In a terminal the curves are drawn again whenever there is news; elsewhere each news is a line. The command ends
    with the run, or with Ctrl-C.
    """

    run_folder: Annotated[Positional[Path], arg(metavar="RUN", help="Folder of a run.")]
    every: Annotated[float, arg(help="Seconds between two looks.")] = 2.0


@dataclass(frozen=True)
class Diagnose:
    """Say of a finished transfer whether its learned reward is mistaken, or the training on it was not good enough.

    Other behaviours are judged by the same reward: the target's expert, policies that begin as the expert and are
    trained on the reward, plans, and the policies of other runs. They are only compared, never scored.
    """

    run_folder: Annotated[Positional[Path], arg(metavar="RUN", help="Folder of a finished transfer.")]
    policies: Annotated[
        tuple[Path, ...],
        explained(metavar="RUN", help="Other finished runs in the same target, whose policies are judged too."),
    ] = ()
    out: Annotated[
        Path | None, explained(metavar="DIR", help="Folder of the diagnosis and its figure. Default: the run's.")
    ] = None


@dataclass(frozen=True)
class View:
    """Play an episode of a run: a web page that needs no network, a strip of frames, and a movie.

    An expert or an imitation may still train: the policy is then that of its newest checkpoint.

    The pictures need OpenGL (EGL on a machine without a display; the variable MUJOCO_GL chooses another). The page
    does not.
    """

    run_folder: Annotated[Positional[Path], arg(metavar="RUN", help="Folder of a run.")]
    seed: Annotated[int | None, explained(help="Seed of the policy to play. Default: the run's first.")] = None
    out: Annotated[Path | None, explained(metavar="DIR", help="Folder to write. Default: RUN/view.")] = None


@dataclass(frozen=True)
class Bench:
    """Measure an iteration beside its simulation, its stages, five seeds beside one, and the compilation."""

    task: Task
    method: Methods = ("eairl",)
    reward_form: Forms = ("default",)
    horizon: Horizon = None
    demos: Demos = None
    json: Json = None
    iterations: int = 20
    """Iterations of each measurement."""
    set: Set = ()
    scale: Annotated[
        tuple[str, ...],
        explained(
            metavar="NAME=VALUES",
            help="Measure iterations of one method at several values instead, e.g. num_envs=16,64,256 seeds=1,4,16: "
            "time, memory, and a law that fits the time. One axis varies at a time.",
        ),
    ] = ()
    figure: Annotated[Path | None, explained(metavar="FILE", help="With --scale: save a figure as PNG.")] = None


SOURCE_ALONE = (
    "a search looks at the task that is demonstrated alone: settings that are chosen by the score in the target of a "
    "transfer would make that score no measure of the reward any more; leave the target out"
)
# Options that a user may expect of a command, and why it has none.
NOT_OFFERED = {("search", "--target"): SOURCE_ALONE}

# The module of a command has the command's name: `commands/demos.py` does what `Collect` asks.
COMMANDS = {
    "tasks": Tasks,
    "settings": Settings,
    "expert": Expert,
    "demos": Collect,
    "imitate": Imitate,
    "sweep": Sweep,
    "search": Search,
    "transfer": Transfer,
    "reproduce": Reproduce,
    "runs": Runs,
    "compare": Compare,
    "watch": Watch,
    "clean": Clean,
    "report": Report,
    "evaluate": Evaluate,
    "correlate": Correlate,
    "export": Export,
    "diagnose": Diagnose,
    "view": View,
    "bench": Bench,
}
