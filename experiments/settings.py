"""Every setting that `--set` accepts: its default, its documentation, how it is read, and how recipes are made."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import itertools
import textwrap
from dataclasses import dataclass, fields
from typing import Any

from eairl_jax import Config, HParams, InputError
from eairl_jax.arguments import Range
from eairl_jax.config import OWN_PART, choose
from eairl_jax.envs.mjx_task import Task
from eairl_jax.envs.names import OWN, TaskName, parse
from eairl_jax.envs.registry import each_of
from eairl_jax.experiments.recipes import PURPOSE_DEFAULTS, RECIPES, sections_of
from eairl_jax.hparams import RANGES, check_hparams
from eairl_jax.methods import EXACT_PHI, METHODS, uses_empowerment, with_method_defaults
from eairl_jax.named_networks import MLP


@dataclass(frozen=True)
class Recipe:
    """How to train for one purpose."""

    config: Config
    hparams: HParams
    snapshot_every: int = 40
    """Iterations between two snapshots of the reward. A chunk of training is as long."""
    restarts: int = 1
    """Policies trained to the end for each score. The one that its own reward rates best is kept."""
    source_retrain_iterations: int = 1
    """Iterations of a training by which the rule `source_retrain` judges a snapshot."""
    trials: int = 0
    """Policies that begin for each score, those that are not random in different places (`eairl_jax.plans`). After
    `trial_iterations` the `restarts` of them go on that their own reward rates best. 0: `restarts` policies begin as
    random networks."""
    trial_iterations: int = 0
    """Iterations of a trial; they are a part of `iterations`."""
    random_trials: int = 0
    """Trials that begin as random networks instead. If there are other trials, the random ones all go on: with a wide
    std (`random_std`) a policy earns little before its std falls, and would lose the comparison."""
    random_std: float = 1.0
    """The std of a random trial before the first iteration, as a multiple of the std of the other trials. All policies
    end with the same std. Above 0, at most 1e6."""
    on_nan: str = "stop"
    """What happens when a value of a seed is no longer finite. "stop": the training stops. "skip": the seed is dropped,
    and the others go on."""
    more: int = 0
    """Iterations beyond `config.iterations`. Annealed rates keep their final values there."""

    def __post_init__(self):
        Range(included=False).check("random_std", self.random_std, type(self).random_std)

    @property
    def last_iteration(self) -> int:
        """The iteration with which the training ends."""
        return self.config.iterations + self.more

    @property
    def env_steps(self) -> int:
        """Environment steps of one seed in the whole training."""
        return self.config.steps_per_iteration * self.last_iteration

    def checked(self) -> Recipe:
        """The recipe with short trainings that are possible in its number of iterations.

        A snapshot is never judged by a longer training than the one that it stands for. A trial is at most half of a
        training, and the trials are at least as many as the restarts; a training of 1 iteration has no trials. If there
        are other trials, at most half of the policies that go on are random ones.
        """
        iterations = self.config.iterations
        length = min(self.trial_iterations, iterations // 2)
        trials = max(self.trials, self.restarts) if self.trials and length else 0
        return dataclasses.replace(
            self,
            source_retrain_iterations=min(self.source_retrain_iterations, iterations),
            trials=trials,
            trial_iterations=length if trials else 0,
            random_trials=trials if self.random_trials >= trials else min(self.random_trials, self.restarts // 2),
        )


# The groups of a recipe's settings, and the default of each setting by its name.
GROUPS: dict[str, dict[str, Any]] = {
    "config": {field.name: field.default for field in fields(Config)},
    "hparams": {field.name: field.default for field in fields(HParams)},
    "recipe": {
        "snapshot_every": Recipe.snapshot_every,
        "trials": Recipe.trials,
        "trial_iterations": Recipe.trial_iterations,
        "random_trials": Recipe.random_trials,
        "random_std": Recipe.random_std,
    },
}
SETTINGS: dict[str, Any] = {name: default for group in GROUPS.values() for name, default in group.items()}

# A penalty costs time, so it is computed only where its weight is not 0.
PENALTY_OF_WEIGHT = {
    "gradient_penalty": "gradient",
    "action_variance": "action_variance",
    "input_sparsity": "input_sparsity",
    "own_part": OWN_PART,
}


def recipe(task: str, env: Task, purpose: str, overrides: dict[str, Any], tuned: bool = False) -> Recipe:
    """The settings of a task for a purpose, with a user's overrides on top.

    Args:
      purpose: a key of `PURPOSE_DEFAULTS`.
      tuned: whether to use this project's settings where they differ from the paper's.

    Raises:
      InputError: for an impossible setting, or if `tuned` and the task has no such settings.
    """
    values = _merged(task, env, purpose, overrides, tuned)
    if "iterations" in overrides and "snapshot_every" not in overrides:
        values["snapshot_every"] = near_divisor(
            values["iterations"], values.get("snapshot_every", Recipe.snapshot_every)
        )
    training = {field.name: values.pop(field.name, field.default) for field in fields(Recipe)[2:]}
    values["penalties"] = tuple(penalty for weight, penalty in PENALTY_OF_WEIGHT.items() if values.get(weight))
    hparams = HParams(**{name: value for name, value in values.items() if name in GROUPS["hparams"]})
    config = Config(**{name: value for name, value in values.items() if name in GROUPS["config"]})
    check_hparams(hparams)
    result = Recipe(config, hparams, **training)
    _check_training(result)
    return result.checked()


def _merged(task: str, env: Task, purpose: str, overrides: dict[str, Any], tuned: bool) -> dict[str, Any]:
    """All sections that apply, the later ones on top."""
    sections = sections_of_task(task, env)
    merged = {"episode_length": env.episode_length}
    merged |= PURPOSE_DEFAULTS[purpose] | sections.get("all", {}) | sections.get(purpose, {})
    for name in ("reward_form", "method"):
        merged |= sections.get(f"{purpose} {overrides.get(name)}", {})
    if tuned:
        tasks = sorted(name for name in RECIPES if f"{purpose} tuned" in RECIPES[name])
        if f"{purpose} tuned" not in sections:
            raise InputError(
                f"--tuned: {task} has no tuned settings to {purpose}; these tasks have: {', '.join(tasks)}"
            )
        merged |= sections[f"{purpose} tuned"]
    # Of several tasks as one, each has as many environments as it has alone.
    return merged | {"num_envs": len(each_of(task)) * merged.get("num_envs", Config.num_envs)} | overrides


def has_recipe(task: str) -> bool:
    """Whether a task has an entry of its own in `RECIPES`. The first of several tasks speaks for all."""
    first = _first(task)
    return first.origin == OWN and first.name in RECIPES


def _first(task: str) -> TaskName:
    return parse(each_of(task)[0])


def sections_of_task(task: str, env: Task) -> dict[str, dict[str, Any]]:
    """The sections of a task, as `recipes.sections_of` gives them."""
    base = _first(task).name if has_recipe(task) else task
    return sections_of(base, env.episode_length, hasattr(env, "obs_mean"))


def _check_training(recipe: Recipe) -> None:
    every, iterations = recipe.snapshot_every, recipe.config.iterations
    if every < 1:
        raise InputError(f"snapshot_every = {every}: expected at least 1 iteration between two snapshots")
    if iterations % every:
        raise InputError(
            f"iterations = {iterations} is not a multiple of snapshot_every = {every}: "
            f"try --set snapshot_every={divisor(iterations, every)}"
        )
    if recipe.more < 0 or recipe.more % every:
        near = max(every, recipe.more // every * every)
        raise InputError(
            f"--more {recipe.more}: expected a multiple of snapshot_every = {every}, for example --more {near}"
        )
    if recipe.restarts < 1:
        raise InputError(f"--restarts {recipe.restarts}: expected at least 1")
    for name in ("trials", "trial_iterations", "random_trials"):
        if getattr(recipe, name) < 0:
            raise InputError(f"{name} = {getattr(recipe, name)}: expected 0 (no trials) or more")
    first_std = "std_initial_fraction"
    product = recipe.random_std * recipe.hparams.std_initial_fraction
    RANGES[first_std].check(f"random_std x {first_std}", product, Recipe.random_std)


def parse_overrides(assignments: tuple[str, ...]) -> dict[str, Any]:
    """Reads `name=value` pairs, each value by the type of the setting.

    Raises:
      InputError: for a name that is no setting (the message gives the nearest ones), or a value of another type.
    """
    overrides = {}
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        if not equals:
            raise InputError(f"--set {assignment}: expected name=value, e.g. --set lambda_i=0.1")
        choose_setting(name)
        overrides[name] = _parse(name, text, SETTINGS[name])
    return overrides


def choose_setting(name: str) -> None:
    """Raises `InputError` unless `name` is a setting."""
    try:
        choose("setting", name, SETTINGS)
    except InputError as e:
        raise InputError(f"{e}. `eairl settings` explains every setting") from None


def _parse(name: str, text: str, default: Any) -> Any:
    if name == "penalties":
        weights = ", ".join(f"{weight}=1" for weight in PENALTY_OF_WEIGHT)
        raise InputError(f"--set {name}: penalties follow from their weights; set one of {weights}")
    try:
        if isinstance(default, bool):
            return {"true": True, "false": False}[text.lower()]
        if isinstance(default, tuple):
            return tuple(int(width) for width in text.split(","))
        return type(default)(text)
    except (KeyError, ValueError):
        example = ",".join(map(str, default)) if isinstance(default, tuple) else str(default).lower()
        raise InputError(
            f"--set {name}={text}: expected something like {name}={example}; `eairl settings` explains every setting"
        ) from None


def near_divisor(iterations: int, near: int) -> int:
    """The divisor of `iterations` nearest to `near`: at most 4 times as large or as small, or all; else `near`."""
    smallest = max(1, min(near // 4, iterations))
    divisors = (n for n in range(smallest, min(4 * near, iterations) + 1) if iterations % n == 0)
    return min(divisors, key=lambda n: max(n / near, near / n), default=near)


def divisor(iterations: int, near: int) -> int:
    """The largest divisor of `iterations` that is at most `near`."""
    return next(n for n in range(min(near, iterations), 0, -1) if iterations % n == 0)


EMPOWERMENT = frozenset(
    {"lambda_i", "beta", "phi_lr", "inverse_lr", "empowerment_updates", "empowerment_batch", "inverse_loss"}
    | {"phi_sync_interval", "l_i_power", "l_i_actions", "l_i_in", "policy_phi"}
)
ADVERSARY = frozenset(
    {"discriminator_lr", "history", "history_length", "policy_reset_every", "shaping", "shaping_discount", "horizon"}
    | {"reward_form", "reward_obs", "action_part", "discriminates", "update_order", "hidden", "net"}
    | {"gradient_penalty", "action_variance", "input_sparsity", "own_part", "empowerment_steps"}
)
TRPO = frozenset({"kl_limit", "cg_damping", "cg_iterations", "line_search_steps"})
PPO = frozenset({"clip_eps", "max_grad_norm"})
# Only a retraining has trials.
TRIALS = frozenset({"trials", "trial_iterations", "random_trials", "random_std"})
# The temperature belongs to a reward that is given; an adversarial method's reward contains -log pi by itself.
TEMPERATURE = frozenset({"temperature", "temperature_final_fraction"})
REINFORCEMENT = frozenset(
    {"gamma", "gae_lambda", "entropy_weight", "entropy_final_fraction", "std_initial_fraction", "std_final_fraction"}
)


def unread_settings(config: Config) -> frozenset[str]:
    """The settings that a method with its optimiser never reads."""
    unread = PPO if config.optimizer == "trpo" else TRPO
    if config.method not in METHODS:  # behaviour cloning
        return PPO | TRPO | EMPOWERMENT | ADVERSARY | REINFORCEMENT
    config = with_method_defaults(config)
    if config.reward_form != "separable":
        unread |= {"action_part"}
    if config.net != MLP:
        unread |= {"hidden"}
    if config.shaping != EXACT_PHI:
        unread |= {"empowerment_steps"}
    return unread if uses_empowerment(config) else unread | EMPOWERMENT


def refuse_unread(configs: list[Config], overrides: dict[str, Any], reinforcement: bool = False) -> None:
    """Raises `InputError` for an override that none of the configurations reads.

    Args:
      reinforcement: whether policies are trained on a given reward, which reads no setting of a discriminator.
    """
    unread = frozenset.intersection(*(unread_settings(config) for config in configs))
    if reinforcement:
        unread |= EMPOWERMENT | ADVERSARY | {"method", "discriminator_updates", "discriminator_batch"}
    else:
        unread |= TEMPERATURE | TRIALS
    names = sorted(unread & set(overrides))
    if names:
        methods = ", ".join(dict.fromkeys(f"{config.method} with {config.optimizer}" for config in configs))
        reader = "reinforcement learning" if reinforcement else methods
        raise InputError(f"{', '.join(names)}: not a setting of {reader}; leave it out")


def documentation() -> dict[str, str]:
    """What the string below each field of `Config`, `HParams` and `Recipe` says, by the field's name."""
    return {name: text for cls in (Config, HParams, Recipe) for name, text in _field_docstrings(cls).items()}


def _field_docstrings(cls: type) -> dict[str, str]:
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(cls))).body
    body = definition.body if isinstance(definition, ast.ClassDef) else []
    texts = {}
    for field, below in itertools.pairwise(body):
        if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
            texts[field.target.id] = " ".join(str(below.value.value).split())
    return texts
