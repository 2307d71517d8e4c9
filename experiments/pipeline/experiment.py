"""What is run: an `Experiment`, checked before anything is computed.

`imitations`, `sweeps` and `transfers` build experiments from a command's options; `run.run` runs one.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from eairl_jax import (
    InputError,
    demonstrations,
    horizon,
)
from eairl_jax.config import OWN_PART, Config
from eairl_jax.discriminator import check_network
from eairl_jax.discriminator_data import check_segments
from eairl_jax.envs.names import file_name
from eairl_jax.envs.registry import each_of
from eairl_jax.experiments.options import Bench, Imitate, Search, Sweep, Transfer
from eairl_jax.experiments.pipeline import records, user_methods, user_networks
from eairl_jax.experiments.pipeline.places import (
    Source,
    Target,
    explain_defaults,
    make_env,
    make_source,
    make_target,
    measured,
    refuse_other_sizes,
    say_once,
)
from eairl_jax.experiments.pipeline.ranges import Searched
from eairl_jax.experiments.pipeline.trackers import Track
from eairl_jax.experiments.settings import (
    GROUPS,
    Recipe,
    choose_setting,
    parse_overrides,
    recipe,
    refuse_unread,
)
from eairl_jax.methods import METHODS, STATE_ONLY_ADVICE, needs_expert_actions, with_method_defaults
from eairl_jax.noise_ranking import RANKINGS
from eairl_jax.schema import LARGEST_SEED, shown

# A method that is trained for longer, on larger batches or by another optimiser is still the paper's method.
BUDGET = frozenset({"iterations", "snapshot_every", "num_envs", "rollout_length", "optimizer"})


# What a user is told of the horizon where the task may end an episode.
HORIZONS = {
    "fixed": "While learning, its simulation then goes on until the time limit (--horizon fixed)",
    "absorbing": "While learning, an absorbing state then follows (--horizon absorbing)",
    "variable": "WARNING: with --horizon variable the sign of the reward decides how long a policy wants to live, "
    "whatever is demonstrated; compare with --horizon absorbing",
}


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
    _refuse_without_own_part(points)
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


def _refuse_without_own_part(points: Sequence[dict[str, float]]) -> None:
    """Raises `InputError` if some points have parts of the reward for each source, and others none."""
    weights = {point[OWN_PART] for point in points if OWN_PART in point}
    if 0.0 in weights and len(weights) > 1:
        raise InputError(
            f"{OWN_PART}: with 0 the sources have no parts of their own, which is another program than with "
            f"{max(weights):g}; leave 0 out here, and train it by a command of its own"
        )


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
    source = make_source(task, env, options.demos)
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


def explain_demonstrations(source: Source, recipes: list[Recipe]) -> None:
    """Says what learning does with episodes that end early, and what looks wrong in demonstrations and may be right."""
    for kind in {each.config.horizon for each in recipes if each.config.horizon != "default"}:
        say_once(f"{source.task} may end an episode early. {HORIZONS[kind]}")
    for doubt in demonstrations.doubts(source.demos):
        say_once(f"{source.demos_path}: {doubt}")


def target_of(options: Transfer) -> Target:
    """The target of `eairl transfer`.

    Raises:
      InputError: for a setting that retraining does not have.
    """
    explain_defaults(options.target)
    return make_target(options.target, _retrain_settings(options), options.restarts, on_nan=options.on_nan)


def _retrain_settings(options: Transfer) -> tuple[str, ...]:
    return (f"optimizer={options.optimizer}", *options.retrain_set)
