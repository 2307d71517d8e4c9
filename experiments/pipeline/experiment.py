"""What is run: an `Experiment`, checked before anything is computed.

`imitations`, `sweeps` and `transfers` build experiments from a command's options; `run.run` runs one.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import itertools
import math
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np

from eairl_jax import (
    Demonstrations,
    HParams,
    InputError,
    demonstrations,
    envs,
    evaluate,
    horizon,
    normalize,
    random_policy,
)
from eairl_jax.config import Config
from eairl_jax.discriminator import check_network
from eairl_jax.discriminator_data import check_segments
from eairl_jax.environment import check_env, context_size
from eairl_jax.envs.mjx_task import Task
from eairl_jax.envs.names import file_name
from eairl_jax.envs.registry import each_of
from eairl_jax.experiments.display.console import say
from eairl_jax.experiments.options import Bench, Imitate, Search, Sweep, Transfer
from eairl_jax.experiments.pipeline import records, user_methods, user_networks
from eairl_jax.experiments.pipeline.ranges import Searched
from eairl_jax.experiments.pipeline.trackers import Track
from eairl_jax.experiments.settings import (
    GROUPS,
    TRIALS,
    Recipe,
    choose_setting,
    has_recipe,
    parse_overrides,
    recipe,
    refuse_unread,
)
from eairl_jax.methods import METHODS, STATE_ONLY_ADVICE, needs_expert_actions, with_method_defaults
from eairl_jax.noise_ranking import RANKINGS
from eairl_jax.schema import LARGEST_SEED, shown

SCORE_EPISODES = 500
RANDOM_SEED = 20_000
UNMEASURED = math.nan
DEMOS = Path("demos")
"""Where `eairl demos` writes, and where demonstrations of a task are sought that come with no package."""

# A method that is trained for longer, on larger batches or by another optimiser is still the paper's method.
BUDGET = frozenset({"iterations", "snapshot_every", "num_envs", "rollout_length", "optimizer"})

# The fields of a recipe that say which policies are trained on a reward.
RETRAINING = ("restarts", *sorted(TRIALS))


# What a user is told of the horizon where the task may end an episode.
HORIZONS = {
    "fixed": "While learning, its simulation then goes on until the time limit (--horizon fixed)",
    "absorbing": "While learning, an absorbing state then follows (--horizon absorbing)",
    "variable": "WARNING: with --horizon variable the sign of the reward decides how long a policy wants to live, "
    "whatever is demonstrated; compare with --horizon absorbing",
}


class Reference(NamedTuple):
    """The two true returns that a score is normalised by.

    Attributes:
      expert: mean return of the demonstrator; None if it is unknown.
      random: mean return of uniformly random actions; `UNMEASURED` until `measured` has played them.
    """

    expert: float | None
    random: float

    def normalized(self, returns) -> Any:
        """Returns, a number or an array, on a scale from 0 for random actions to 1 for the expert.

        None if the expert's return is unknown.
        """
        return None if self.expert is None else (returns - self.random) / (self.expert - self.random)


@dataclass(frozen=True)
class Source:
    """The task that was demonstrated.

    Attributes:
      task, env: its name, and the environment.
      demos, demos_path: the demonstrations, and the file that they came from.
      reference: expert's and random actions' true returns.
    """

    task: str
    env: Task
    demos: Demonstrations
    demos_path: Path
    reference: Reference


@dataclass(frozen=True)
class Target:
    """The task in which a reward is used.

    Attributes:
      task, env: its name, and the environment.
      recipe: how policies are trained on the reward.
      reference: expert's and random actions' true returns in the task.
      variant: names what differs from the task's recipe; empty if nothing does.
      demos: of the task's expert, to compare policies with. No policy that is scored begins from them.
    """

    task: str
    env: Task
    recipe: Recipe
    reference: Reference
    variant: str = ""
    demos: Demonstrations | None = None

    def settings(self) -> dict:
        """What decides how policies are trained here."""
        return {
            "target": self.task,
            "retrain_config": dataclasses.asdict(self.recipe.config),
            "retrain_hparams": dataclasses.asdict(self.recipe.hparams),
            "retrain_snapshot_every": self.recipe.snapshot_every,
            **{name: getattr(self.recipe, name) for name in RETRAINING},
        }

    def for_reward(self, learned: Config) -> Target:
        """The target for a reward learned with the configuration `learned`.

        The reward fixes the kind of actions and, where an episode may end, the horizon.
        """
        kind = learned.horizon
        if kind == "default" and horizon.can_end(self.env):
            kind = "fixed"  # the reward was learned where no episode ends
        return self.with_config(actions=learned.actions, horizon=kind)

    def with_horizon(self, learned: Config) -> Target:
        """The target with the horizon of a reward learned with the configuration `learned`."""
        return self.with_config(horizon=self.for_reward(learned).recipe.config.horizon)

    def with_config(self, **changes) -> Target:
        """The target with changes of its recipe's configuration."""
        config = dataclasses.replace(self.recipe.config, **changes)
        return dataclasses.replace(self, recipe=dataclasses.replace(self.recipe, config=config))


Place = TypeVar("Place", Source, Target)


@dataclass(frozen=True)
class Rule:
    """Which reward of each seed is used. No rule looks at the target task.

    Attributes:
      kind: "last"; "iteration"; "source_retrain", the snapshot on which policies trained in the source do best there;
        a name of `noise_ranking.RANKINGS`, a new reward that is fitted to noisy episodes of the last policy. To compare
        with: "random", the reward before learning, and "policy", no reward: the imitating policy itself is scored in
        the target.
      iteration: for "iteration", which one.
      repeats: for "source_retrain", policies trained on each snapshot.
      iterations: for "source_retrain", the length of each training.
    """

    kind: str
    iteration: int = 0
    repeats: int = 2
    iterations: int = 0

    def __str__(self) -> str:
        return f"iteration={self.iteration}" if self.kind == "iteration" else self.kind

    @staticmethod
    def parse(text: str, learning: Recipe, retraining: Recipe) -> Rule:
        """Reads `last`, `source_retrain`, `iteration=N`, `random`, `policy` or the name of a ranking.

        Args:
          learning: how the reward is learned.
          retraining: how policies are trained on a reward in the source task.

        Raises:
          InputError: for anything else, or an N of which no snapshot is kept.
        """
        if text == "source_retrain":
            return Rule(text, repeats=min(2, retraining.restarts), iterations=retraining.source_retrain_iterations)
        if text in ("last", "random", "policy", *RANKINGS):
            return Rule(text)
        name, _, number = text.partition("=")
        kept = snapshot_iterations(learning)
        if name != "iteration" or not number.isdigit():
            raise InputError(
                f"unknown rule {text!r}: choose last, source_retrain, {', '.join(RANKINGS)}, random, policy or "
                "iteration=N, e.g. "
                f"iteration={kept[-1]}"
            )
        if int(number) not in kept:
            raise InputError(
                f"no snapshot of iteration {number} is kept; snapshots are kept of iterations "
                f"{', '.join(map(str, kept))}"
            )
        return Rule("iteration", int(number))


def snapshot_iterations(learning: Recipe) -> list[int]:
    """The iterations of which a snapshot is kept."""
    return list(range(learning.snapshot_every, learning.config.iterations + 1, learning.snapshot_every))


@dataclass(frozen=True)
class Use:
    """Where a learned reward is used.

    Attributes:
      target: the task in which fresh policies are trained on the reward.
      back_home: the source as such a task, where `source_retrain` compares snapshots.
      rule: which iteration's reward is used.
    """

    target: Target
    back_home: Target
    rule: Rule


@dataclass(frozen=True)
class Experiment:
    """One method with one reward form on one source task and, for a transfer, where its reward is used.

    Attributes:
      source: the task and its demonstrations.
      recipe: how the method is trained; `recipe.config` names the method and the reward form.
      seeds: numbers of the seeds, trained side by side.
      variant: names the settings that differ from those of the method; empty if the experiment has the usual ones.
      is_changed: whether any setting of the method was changed (`BUDGET` apart).
      points: of a sweep, the values of the swept floats; every point is trained with every seed.
      swept_names: of a sweep over settings that are no floats, their values here; `variant` has them too.
      use: of a transfer, where the reward is used.
      track: who is told of each chunk of the learning, and of the training on the reward (`trackers.tracked`).
      more_seeds: of an imitation, how many seeds are trained after `seeds`, in folders of their own (`more_seeds`).
    """

    source: Source
    recipe: Recipe
    seeds: range
    variant: str = ""
    is_changed: bool = False
    points: tuple[dict[str, float], ...] = ()
    use: Use | None = None
    track: tuple[Track, ...] = ()
    more_seeds: int = 0
    swept_names: dict[str, Any] = field(default_factory=dict)

    @property
    def config(self) -> Config:
        """The static settings of learning."""
        return self.recipe.config

    @property
    def has_reward(self) -> bool:
        """Whether the method learns a reward. Behaviour cloning does not."""
        return self.config.method in METHODS

    @property
    def learning_name(self) -> str:
        """Method, reward form and variant: "eairl-separable", "eairl-sa+lambda_i=0", "bc"."""
        method = file_name(self.config.method)
        name = f"{method}-{with_method_defaults(self.config).reward_form}" if self.has_reward else method
        return f"{name}+{self.variant}" if self.variant else name

    @property
    def name(self) -> str:
        """`learning_name`, and how the retraining differs from its recipe."""
        return "+".join(filter(None, (self.learning_name, self.use.target.variant if self.use else "")))

    @property
    def is_published(self) -> bool:
        """Whether the experiment is one of the paper's: the method with its usual settings and reward form."""
        method = METHODS.get(self.config.method)
        has_usual_form = method is None or with_method_defaults(self.config).reward_form == method.reward_form
        has_usual_retraining = not (self.use and self.use.target.variant)
        return has_usual_form and has_usual_retraining and not self.variant and not self.is_changed

    def learning_settings(self) -> dict:
        """What makes the learning different from any other. Experiments that agree on it share one learning."""
        return {
            "task": self.source.task,
            # The content of the file, not its place: a run goes on after the project has moved, never on other data.
            "demonstrations": f"{self.source.demos_path.name} {demonstrations.fingerprint(self.source.demos)}",
            "seeds": list(self.seeds),
            "config": dataclasses.asdict(self.config),
            "hparams": dataclasses.asdict(self.recipe.hparams),
            "snapshot_every": self.recipe.snapshot_every,
        }

    def settings(self) -> dict:
        """What makes the experiment different from any other."""
        settings = self.learning_settings()
        if self.points:
            settings["sweep"] = list(self.points)
        if self.use:
            settings |= self.use.target.settings() | {"rule": dataclasses.asdict(self.use.rule)}
        return settings

    def with_target_variant(self, variant: str) -> Experiment:
        """The same experiment, its retraining named `variant` because it differs from the target's recipe."""
        assert self.use is not None
        target = dataclasses.replace(self.use.target, variant=variant)
        return dataclasses.replace(self, use=dataclasses.replace(self.use, target=target))

    def folder_name(self) -> str:
        """The name of the experiment's folder."""
        if self.use:
            return transfer_folder_name(self.source.task, self.use.target.task, self.name, str(self.use.rule))
        if self.points:
            return "-".join(["sweep", file_name(self.source.task), self.name, *self.points[0]])
        return f"imitate-{file_name(self.source.task)}-{self.name}"


def transfer_folder_name(source: str, target: str, name: str, rule: str) -> str:
    """The name of a transfer's folder, from what a `Result` holds."""
    return f"transfer-{file_name(source)}-to-{file_name(target)}-{name}-{rule}"


def imitations(options: Imitate | Bench, purpose: str = "imitate") -> list[Experiment]:
    """An experiment for each method and reward form of a command, everything checked.

    Args:
      purpose: of the recipe, a key of `recipes.PURPOSE_DEFAULTS`.

    Raises:
      InputError: for anything that could not be trained.
    """
    return _learnings(options.task, options, purpose)


def transfers(options: Transfer) -> list[Experiment]:
    """An experiment for each method, reward form and rule of `eairl transfer`, everything checked.

    Raises:
      InputError: for anything that could not be trained, or tasks of different sizes.
    """
    refuse_other_sizes(options.source, options.target)
    if "policy" in options.rule and len(each_of(options.source)) > 1:
        raise InputError(
            f"--rule policy: the policy of {options.source} reads which source it is in, and {options.target} is none "
            "of them; choose another rule"
        )
    target = target_of(options)
    back_home = make_target(options.source, _retrain_settings(options), has_expert=False, on_nan=options.on_nan)
    uses = []
    for learning in _learnings(options.source, options, "reward"):
        for text in options.rule:
            _refuse_without_reward(learning, text)
            uses.append((learning, Rule.parse(text, learning.recipe, back_home.recipe)))
    target = measured(target)
    return [
        dataclasses.replace(
            learning,
            use=Use(target.with_horizon(learning.config), back_home.with_horizon(learning.config), rule),
        )
        for learning, rule in uses
    ]


def _refuse_without_reward(learning: Experiment, rule: str) -> None:
    """Raises `InputError` if a rule needs a reward that the method does not learn."""
    without = ["policy", *(name for name, ranking in RANKINGS.items() if not ranking.rates)]
    if not learning.has_reward and rule not in without:
        raise InputError(
            f"{learning.name} learns no reward, and the rule {rule} needs one: choose one of {', '.join(METHODS)}, or "
            f"--rule {' or '.join(without)}"
        )


def sweeps(options: Sweep) -> list[Experiment]:
    """The experiments of `eairl sweep`, one for each combination of the values that are no floats.

    Raises:
      InputError: if nothing is swept, or a point could not be trained.
    """
    fixed, names, floats = split_grid(options.set)
    combinations = [dict(zip(names, values, strict=True)) for values in itertools.product(*names.values())]
    return [_sweep(options, fixed, combination, floats) for combination in combinations]


def _sweep(options: Sweep, fixed: tuple[str, ...], names: dict[str, str], grid: dict[str, list[float]]) -> Experiment:
    """One program: one method, one lane for each point of the grid of floats and each seed."""
    fixed = (*fixed, *(f"{name}={value}" for name, value in names.items()))
    points = tuple(dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values()))
    experiment = _for_points(options, fixed, points)
    variant = "+".join(filter(None, (experiment.variant, *(f"{name}={value}" for name, value in names.items()))))
    return dataclasses.replace(experiment, points=points, variant=variant, swept_names=names)


def searched(options: Search, space: Searched) -> Experiment:
    """The experiment of `eairl search`, without points: one program for any values of the searched floats.

    A setting that diverges is a bad setting, and no reason to stop.

    Raises:
      InputError: if a value of the searched floats could not be trained.
    """
    ends = tuple({name: value} for name, domain in space.domains.items() for value in domain.ends)
    return _for_points(options, space.fixed, ends)


def _for_points(options: Sweep | Search, fixed: tuple[str, ...], points: Sequence[dict[str, float]]) -> Experiment:
    """An experiment whose program can train all these values; every point is checked before any is trained."""
    # The largest value decides what has to be computed at all (a penalty of weight 0 is not).
    names = dict.fromkeys(name for point in points for name in point)
    largest = tuple(f"{name}={max(point[name] for point in points if name in point)}" for name in names)
    request = Imitate(
        task=options.task,
        method=(options.method,),
        reward_form=(options.reward_form,),
        seeds=options.seeds,
        first_seed=options.first_seed,
        horizon=options.horizon,
        optimizer=options.optimizer,
        demos=options.demos,
        track=getattr(options, "track", ()),
        on_nan=getattr(options, "on_nan", "skip"),
        set=(*fixed, *largest),
    )
    (experiment,) = imitations(request)
    overrides = {"method": options.method, "reward_form": options.reward_form} | parse_overrides(fixed)
    for point in points:  # an impossible point is refused before any point is trained
        recipe(options.task, experiment.source.env, "imitate", overrides | point)
    return experiment


class Grid(NamedTuple):
    """The assignments of a sweep: those of one value, and by setting the values of the others.

    Attributes:
      fixed: `name=value`.
      names: values of settings that are no floats, as text. Each needs a program of its own.
      floats: values of floats, which one program trains side by side.
    """

    fixed: tuple[str, ...]
    names: dict[str, list[str]]
    floats: dict[str, list[float]]


def split_grid(assignments: tuple[str, ...]) -> Grid:
    """Separates `name=a,b,c`, which are swept, from single values.

    Raises:
      InputError: if nothing is swept, or if a value is none of its setting.
    """
    fixed, names, floats = [], {}, {}
    for assignment in assignments:
        name, _, text = assignment.partition("=")
        choose_setting(name)
        if "," not in text or name in ("hidden", "policy_hidden", "value_hidden"):
            fixed.append(assignment)
            continue
        values = text.split(",")
        if len(set(values)) < len(values):
            raise InputError(f"--set {assignment}: expected different values")
        parsed = [parse_overrides((f"{name}={value}",))[name] for value in values]
        if name in GROUPS["hparams"]:
            floats[name] = parsed
        else:
            names[name] = values
    if not names and not floats:
        raise InputError("nothing to sweep: give a list of values, e.g. --set lambda_i=0,0.001,0.1,1")
    return Grid(tuple(fixed), names, floats)


def _learnings(task: str, options: Imitate | Transfer | Bench, purpose: str) -> list[Experiment]:
    """An experiment for each method and reward form, its reward not used anywhere yet."""
    seeds, tuned = _seeds(options), getattr(options, "tuned", False)
    overrides = parse_overrides((f"optimizer={getattr(options, 'optimizer', 'ppo')}", *options.set))
    training = {name: getattr(options, name, getattr(Recipe, name)) for name in ("on_nan", "more")}
    more_seeds = getattr(options, "more_seeds", 0)
    if more_seeds < 0:
        raise InputError(f"--more-seeds {more_seeds}: expected 0 or more")
    checked_seeds(len(seeds) + more_seeds, seeds.start)
    env = make_env(task)
    for method in options.method:
        user_methods.register(method)
    user_networks.register(overrides.get("net"))
    source = _source(task, env, options.demos)
    recipes = [
        recipe(
            task,
            env,
            purpose,
            {"method": method, "reward_form": form} | overrides | horizon_of(options, source, method) | training,
            tuned,
        )
        for method in options.method
        for form in (options.reward_form if method in METHODS else ("default",))
    ]
    refuse_unread([each.config for each in recipes], overrides)
    for each in recipes:
        check_demonstrations(source, each.config)
        check_network(env.observation_size, env.action_size, each.config)
    is_changed, source = bool(set(overrides) - BUDGET), measured(source)
    explain_defaults(task)
    explain_demonstrations(source, recipes)
    variant, track = "tuned" if tuned else "", getattr(options, "track", ())
    experiments = [
        Experiment(source, each, seeds, variant, is_changed, track=track, more_seeds=more_seeds) for each in recipes
    ]
    return list({experiment.name: experiment for experiment in experiments}.values())


def horizon_of(options: Imitate | Transfer | Bench, source: Source, method: str) -> dict[str, str]:
    """The setting `horizon`, if the task can end an episode and the method learns a reward."""
    if method not in METHODS or not horizon.can_end(source.env):
        return {}
    return {"horizon": getattr(options, "horizon", None) or horizon.of_learned_reward(source.env)}


def check_demonstrations(source: Source, config: Config) -> None:
    """Checks that a method can learn from demonstrations.

    Raises:
      InputError: if the demonstrations do not fit the task, the time limit, the horizon or the method.
    """
    where = str(source.demos_path)
    demonstrations.check_fits(source.demos, source.env, where)
    is_cloning = config.method not in METHODS
    config = config if is_cloning else with_method_defaults(config)
    default = "variable" if is_cloning else horizon.of_learned_reward(source.env)
    resolved = horizon.resolved(source.env, config, default)
    horizon.check_demonstrations(source.env, source.demos, resolved, where)
    if source.demos.action is None and needs_expert_actions(config):
        raise InputError(f"{where} holds no actions, which {config.method} needs: {STATE_ONLY_ADVICE}")
    if not is_cloning:
        for length in np.unique(horizon.learned_lengths(source.demos, resolved)):
            check_segments(resolved, int(length))


def _seeds(options: Imitate | Transfer | Bench) -> range:
    count, first = getattr(options, "seeds", 5), getattr(options, "first_seed", 0)
    if count < 1 or first < 0:
        raise InputError(f"--seeds {count} --first-seed {first}: expected at least 1 seed, and no negative number")
    return checked_seeds(count, first)


def checked_seeds(count: int, first: int = 0) -> range:
    """The numbers of seeds.

    Raises:
      InputError: if these are too many, or if one is so large that a smaller seed has the same random numbers.
    """
    if not (1 <= count <= records.MOST_SEEDS and 0 <= first <= LARGEST_SEED + 1 - count):
        raise InputError(
            f"{shown(count)} seeds from {shown(first)}: expected 1 to {records.MOST_SEEDS} seeds, each from 0 to "
            f"{LARGEST_SEED}"
        )
    return range(first, first + count)


@functools.cache
def make_env(task: str, **settings) -> Task:
    """The environment of a task.

    Raises:
      InputError: for an unknown task, or one that cannot be made, or an environment that does not fit.
    """
    try:
        env = envs.make(task, **settings)
    except envs.UnfitEnvironment as e:
        check_env(e.env)  # says which call makes it fit, if there is one
        raise InputError(str(e)) from None
    except envs.TaskError as e:
        raise InputError(str(e)) from None
    check_env(env)
    return env


@functools.cache
def say_once(text: str) -> None:
    """A remark that is printed once a process."""
    say(text)


def explain_defaults(task: str) -> None:
    """Says of a task without a recipe that it is trained with defaults."""
    if not has_recipe(task):
        say_once(
            f"{task} has no recipe: it is trained with defaults for its episode length "
            f"(`eairl settings {shlex.quote(task)}` shows them, --set changes them)"
        )


def explain_demonstrations(source: Source, recipes: list[Recipe]) -> None:
    """Says what learning does with episodes that end early, and what looks wrong in demonstrations and may be right."""
    for kind in {each.config.horizon for each in recipes if each.config.horizon != "default"}:
        say_once(f"{source.task} may end an episode early. {HORIZONS[kind]}")
    for doubt in demonstrations.doubts(source.demos):
        say_once(f"{source.demos_path}: {doubt}")


def _source(task: str, env: Task, path: Path | None) -> Source:
    if len(tasks := each_of(task)) > 1:
        return _several_sources(task, tasks, env, path)
    path = path or default_demonstrations(task)
    demos = demonstrations.load(path, task, env.observation_size, env.action_size)
    return Source(task, env, demos, path, _reference(task, path, demos))


def _several_sources(task: str, tasks: list[str], env: Task, path: Path | None) -> Source:
    """Several sources as one. Its expert's return is the mean of theirs.

    Args:
      path: `FILE+FILE`, the demonstrations of each task; None for those that each task has.
    """
    paths = [Path(each) for each in str(path).split("+")] if path else [None] * len(tasks)
    if len(paths) != len(tasks):
        raise InputError(
            f"--demos {path}: {len(paths)} file{'s' if len(paths) > 1 else ''} for the {len(tasks)} tasks {task}; "
            "expected one for each, FILE+FILE"
        )
    sources = [_source(each, make_env(each), own) for each, own in zip(tasks, paths, strict=True)]
    for source in sources:
        demonstrations.check_fits(source.demos, source.env, str(source.demos_path))
    steps = [len(source.demos.obs) for source in sources]
    if max(steps) > 1.1 * min(steps):
        say_once(f"{task}: {', '.join(map(str, steps))} demonstrated steps; a task counts as often as it has steps")
    experts = [source.reference.expert for source in sources if source.reference.expert is not None]
    reference = Reference(
        float(np.mean(experts)) if len(experts) == len(sources) else None,
        float(np.mean([source.reference.random for source in sources])),
    )
    demos = demonstrations.of_several([source.demos for source in sources])
    return Source(task, env, demos, Path("+".join(source.demos_path.name for source in sources)), reference)


def target_of(options: Transfer) -> Target:
    """The target of `eairl transfer`.

    Raises:
      InputError: for a setting that retraining does not have.
    """
    explain_defaults(options.target)
    return make_target(options.target, _retrain_settings(options), options.restarts, on_nan=options.on_nan)


def _retrain_settings(options: Transfer) -> tuple[str, ...]:
    return (f"optimizer={options.optimizer}", *options.retrain_set)


def make_target(
    task: str,
    assignments: tuple[str, ...] = (),
    restarts: int | None = None,
    has_expert: bool = True,
    on_nan: str = Recipe.on_nan,
) -> Target:
    """A task with its recipe for retraining; its reference is not `measured` yet.

    The expert's return is that of the demonstrations that come with the package, or of those in `DEMOS`. Without any
    the expert is unknown.

    Args:
      assignments: a user's `name=value` for the recipe.
      restarts: a user's number of restarts.
      has_expert: whether the demonstrations of an expert are sought.
      on_nan: see `Recipe.on_nan`.

    Raises:
      InputError: for a setting that retraining does not have.
    """
    env = make_env(task)
    overrides = parse_overrides(assignments)
    more = {"on_nan": on_nan} | ({} if restarts is None else {"restarts": restarts})
    training = recipe(task, env, "retrain", overrides | more)
    refuse_unread([training.config], overrides, reinforcement=True)
    if "actions" in overrides:
        raise InputError(
            "--retrain-set actions: the reward fixes this setting; choose it while the reward is learned, with "
            "--set actions=..."
        )
    path = find_demonstrations(task) if has_expert else None
    if path is None:
        return Target(task, env, training, Reference(None, UNMEASURED))
    demos = demonstrations.load(path, task, env.observation_size, env.action_size)
    return Target(task, env, training, _reference(task, path, demos), demos=demos)


def restored_target(settings: dict, path: Path) -> Target:
    """The target of a finished transfer; its reference is not `measured` yet.

    Args:
      settings: those in the folder of the transfer.
      path: that folder, for the error message.

    Raises:
      InputError: if the settings are not those of a transfer.
    """
    if "retrain_config" not in settings:
        raise InputError(f"{path} is no transfer: give a folder that `eairl transfer` made (transfer-...)")
    names = ["target", "retrain_config", "retrain_hparams", "retrain_snapshot_every"]
    task, config, hparams, every = records.needed(settings, names, path)
    target = make_target(task)
    config = Config.from_json(config, path / "config.json")
    hparams = HParams.from_json(hparams, path / "config.json")
    restored = Recipe(config, hparams, every, **{name: settings[name] for name in RETRAINING if name in settings})
    return dataclasses.replace(target, recipe=restored)


def refuse_other_sizes(source: str, target: str) -> None:
    """Raises `InputError` unless both tasks have the same sizes of observations and actions."""
    if len(each_of(target)) > 1:
        raise InputError(f"{target}: a reward is used in one task at a time; several tasks can only be the source")
    sizes = [(reward_obs_size(env), env.action_size) for env in map(make_env, (source, target))]
    if sizes[0] != sizes[1]:
        raise InputError(
            f"a reward of {source} (observations of {sizes[0][0]}, actions of {sizes[0][1]}) does not fit {target} "
            f"({sizes[1][0]} and {sizes[1][1]}): choose tasks of the same sizes"
        )


def reward_obs_size(env: Task) -> int:
    """The length of an observation as a learned reward sees it: without the entries that name one of several tasks."""
    return normalize.flat_size(env) - context_size(env)


def shipped_demonstrations(task: str) -> Path:
    """The demonstrations of a task that come with the package.

    Raises:
      InputError: if there are none.
    """
    path = Path(str(files("eairl_jax.experiments") / "data" / f"{file_name(task)}.npz"))
    if not path.exists():
        raise InputError(
            f"no demonstrations of {task} come with the package: make some with `eairl expert {shlex.quote(task)}` and "
            f"`eairl demos {shlex.quote(task)}`, or give some with --demos"
        )
    return path


def find_demonstrations(task: str) -> Path | None:
    """The demonstrations of a task that come with the package, or those that `eairl demos` wrote here, if any."""
    with contextlib.suppress(InputError):
        return shipped_demonstrations(task)
    path = DEMOS / f"{file_name(task)}.npz"
    if not path.is_file():
        return None
    say_once(f"demonstrations of {task}: {path}")
    return path


def default_demonstrations(task: str) -> Path:
    """What `find_demonstrations` finds.

    Raises:
      InputError: if there are none.
    """
    return find_demonstrations(task) or shipped_demonstrations(task)


def _reference(task: str, path: Path, demos: Demonstrations) -> Reference:
    """Expert's and random actions' returns: from the provenance if it has them.

    Else the expert's is that of the episodes, if they have rewards, and that of random actions is to be `measured`.
    """
    place = demonstrations.provenance_path(path)
    provenance = demonstrations.provenance(path) if place.exists() else {}
    if provenance and provenance.get("task") != task:
        raise InputError(f"{place} describes {provenance.get('task')!r}, not {task!r}: give demonstrations of {task!r}")
    returns = demonstrations.returns(demos)
    expert = None if returns is None else float(returns.mean())
    if "expert_return" in provenance:
        expert = float(provenance["expert_return"])
    random = float(provenance["random_return"]) if "random_return" in provenance else UNMEASURED
    return _told_apart(task, Reference(expert, random))


def _told_apart(task: str, reference: Reference) -> Reference:
    """The reference; `InputError` if its two returns are equal, so that nothing lies between them."""
    if reference.expert is not None and math.isclose(reference.expert, reference.random, rel_tol=1e-9):
        raise InputError(
            f"the expert of {task} and random actions both have the return {reference.expert:g}, so no score can be "
            "normalised by them: give demonstrations of a better expert, or correct the JSON beside them"
        )
    return reference


def measured(place: Place) -> Place:
    """The source or target with the return of random actions, played where no file says what it is.

    Raises:
      InputError: if the expert's return is the same.
    """
    if not math.isnan(place.reference.random):
        return place
    reference = _told_apart(place.task, place.reference._replace(random=random_return(place.env)))
    return dataclasses.replace(place, reference=reference)


def random_return(env: Task) -> float:
    """Mean true return of uniformly random actions over 500 episodes; played once a process."""
    return _random_return(env, SCORE_EPISODES)


@functools.cache
def _random_return(env: Task, episodes: int) -> float:
    run = jax.jit(lambda key: evaluate(key, env, random_policy(env), episodes, env.episode_length)[0])
    return float(run(jax.random.PRNGKey(RANDOM_SEED)).mean())
