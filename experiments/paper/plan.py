"""What `eairl reproduce` trains: the experiments behind the paper's tables, behind its figures, and our ablations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from eairl_jax.experiments.paper import results
from eairl_jax.experiments.paper.tables import HOME
from eairl_jax.experiments.pipeline.run import Result
from eairl_jax.methods import METHODS

FIRST_SEED = 20
"""The seeds below were used while the settings were chosen."""
QUICK_ITERATIONS, QUICK_SEEDS = 20, 2
QUICK_TASKS = ("pendulum", "point_maze_left")


@dataclass(frozen=True)
class Planned:
    """A planned experiment: a method imitates `task` and, if there is a target, its reward is used there.

    Attributes:
      task: the task that is demonstrated.
      method: key of `METHODS`, or "bc".
      form: reward form; "default" for the method's.
      target: the task in which the reward is used, which may be `task` itself; None for an imitation.
      rule: from which iteration the reward is taken.
      settings: `name=value` of learning that differ from the recipe.
      retrain_settings: `name=value` of retraining that differ from the recipe.
      tuned: whether our settings replace the paper's.
      quality: of the demonstrations (`shipped_demonstrations`); "" for the expert's.
    """

    task: str
    method: str
    form: str = "default"
    target: str | None = None
    rule: str = "last"
    settings: tuple[str, ...] = ()
    retrain_settings: tuple[str, ...] = ()
    tuned: bool = False
    quality: str = ""

    @property
    def variant(self) -> str:
        """What distinguishes how this experiment learns from others with the same method and form."""
        quality = [f"demos={self.quality}"] if self.quality else []
        return "+".join([*self.settings, *(["tuned"] if self.tuned else []), *quality])

    @property
    def name(self) -> str:
        """The name of the result."""
        default_form = METHODS[self.method].reward_form if self.method in METHODS else ""
        method = f"{self.method}-{self.form.replace('default', default_form)}" if default_form else self.method
        return "+".join([method, *filter(None, (self.variant, retrain_variant(self.retrain_settings)))])

    @property
    def identity(self) -> tuple[str, str, str | None, str | None]:
        """The identity of the result."""
        return self.name, self.task, self.target, self.rule if self.target else None

    @property
    def purpose(self) -> str:
        """For which purpose the recipe is chosen."""
        return "reward" if self.target else "imitate"


def retrain_variant(retrain_settings: tuple[str, ...]) -> str:
    """What distinguishes a retraining from the recipe's, as a part of a result's name."""
    return "+".join(f"retrain_{setting}" for setting in retrain_settings)


Pair = tuple[str, str]  # source and target
MethodForm = tuple[str, str]  # a method and a reward form

BOTH_MAZES = "point_maze_left+point_maze_right"
# Three experts of half-cheetah, to whom actions cost little, as much as usual, and much.
STYLES = "half_cheetah?control_cost=0.02+half_cheetah+half_cheetah?control_cost=0.5"
TASKS_BY_COST = (*BOTH_MAZES.split("+"), BOTH_MAZES, "pendulum", "swimmer", "half_cheetah", STYLES, "ant")
MAZES: tuple[Pair, Pair] = (("point_maze_left", "point_maze_right"), ("point_maze_right", "point_maze_left"))
ANTS: Pair = ("ant", "crippled_ant")
IMITATED = ("pendulum", "swimmer", "half_cheetah", "ant")
IMITATORS = ("bc", "gail", "gan_gcl", "airl_s", "airl_sa", "eairl", "eairl_release")
# The methods whose rewards the paper transfers, the variant in the authors' release, and two separable rewards of ours.
TRANSFERRED: tuple[MethodForm, ...] = (
    ("airl_s", "default"),
    ("airl_sa", "default"),
    ("eairl", "default"),
    ("eairl_release", "default"),
    ("airl_sa", "separable"),
    ("eairl", "separable"),
)
# Methods whose rewards the paper does not transfer.
ALSO_TRANSFERRED: tuple[MethodForm, ...] = (("gail", "default"), ("gan_gcl", "default"))
ABLATIONS = (
    ("shaping=none",),
    ("shaping=learned",),
    ("lambda_i=0",),
    ("lambda_i=0.001",),
    ("lambda_i=0.1",),
    ("l_i_actions=resampled",),
    ("history_length=1",),
)
# Of the separable reward in the mazes: Phi without the learned potential h, and the paper's lambda_I.
SEPARABLE_ABLATIONS = (("shaping=empowerment",), ("lambda_i=1",))
# Phi by the simulator, over K steps, in both directions and beside Phi = 0: `docs/results.md`, "Exact empowerment".
EXACT_PHI = tuple(("shaping=exact_empowerment", f"empowerment_steps={steps}") for steps in (1, 5, 20))
# The paper's own protocol of learning in the mazes: TRPO, 20,000 steps an update, 2.6M steps.
PROTOCOL = ("optimizer=trpo", "num_envs=200", "iterations=130")
# A part of the reward for each source beside the shared one.
OWN_PART = ("own_part=0.1",)
# Of the separable reward of the ant: the penalty on slopes in place of sparsity, less sparsity, other potentials.
ANT_ABLATIONS = (
    ("gradient_penalty=0.1", "input_sparsity=0"),
    ("input_sparsity=0.03",),
    ("shaping=none",),
    ("shaping=empowerment",),
)
# 10M steps of retraining, as in the paper's protocol. They would take too long for every method.
LONG = ("iterations=1600",)
# A policy a seed, as before the walkers' retraining had trials: `docs/results.md`, "From the ant to the crippled ant".
ONE_POLICY = ("trials=0",)
LONG_ONE_POLICY = (*LONG, *ONE_POLICY)


def _transfers(pair: Pair, source_retrained: tuple[MethodForm, ...] = TRANSFERRED) -> list[Planned]:
    """All methods by the last iteration and as moved policies, some by `source_retrain`, and a random reward."""
    source, target = pair
    methods_of_rule = {
        "last": (*ALSO_TRANSFERRED, *TRANSFERRED),
        "policy": (("bc", "default"), *ALSO_TRANSFERRED, *TRANSFERRED),
        "source_retrain": source_retrained,
    }
    learned = [
        Planned(source, method, form, target, rule)
        for rule, methods in methods_of_rule.items()
        for method, form in methods
    ]
    return [*learned, Planned(source, "eairl", "default", target, "random")]


def _back_home(pair: Pair) -> list[Planned]:
    """Rewards that train fresh policies in the task where they were learned."""
    return [Planned(pair[0], method, form, pair[0]) for method, form in TRANSFERRED]


def _iterations(pair: Pair, iterations: tuple[int, ...]) -> list[Planned]:
    """EAIRL's reward of several iterations. The authors' release reports the one that scores best in the target."""
    return [Planned(pair[0], "eairl", "default", pair[1], f"iteration={iteration}") for iteration in iterations]


def _maze_ablations(pair: Pair) -> list[Planned]:
    """EAIRL and its separable form with one setting changed, and a state-only reward with empowerment."""
    source, target = pair
    changes = [(form, settings) for form in ("default", "separable") for settings in ABLATIONS]
    changes += [("separable", settings) for settings in SEPARABLE_ABLATIONS]
    changed = [Planned(source, "eairl", form, target, settings=settings) for form, settings in changes]
    return [*changed, Planned(source, "eairl", "s", target)]


def _exact_phi(pair: Pair, others: tuple[tuple[str, ...], ...] = ()) -> list[Planned]:
    """EAIRL and its separable form with the simulator's Phi alone, and with other settings."""
    source, target = pair
    return [
        Planned(source, "eairl", form, target, settings=settings)
        for form in ("default", "separable")
        for settings in (*others, *EXACT_PHI)
    ]


def _protocol(pair: Pair) -> list[Planned]:
    """The methods that the paper transfers, learned as the paper learns."""
    return [Planned(pair[0], method, form, pair[1], settings=PROTOCOL) for method, form in TRANSFERRED[:3]]


def _ant_ablations(pair: Pair) -> list[Planned]:
    source, target = pair
    changed = [
        Planned(source, "eairl", "separable", target, settings=settings, retrain_settings=ONE_POLICY)
        for settings in ANT_ABLATIONS
    ]
    before = [
        Planned(source, method, form, target, retrain_settings=ONE_POLICY, tuned=tuned)
        for method, form, tuned in (
            ("airl_s", "default", False),
            ("airl_sa", "default", False),
            ("airl_sa", "default", True),
            ("eairl", "default", False),
            ("eairl", "default", True),
            ("airl_sa", "separable", False),
            ("eairl", "separable", False),
        )
    ]
    longer = [Planned(source, "eairl", "separable", target, retrain_settings=each) for each in (LONG_ONE_POLICY, LONG)]
    return [*changed, *before, *longer]


def _table1() -> list[Planned]:
    planned = []
    for pair in MAZES:
        planned += [*_transfers(pair), *_back_home(pair), *_iterations(pair, (40, 80))]
    planned += _transfers(ANTS, source_retrained=(("eairl", "default"), ("eairl", "separable")))
    planned += [*_back_home(ANTS), *_iterations(ANTS, (100, 200, 300))]
    return planned + [Planned(ANTS[0], method, form, ANTS[1], tuned=True) for method, form in TRANSFERRED[:3]]


def _sources() -> list[Planned]:
    """Rewards from one maze and from two, used in a maze that is neither: `docs/results.md`, "Several sources"."""
    methods: tuple[MethodForm, ...] = (
        ("eairl", "default"),
        ("airl_sa", "default"),
        ("airl_s", "default"),
        ("eairl", "separable"),
    )
    return [
        Planned(source, method, form, target)
        for method, form in methods
        for source in (BOTH_MAZES, "point_maze_left", "point_maze_right")
        for target in ("point_maze_middle", "point_maze_double")
    ]


def _imperfect() -> list[Planned]:
    """Rewards from an expert that was stopped early, used where they were learned, by one policy a seed."""
    rules_of: dict[MethodForm, tuple[str, ...]] = {
        ("eairl", "separable"): ("last", "ssrr", "d_rex"),
        ("airl_s", "default"): ("last", "ssrr", "d_rex"),
        ("bc", "default"): ("d_rex",),
    }
    return [
        Planned("half_cheetah", method, form, "half_cheetah", rule, retrain_settings=ONE_POLICY, quality="half")
        for (method, form), rules in rules_of.items()
        for rule in rules
    ]


def _styles() -> list[Planned]:
    """Rewards from demonstrators of several styles: one for all, and with a part for each of them beside it."""
    return [
        Planned(STYLES, method, form, "half_cheetah", settings=settings, retrain_settings=ONE_POLICY)
        for method, form in (("eairl", "separable"), ("airl_s", "default"))
        for settings in ((), OWN_PART)
    ]


def _table2() -> list[Planned]:
    return [
        *(Planned(task, method) for task in IMITATED for method in IMITATORS),
        Planned("half_cheetah", "eairl", tuned=True),
        # Tests whether the expert's actions beyond their bounds are why the paper's settings fall short.
        Planned("half_cheetah", "eairl", settings=("actions=clipped",)),
        *(Planned("ant", method, tuned=True) for method in ("eairl", "gail", "airl_sa", "airl_s")),
    ]


EXPERIMENTS: dict[str, list[Planned]] = {
    "table1": _table1(),
    "table2": _table2(),
    "ablations": [
        *_maze_ablations(MAZES[0]),
        *_exact_phi(MAZES[0]),
        *_exact_phi(MAZES[1], others=(("shaping=none",),)),
        *_protocol(MAZES[0]),
        *_protocol(MAZES[1]),
        *_ant_ablations(ANTS),
    ],
    "sources": _sources(),
    "imperfect": _imperfect(),
    "styles": _styles(),
}
OURS = ("ablations", "sources", "imperfect", "styles")
"""Tables that the paper does not have."""
# The experiment whose results each figure shows.
FIGURES = {"figure2": "table1", "appendix-c": "table1"}


def is_wanted(planned: Planned, tasks: tuple[str, ...], quick: bool) -> bool:
    """Whether the experiment's task is asked for (no `tasks`: all are).

    A quick run is too short for rules that name an iteration.
    """
    return (not tasks or planned.task in tasks) and not (quick and planned.rule.startswith("iteration="))


def cheapest_first(plan: dict[str, list[Planned]]) -> list[tuple[str, Planned]]:
    """Pairs of table and planned experiment: by task, imitations before transfers, and the paper's tables first."""

    def cost(pair: tuple[str, Planned]) -> tuple[int, int, bool]:
        table, planned = pair
        last = OURS.index(table) + 1 if table in OURS else 0
        return last, TASKS_BY_COST.index(planned.task), planned.target is not None

    return sorted(((table, planned) for table, experiments in plan.items() for planned in experiments), key=cost)


class Missing(NamedTuple):
    """Experiments of one table and task that have no result, and the command that trains them."""

    experiment: str
    task: str
    names: list[str]
    command_line: str


def missing(results_of: dict[str, list[Result]]) -> list[Missing]:
    """What is planned and has no result.

    Args:
      results_of: the results of each table.
    """
    names: dict[tuple[str, str], list[str]] = {}
    for experiment, experiments in EXPERIMENTS.items():
        trained = {result.identity for result in results_of[experiment]}
        for planned in experiments:
            if planned.identity not in trained:
                targets = {each.target for each in experiments if each.task == planned.task}
                names.setdefault((experiment, planned.task), []).append(_title(planned, targets))
    return [
        Missing(experiment, task, titles, f"eairl reproduce {experiment} --task {task}")
        for (experiment, task), titles in names.items()
    ]


def _title(planned: Planned, targets: set[str | None]) -> str:
    """For example "GAIL" of an imitation, "EAIRL (random)" and "EAIRL (back in the source)" of transfers.

    Args:
      targets: of the task's experiments in the table. If several are other tasks, the title names the target.
    """
    is_home = planned.target == planned.task
    where = f" in {planned.target}" if len(targets - {planned.task, None}) > 1 and not is_home else ""
    rule = ", ".join([HOME] * is_home + [planned.rule] * (not is_home or planned.rule != "last"))
    return results.title(planned.name) + where + (f" ({rule})" if planned.target else "")
