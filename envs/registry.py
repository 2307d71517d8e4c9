"""Tasks by name: those of this package, of brax, of MuJoCo Playground, and a user's own.

A new task of this package is a file in this folder and an entry in `TASKS`.
"""

from __future__ import annotations

import difflib
import hashlib
import importlib
import importlib.util
import inspect
import sys
import warnings
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

from eairl_jax.envs import foreign, names
from eairl_jax.envs.ant import Ant
from eairl_jax.envs.half_cheetah import HalfCheetah
from eairl_jax.envs.mjx_task import MjxTask, Task, TaskError
from eairl_jax.envs.names import TaskName
from eairl_jax.envs.pendulum import Pendulum
from eairl_jax.envs.point_maze import PointMaze
from eairl_jax.envs.several import SeveralTasks
from eairl_jax.envs.swimmer import Swimmer

TASKS: MappingProxyType[str, Callable[..., MjxTask]] = MappingProxyType(
    {
        "pendulum": Pendulum,
        "point_maze_left": partial(PointMaze, passage="left"),
        "point_maze_right": partial(PointMaze, passage="right"),
        "point_maze_middle": partial(PointMaze, passage="middle"),
        "point_maze_double": partial(PointMaze, passage="double"),
        "ant": Ant,
        "crippled_ant": partial(Ant, crippled=("back_leg", "right_back_leg")),
        "half_cheetah": HalfCheetah,
        "swimmer": Swimmer,
    }
)
# Arguments that every environment from elsewhere takes: they belong to the adapter.
ADAPTER = ("episode_length", "obs")


class UnknownTask(TaskError):
    """Raised for a name of no task; the message lists the nearest names and says how tasks are named."""


def make(name: str, **settings) -> Task:
    """Builds a task by name, or several tasks as one (`several.SeveralTasks`) by their names with `+` between them.

    Args:
      name: one of `TASKS`, `brax:NAME`, `playground:NAME`, `FILE.py:FUNCTION` or `MODULE:FUNCTION`, with arguments
        after a `?` (see `names`). A file or a module is the user's code, and is run; its function
        returns an environment. A path is seen from the current folder.
      **settings: more arguments, for example `fidelity="exact"`. They come before those of the name.

    Raises:
      UnknownTask: if no task has this name.
      TaskError: if the task has no such argument, or refuses the value of an argument, or cannot be made.
    """
    if len(parts := each_of(name)) > 1:
        return SeveralTasks([make(part, **settings) for part in parts])
    parsed = names.parse(name)
    parsed = parsed._replace(arguments=parsed.arguments | settings)
    return MAKERS[parsed.origin](parsed)


def each_of(name: str) -> list[str]:
    """The names of the tasks in `TASK+TASK`; a list of the name itself if it names one task.

    A `+` may also belong to an argument or to a path. It stands between tasks if what is on each side names a task.
    """
    parts = str(name).split("+")
    if all(part and (part in TASKS or ":" in part or part.partition("?")[0] in TASKS) for part in parts):
        return parts
    return [str(name)]


def brax_names() -> list[str]:
    """The names of the environments that are registered in brax."""
    return sorted(_brax()._envs)


def playground_names() -> list[str]:
    """The names of the environments of MuJoCo Playground; none if it is not installed."""
    if importlib.util.find_spec("mujoco_playground") is None:
        return []
    return sorted(_playground("").ALL_ENVS)


def _own(name: TaskName) -> Task:
    if name.name not in TASKS:
        known = [*TASKS, *(f"{names.BRAX}:{each}" for each in brax_names())]
        nearest = difflib.get_close_matches(name.name, known, n=3, cutoff=0.3) or list(TASKS)
        raise UnknownTask(
            f"unknown task {name.name!r}; did you mean {', '.join(nearest)}? All tasks: {', '.join(TASKS)}; others are "
            "named brax:NAME, playground:NAME or FILE.py:FUNCTION (`eairl tasks` lists them)"
        )
    factory = TASKS[name.name]
    return _call(name.name, factory, name.arguments, list(inspect.signature(factory).parameters))


def _from_brax(name: TaskName) -> Task:
    envs = _brax()
    if name.name not in envs._envs:
        raise _unknown(names.BRAX, name.name, brax_names())
    factory = envs._envs[name.name]
    parameters = [*(_parameters(factory) or []), *(_parameters(envs.PipelineEnv) or [])]
    accepted = [each for each in dict.fromkeys(parameters) if each not in ("self", "sys")]
    return _adapted(f"{names.BRAX}:{name.name}", factory, name.arguments, accepted)


def _from_playground(name: TaskName) -> Task:
    registry, shown = _playground(name.name), f"{names.PLAYGROUND}:{name.name}"
    if name.name not in registry.ALL_ENVS:
        raise _unknown(names.PLAYGROUND, name.name, registry.ALL_ENVS)
    config = registry.get_default_config(name.name)
    accepted = list(_flat(config.to_dict()))
    # The default is warp, on which `adapt` could not reset environments one by one.
    defaults = {"impl": "jax"} if "impl" in accepted else {}

    def factory(**overrides: Any) -> Any:
        config.update_from_flattened_dict(defaults | overrides)
        if config.get("impl") == "warp":
            raise TaskError(
                f"{shown}: impl=warp has states that cannot be reset one by one inside a rollout: leave impl out "
                "(the default is jax)"
            )
        if config.get("action_repeat", 1) != 1:
            raise TaskError(
                f"{shown}: its action_repeat is {config.action_repeat}, and a step here is one action: add "
                "?action_repeat=1"
            )
        return registry.load(name.name, config=config)

    if "episode_length" not in accepted:
        return _adapted(shown, factory, name.arguments, accepted)
    # The configuration has the episode length, so that an environment that reads it sees it too.
    arguments = dict(name.arguments)
    obs = arguments.pop("obs", None)
    return _task(shown, lambda: foreign.adapt(_call(shown, factory, arguments, [*accepted, "obs"]), obs=obs))


def _from_code(name: TaskName) -> Task:
    factory = user_object(name, callable, "function")
    return _adapted(f"{name.place}:{name.name}", factory, name.arguments, _parameters(factory))


def user_object(name: TaskName, fits: Callable[[Any], bool], kind: str) -> Any:
    """What a name of a user's code stands for: `FILE.py:NAME` or `MODULE:NAME`.

    Args:
      fits: whether an object is of the kind.
      kind: what is expected, for the error message.

    Raises:
      TaskError: if the code cannot be loaded, or holds no such object of the kind.
    """
    module = _load_file(Path(name.place)) if name.origin == names.FILE else _load_module(name.place)
    found = getattr(module, name.name, None)
    if not fits(found):
        others = [key for key, value in vars(module).items() if fits(value)]
        nearest = difflib.get_close_matches(name.name, others, n=3, cutoff=0.3)
        hint = f"; did you mean {', '.join(nearest)}?" if nearest else ""
        raise UnknownTask(f"{name.place} has no {kind} {name.name}{hint}")
    return found


MAKERS: MappingProxyType[str, Callable[[TaskName], Task]] = MappingProxyType(
    {
        names.OWN: _own,
        names.BRAX: _from_brax,
        names.PLAYGROUND: _from_playground,
        names.FILE: _from_code,
        names.MODULE: _from_code,
    }
)


def _adapted(shown: str, factory: Callable, arguments: dict[str, Any], accepted: list[str] | None) -> Task:
    """The environment that `factory` makes, as a task; those of `ADAPTER` that it does not take go to the adapter."""
    mine = {key: value for key, value in arguments.items() if key in ADAPTER and key not in (accepted or [])}
    rest = {key: value for key, value in arguments.items() if key not in mine}
    known = None if accepted is None else [*accepted, *(key for key in ADAPTER if key not in accepted)]
    env = _call(shown, factory, rest, known)
    return _task(shown, lambda: foreign.adapt(env, **mine))


def _task(shown: str, make_task: Callable[[], Task]) -> Task:
    """The task, its steps checked; messages begin with its name."""
    try:
        task = make_task()
        if isinstance(task, foreign.ForeignTask):
            task.check_steps()
    except foreign.UnfitEnvironment as e:
        raise foreign.UnfitEnvironment(e.env, f"{shown}: {e}") from e.__cause__
    return task


def _call(shown: str, factory: Callable, arguments: dict[str, Any], accepted: list[str] | None) -> Any:
    """What `factory` returns for the arguments; `accepted` names those that there are, None if any will do."""
    unknown = sorted(set(arguments) - set(accepted)) if accepted is not None else []
    if unknown:
        choices = f"the settings of {shown} are {', '.join(accepted)}" if accepted else f"{shown} has no settings"
        nearest = difflib.get_close_matches(unknown[0], accepted or [], n=3)
        hint = f"did you mean {', '.join(nearest)}? " if nearest else ""
        raise TaskError(f"unknown setting of task {shown}: {', '.join(unknown)}; {hint}{choices}")
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Brax System", UserWarning)  # says that brax is not developed any more
            return factory(**arguments)
    except TaskError:
        raise
    except (Exception, SystemExit) as e:  # whatever the environment raises
        shown_arguments = ", ".join(f"{key}={value!r}" for key, value in arguments.items())
        given = f" with {shown_arguments}" if arguments else ""
        raise TaskError(f"{shown} cannot be made{given}: {foreign.where(e)}") from e


def _parameters(factory: Callable) -> list[str] | None:
    """The names of a function's parameters; None if it takes any."""
    try:
        parameters = inspect.signature(factory).parameters.values()
    except (TypeError, ValueError):  # some compiled functions do not say
        return None
    package = str(getattr(factory, "__module__", "")).partition(".")[0]
    if package != "brax" and any(p.kind is p.VAR_KEYWORD for p in parameters):
        return None
    return [p.name for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]


def _unknown(origin: str, name: str, known: Iterable[str]) -> UnknownTask:
    nearest = difflib.get_close_matches(name, list(known), n=3, cutoff=0.4)
    hint = f"; did you mean {', '.join(f'{origin}:{each}' for each in nearest)}?" if nearest else "."
    return UnknownTask(f"unknown task '{origin}:{name}'{hint} All of {origin}: {', '.join(sorted(known))}")


def _brax() -> Any:
    return importlib.import_module("brax.envs")


def _playground(name: str) -> Any:
    try:
        return importlib.import_module("mujoco_playground").registry
    except ImportError as e:
        raise TaskError(
            f'{names.PLAYGROUND}:{name} needs MuJoCo Playground: pip install "eairl-jax[playground]" ({e})'
        ) from None


def _flat(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """A nested dictionary as one whose names are paths, `reward.scale`."""
    flat = {}
    for key, value in tree.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return flat


def _load_module(place: str) -> ModuleType:
    try:
        return importlib.import_module(place)
    except (Exception, SystemExit) as e:  # whatever the module raises
        if isinstance(e, ModuleNotFoundError) and e.name and (place == e.name or place.startswith(f"{e.name}.")):
            raise UnknownTask(
                f"{place}:...: no module {e.name} is installed; a file is named by its path, e.g. "
                "my_tasks.py:make_env, and other tasks by brax:NAME or playground:NAME"
            ) from None
        raise TaskError(f"{place} cannot be imported: {foreign.where(e)}") from e


def _existing(path: Path) -> Path | None:
    """The whole path of a file; None if there is no such file."""
    try:
        full = path.resolve(strict=True)
        return full if full.is_file() else None
    except (OSError, ValueError, RuntimeError):
        return None


def _load_file(path: Path) -> ModuleType:
    """The module of a file, loaded by its path. The folder of the file does not come onto Python's path."""
    full = _existing(path)
    if full is None:
        raise UnknownTask(
            f"no file {path} in {Path.cwd()}: the path is seen from the current folder; run the command in the "
            "folder in which the path is right, or give the whole path"
        )
    # Under a name of its own, which classes of the file need; a file is run again when it has changed.
    digest = hashlib.sha256(str(full).encode() + full.read_bytes()).hexdigest()[:12]
    name = f"{foreign.LOADED}{digest}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, full)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as e:  # whatever the file raises
        del sys.modules[name]
        raise TaskError(f"{path} cannot be loaded: {foreign.where(e)}") from e
    return module
