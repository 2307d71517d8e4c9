"""Whether an environment fits: the algorithms need pure JAX functions, and a `step` that never resets."""

from __future__ import annotations

import numbers
from collections.abc import Iterator, Mapping
from typing import Any

from eairl_jax.errors import InputError

# Wrappers whose `step` ends an episode at a time limit, begins the next one, or takes a batch of environments.
RESETTING = frozenset(
    {"EpisodeWrapper", "AutoResetWrapper", "VmapWrapper", "DomainRandomizationVmapWrapper", "EvalWrapper"}
    | {"BraxAutoResetWrapper", "BraxDomainRandomizationVmapWrapper"}
)
WRAPPED = frozenset({"brax", "mujoco_playground"})
PYTHON_ENVIRONMENTS = {
    "gymnasium": "a Gymnasium environment",
    "gym": "a Gym environment",
    "stable_baselines3": "a vector of environments of Stable-Baselines3",
    "dm_env": "an environment of dm_env",
}


def check_env(env: Any) -> None:
    """Refuses an environment in which no policy can be trained.

    Raises:
      InputError: as `check_steps`, or if a size is missing, or if observations are dictionaries.
    """
    check_steps(env)
    name = _name(env)
    missing = [each for each in ("observation_size", "action_size") if not hasattr(env, each)]
    if missing:
        raise InputError(f"{name} has no {', '.join(missing)}: an environment needs both numbers")
    size = env.observation_size
    if isinstance(size, Mapping):
        raise InputError(
            f"{name}: observations are dictionaries of {', '.join(map(str, size))}, expected flat vectors: choose one "
            f'with eairl_jax.envs.adapt(env, obs="{next(iter(size), "")}"), or all with obs="flatten"'
        )
    for attribute, value in (("observation_size", size), ("action_size", env.action_size)):
        if isinstance(value, bool) or not isinstance(value, numbers.Integral) or value < 1:
            raise InputError(
                f"{name}: {attribute} is {value!r}: expected a whole number of at least 1, because eairl_jax needs "
                "flat vectors; flatten them in a wrapper of the environment"
            )


def check_steps(env: Any) -> None:
    """Refuses an environment whose steps are not what a rollout needs.

    Raises:
      InputError: if the environment has discrete actions, if it computes outside of JAX, if a wrapper resets it inside
        `step`, or if a function is missing. The message says which call makes it fit.
    """
    name = _name(env)
    if _is_discrete(env):
        raise InputError(f"{name} has discrete actions: eairl_jax learns with continuous actions only")
    for package in _packages(env):
        if package in PYTHON_ENVIRONMENTS:
            raise InputError(
                f"{name} is {PYTHON_ENVIRONMENTS[package]}, which computes outside of JAX: use an environment whose "
                'reset and step are JAX functions, e.g. eairl_jax.envs.make("brax:hopper") or a class of yours '
                "(docs/your-task.md)"
            )
        if package == "mujoco_playground":
            raise InputError(
                f"{name} is an environment of MuJoCo Playground: make it with "
                'eairl_jax.envs.make("playground:NAME"), or adapt it with eairl_jax.envs.adapt(env)'
            )
    for wrapper in _chain(env):
        if type(wrapper).__name__ in RESETTING and WRAPPED & set(_packages(wrapper)):
            raise InputError(
                f"{type(wrapper).__name__} around {type(_innermost(env)).__name__} turns the time limit into an end of "
                "the task, or resets inside step: use brax.envs.get_environment(...), or env.unwrapped"
            )
    missing = [function for function in ("reset", "step") if not callable(getattr(env, function, None))]
    if missing:
        raise InputError(
            f"{name} has no function {', '.join(missing)}: an environment needs reset(rng) and step(state, action), "
            "which JAX can trace"
        )


def context_size(env: Any) -> int:
    """How many entries at the end of an observation say which of several tasks it is of; 0 for a single task."""
    return getattr(env, "context_size", 0)


def _name(env: Any) -> str:
    return f"{type(env).__module__.partition('.')[0]}.{type(env).__qualname__}"


def _packages(env: Any) -> Iterator[str]:
    """The packages of an object's class and of the classes that it inherits from."""
    return (cls.__module__.partition(".")[0] for cls in type(env).__mro__)


def _chain(env: Any) -> Iterator[Any]:
    """An environment and those that it wraps, from the outside in."""
    seen: list[Any] = []
    while env is not None and not any(env is each for each in seen):
        yield env
        seen.append(env)
        env = vars(env).get("env") if hasattr(env, "__dict__") else None


def _innermost(env: Any) -> Any:
    return list(_chain(env))[-1]


def _is_discrete(env: Any) -> bool:
    """Whether an environment declares a discrete space of actions, as Gymnasium's or gymnax's do."""
    try:
        space = getattr(env, "action_space", None)
    except Exception:  # a property that fails declares nothing
        space = None
    return "Discrete" in type(space).__name__ or (hasattr(type(env), "num_actions") and not hasattr(env, "action_size"))
