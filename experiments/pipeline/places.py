"""Where rewards are learned and used: tasks with demonstrations, a recipe, and the returns that normalise a score."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import math
import shlex
from dataclasses import dataclass
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
from eairl_jax.environment import check_env, context_size
from eairl_jax.envs.mjx_task import Task
from eairl_jax.envs.names import file_name
from eairl_jax.envs.registry import each_of
from eairl_jax.experiments.display.console import say
from eairl_jax.experiments.pipeline import records
from eairl_jax.experiments.settings import (
    TRIALS,
    Recipe,
    has_recipe,
    parse_overrides,
    recipe,
    refuse_unread,
)

SCORE_EPISODES = 500
RANDOM_SEED = 20_000
UNMEASURED = math.nan
DEMOS = Path("demos")
"""Where `eairl demos` writes, and where demonstrations of a task are sought that come with no package."""

# The fields of a recipe that say which policies are trained on a reward.
RETRAINING = ("restarts", *sorted(TRIALS))


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


def make_source(task: str, env: Task, path: Path | None) -> Source:
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
    sources = [make_source(each, make_env(each), own) for each, own in zip(tasks, paths, strict=True)]
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


def shipped_demonstrations(task: str, quality: str = "") -> Path:
    """The demonstrations of a task that come with the package.

    Args:
      quality: of an imperfect demonstrator, its name: "half". The expert's if it is empty.

    Raises:
      InputError: if there are none.
    """
    name = ".".join(filter(None, (file_name(task), quality)))
    path = Path(str(files("eairl_jax.experiments") / "data" / f"{name}.npz"))
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
