"""Environments from elsewhere as tasks: those of brax, of MuJoCo Playground, and a user's own.

An environment is any object with `reset(rng) -> state`, `step(state, action) -> state`, `observation_size` and
`action_size`, whose functions JAX can trace. A state has the fields `obs`, `reward` and `done`.
"""

from __future__ import annotations

import inspect
import math
import numbers
import traceback
from collections.abc import Callable, Mapping
from operator import attrgetter
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from eairl_jax.envs.mjx_task import Camera, Task
from eairl_jax.envs.names import TaskError

EPISODE_LENGTH = 1000
"""Steps of an episode where an environment says nothing: brax's convention."""
FLATTEN = "flatten"
"""`obs=flatten`: all entries of a dictionary, in the order of their sorted names."""
LOADED = "eairl_jax_task_"
"""How the names begin of modules that `registry` loads from a user's file."""
NEEDED = ("reset", "step", "observation_size", "action_size")
# Where an environment holds its MuJoCo model, and where its state holds the model's positions.
MODELS = ("model", "mj_model", "sys.mj_model")
POSITIONS = ("pipeline_state.qpos", "pipeline_state.q", "data.qpos", "qpos")


class UnfitEnvironment(TaskError):
    """Raised for an object that is no environment as this package uses it.

    Attributes:
      env: that object.
    """

    def __init__(self, env: Any, message: str):
        super().__init__(message)
        self.env = env


@struct.dataclass
class ForeignState:
    """A state of a `ForeignTask`.

    Attributes:
      inner: the environment's own state.
      obs: `[obs]`, a flat vector.
      reward: `[]`.
      done: `[]` 1 where the environment ended the episode.
    """

    inner: Any
    obs: jax.Array
    reward: jax.Array
    done: jax.Array


class ForeignTask(Task):
    """An environment from elsewhere, with everything that the commands ask of a task.

    The environment's optional attributes are used: `episode_length`, `action_limit`, `ends`, `camera`, `dt`,
    `obs_mean`, `obs_std`, a MuJoCo model (`model`, `mj_model` or `sys.mj_model`) and `qpos(state)`.

    Args:
      env: the environment.
      episode_length: steps of an episode; by default the environment's own, or 1000.
      obs: of an environment whose observations are dictionaries, the entry to observe, or "flatten".

    Raises:
      TaskError: for an environment that does not fit, or an impossible setting.
    """

    def __init__(self, env: Any, episode_length: int | None = None, obs: str | None = None):
        missing = [name for name in NEEDED if not _declares(env, name)]
        if missing:
            raise UnfitEnvironment(
                env,
                f"{_kind(env)} has no {', '.join(missing)}: an environment needs the functions reset(rng) and "
                "step(state, action), which JAX can trace, and the numbers observation_size and action_size",
            )
        self.env = env
        # A compiled function is traced once for all programs of a process. (The environment need not be hashable.)
        self._env_reset = jax.jit(lambda rng: env.reset(rng))
        self._env_step = jax.jit(lambda state, action: env.step(state, action))
        self._action_size = _size(env, "action_size", env.action_size)
        start = self._traced("reset(rng)", self._env_reset, jax.random.PRNGKey(0))
        self._read = _reader(env, start.obs, obs or _default_obs(env, start.obs))
        self._observation_size = self._flat_size(start)
        self.episode_length = _episode_length(env, episode_length)
        self.action_limit = _action_limit(env)
        self.ends = bool(getattr(env, "ends", True))
        self.model = _model(env)
        self.camera = getattr(env, "camera", None) or _camera(self.model)
        for name in ("obs_mean", "obs_std"):
            if _declares(env, name) and obs is None:
                setattr(self, name, self._scale(name))

    def reset(self, rng: jax.Array) -> ForeignState:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Starts an episode."""
        return self._wrap(self._env_reset(rng))

    def step(self, state: ForeignState, action: jax.Array) -> ForeignState:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Takes a step of the environment."""
        return self._wrap(self._env_step(state.inner, action))

    def qpos(self, state: ForeignState) -> jax.Array | None:
        """The positions `[nq]` of the model: the environment's `qpos(state)`, or those in its physics state."""
        if callable(getattr(self.env, "qpos", None)):
            return self.env.qpos(state.inner)
        return next((value for path in POSITIONS if (value := _at(state.inner, path)) is not None), None)

    @property
    def observation_size(self) -> int:
        return self._observation_size

    @property
    def action_size(self) -> int:
        return self._action_size

    @property
    def backend(self) -> str:
        return str(getattr(self.env, "backend", ""))

    @property
    def dt(self) -> float | None:
        """Seconds between two observations; None if the environment does not say."""
        dt = getattr(self.env, "dt", None)
        return None if dt is None else float(dt)

    def check_steps(self) -> None:
        """Traces a step, and compares its state with that of a reset.

        Raises:
          TaskError: if a step cannot be traced, or if its state differs in the shape or dtype of an entry. A training
            is a loop in one program, which needs them alike.
        """
        start = self._traced("reset(rng)", self._env_reset, jax.random.PRNGKey(0))
        action = jax.ShapeDtypeStruct((self.action_size,), jnp.float32)
        after = self._traced("step(state, action)", self._env_step, start, action)
        _refuse_other_states(self.env, start, after)
        for state in (start, after):
            for name in ("reward", "done"):
                if jnp.shape(getattr(state, name)) != ():
                    shape = jnp.shape(getattr(state, name))
                    raise UnfitEnvironment(
                        self.env, f"{_kind(self.env)}: {name} has shape {shape}, expected (), one number"
                    )

    def _wrap(self, state: Any) -> ForeignState:
        obs, reward, done = (jnp.asarray(x, jnp.float32) for x in (self._read(state.obs), state.reward, state.done))
        return ForeignState(state, obs, reward, done)

    def _traced(self, what: str, function: Callable, *arguments: Any) -> Any:
        """The shapes that a function of the environment returns."""
        try:
            state = jax.eval_shape(function, *arguments)
        except Exception as e:  # whatever the environment raises
            raise UnfitEnvironment(
                self.env,
                f"{_kind(self.env)}: {what} failed ({where(e)}): expected a pure function of one environment, which "
                "JAX can trace",
            ) from e
        missing = [name for name in ("obs", "reward", "done") if not hasattr(state, name)]
        if missing:
            raise UnfitEnvironment(
                self.env,
                f"{_kind(self.env)}: {what} returns {_kind(state)} without {', '.join(missing)}: expected a state with "
                "the fields obs, reward and done",
            )
        return state

    def _flat_size(self, start: Any) -> int:
        """The length of an observation; it must be what the environment declares, if that is a number."""
        shape = jax.eval_shape(self._read, start.obs).shape
        if len(shape) != 1 or shape[0] < 1:
            raise UnfitEnvironment(
                self.env, f"{_kind(self.env)}: an observation has shape {shape}: expected a flat vector"
            )
        if not isinstance(start.obs, Mapping) and not _computes_size(self.env):
            declared = self.env.observation_size
            if declared != shape[0]:
                raise UnfitEnvironment(
                    self.env,
                    f"{_kind(self.env)}: observation_size is {declared}, but reset observes {shape[0]} numbers",
                )
        return shape[0]

    def _scale(self, name: str) -> tuple[float, ...]:
        try:
            values = np.asarray(getattr(self.env, name), float)
        except (TypeError, ValueError):
            values = np.zeros(0)
        is_positive = name == "obs_mean" or (values > 0).all()
        if values.shape != (self.observation_size,) or not np.isfinite(values).all() or not is_positive:
            kind = "numbers" if name == "obs_mean" else "positive numbers"
            raise TaskError(f"{_kind(self.env)}: {name} is not {self.observation_size} finite {kind}")
        return tuple(values.tolist())


def adapt(env: Any, episode_length: int | None = None, obs: str | None = None) -> Task:
    """Makes a task of an environment: of brax, of MuJoCo Playground, or of a user.

    Args:
      env: the environment. A `Task` is returned as it is.
      episode_length: steps of an episode; by default the environment's own, or 1000.
      obs: of an environment whose observations are dictionaries, the entry to observe, or "flatten" for all of them.
        The default is "state" for Playground.

    Raises:
      TaskError: for an environment that does not fit. The message says what was expected.
    """
    if isinstance(env, Task):
        if obs is not None:
            raise TaskError(f"{_kind(env)}: obs={obs} chooses from observations that are dictionaries; leave it out")
        if episode_length is not None:
            env.episode_length = _episode_length(env, episode_length)
        return env
    if is_playground(env):
        _refuse_warp(env)
    return ForeignTask(env, episode_length, obs)


def is_playground(env: Any) -> bool:
    """Whether an object is an environment of MuJoCo Playground."""
    return any(cls.__module__.startswith("mujoco_playground.") for cls in type(env).__mro__)


def _refuse_warp(env: Any) -> None:
    if str(getattr(env, "_config", {}).get("impl", "jax")) == "warp":
        raise UnfitEnvironment(
            env,
            f"{_kind(env)}: impl is warp, whose states cannot be reset one by one inside a rollout: make the "
            "environment with impl=jax",
        )


def where(error: BaseException) -> str:
    """An error in one line, with the last place in the user's code that it came through."""
    ours = str(Path(__file__).parent)
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if "site-packages" not in frame.filename and not frame.filename.startswith((ours, "<"))
    ]
    place = f" at {frames[-1].filename}:{frames[-1].lineno}" if frames else ""
    first_line = next(iter(str(error).splitlines()), "")
    return f"{type(error).__name__}{place}: {first_line}".rstrip(": ")


def _declares(env: Any, name: str) -> bool:
    """Whether an environment has an attribute. A property is not computed: brax computes a whole reset for a size."""
    return inspect.getattr_static(env, name, None) is not None or hasattr(env, name)


def _computes_size(env: Any) -> bool:
    """Whether `observation_size` is the property of brax or Playground, which is what a reset observes."""
    owner = next((cls for cls in type(env).__mro__ if "observation_size" in vars(cls)), None)
    return owner is not None and owner.__module__.partition(".")[0] in ("brax", "mujoco_playground")


def _default_obs(env: Any, obs: Any) -> str | None:
    """The entry of a dictionary that is observed if none is chosen."""
    return "state" if is_playground(env) and isinstance(obs, Mapping) and "state" in obs else None


def _kind(thing: Any) -> str:
    """`package.Class` of an object, for a message."""
    cls = type(thing)
    package = cls.__module__.partition(".")[0]
    return cls.__qualname__ if package.startswith(LOADED) else f"{package}.{cls.__qualname__}"


def _at(thing: Any, path: str) -> Any:
    """The value of nested attributes, or None."""
    try:
        return attrgetter(path)(thing)
    except AttributeError:
        return None


def _size(env: Any, name: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) or value < 1:
        raise UnfitEnvironment(env, f"{_kind(env)}: {name} is {value!r}, expected a whole number of at least 1")
    return int(value)


def _episode_length(env: Any, given: Any) -> int:
    own = getattr(env, "episode_length", None)
    if own is None and is_playground(env):
        own = env._config.get("episode_length")
    length = given if given is not None else EPISODE_LENGTH if own is None else own
    if isinstance(length, bool) or not isinstance(length, numbers.Integral) or length < 1:
        raise TaskError(f"episode_length is {length!r}: expected a whole number of at least 1 step")
    return int(length)


def _action_limit(env: Any) -> float:
    limit = getattr(env, "action_limit", 1.0)
    if isinstance(limit, bool) or not isinstance(limit, numbers.Real) or not 0 < float(limit) < math.inf:
        raise TaskError(
            f"{_kind(env)}: action_limit is {limit!r}, expected one positive number L: actions arrive in [-L, L]"
        )
    return float(limit)


def _model(env: Any) -> mujoco.MjModel | None:
    found = (_at(env, path) for path in MODELS)
    return next((model for model in found if isinstance(model, mujoco.MjModel)), None)


def _camera(model: mujoco.MjModel | None) -> Camera:
    """A view from the side that shows the whole model; it moves with the first body."""
    if model is None:
        return Task.camera
    return Camera(azimuth=90.0, elevation=-20.0, distance=2.0 * float(model.stat.extent), follows=model.nbody > 1)


def _reader(env: Any, obs: Any, chosen: str | None) -> Callable[[Any], jax.Array]:
    """The function that takes the vector `[obs]` from what the environment observes."""
    if not isinstance(obs, Mapping):
        if chosen is not None:
            raise TaskError(f"{_kind(env)}: obs={chosen} chooses from observations that are dictionaries; leave it out")
        if not hasattr(obs, "shape"):
            raise UnfitEnvironment(env, f"{_kind(env)}: an observation is {_kind(obs)}: expected a flat vector")
        return lambda value: value
    names = sorted(obs)
    if chosen == FLATTEN:
        return lambda value: jnp.concatenate(
            [jnp.ravel(leaf) for name in names for leaf in jax.tree.leaves(value[name])]
        )
    if chosen not in names:
        given = f"obs={chosen} is none of them" if chosen else "none is chosen"
        raise UnfitEnvironment(
            env,
            f"{_kind(env)}: observations are dictionaries of {', '.join(names)}, and {given}: choose one, "
            f"?obs={names[0]}, or all of them, ?obs={FLATTEN}",
        )
    return lambda value: value[chosen]


def _refuse_other_states(env: Any, start: Any, after: Any) -> None:
    """Raises `UnfitEnvironment` unless two states have one structure, and entries of the same shapes and dtypes."""
    (first, structure), (second, other) = (jax.tree_util.tree_flatten_with_path(state) for state in (start, after))
    if structure != other:
        raise UnfitEnvironment(
            env, f"{_kind(env)}: the states of reset and step have other entries: expected the same entries in both"
        )
    for (path, x), (_, y) in zip(first, second, strict=True):
        name = jax.tree_util.keystr(path)
        if jnp.issubdtype(x.dtype, jax.dtypes.prng_key):
            raise UnfitEnvironment(
                env,
                f"{_kind(env)}: {name} of its state is a key of jax.random.key, which cannot be saved: use "
                "jax.random.PRNGKey and jax.random.split of the rng of reset",
            )
        if (x.shape, x.dtype) != (y.shape, y.dtype):
            raise UnfitEnvironment(
                env,
                f"{_kind(env)}: {name} of its state is {x.dtype}{list(x.shape)} after reset and "
                f"{y.dtype}{list(y.shape)} after step: expected the same dtype and shape",
            )
