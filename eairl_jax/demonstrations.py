"""Demonstrations on disk: an `.npz` of whole episodes, and a JSON with their origin."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from eairl_jax import storage
from eairl_jax.errors import InputError
from eairl_jax.types import Demonstrations


def save(path: Path | str, demos: Demonstrations, provenance: dict) -> None:
    """Writes demonstrations to `path` (`.npz`, float32) and their provenance to a `.json` beside it.

    Args:
      path: the `.npz` file; its folder is created.
      demos: whole episodes of one length.
      provenance: has at least "task", the name of the demonstrated task.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = {name: np.asarray(x, np.float32) for name, x in demos._asdict().items()}
    storage.write_arrays(path, arrays | {"task": np.asarray(provenance["task"])})
    storage.write_json(path.with_suffix(".json"), provenance)


def load(
    path: Path | str, task: str | None = None, obs_size: int | None = None, action_size: int | None = None
) -> Demonstrations:
    """Reads demonstrations and checks that an algorithm can learn from them.

    Args:
      path: an `.npz` with `obs [E, T, obs]`, `action [E, T, act]`, `next_obs [E, T, obs]`, `reward [E, T]`,
        `terminated [E, T]` and, optionally, `task`.
      task: the expected task, if not None.
      obs_size: the expected length of an observation, if not None.
      action_size: the expected length of an action, if not None.

    Raises:
      InputError: if the file does not exist or is cut short, if an array is missing, has a wrong shape, or holds NaN or
        infinite values, or if the demonstrated task is another task.
    """
    arrays = storage.read_arrays(Path(path))
    missing = [name for name in Demonstrations._fields if name not in arrays]
    if missing:
        raise InputError(f"{path} lacks {', '.join(missing)}: expected the arrays {', '.join(Demonstrations._fields)}")
    demonstrated = str(arrays["task"]) if "task" in arrays else None
    if task is not None and demonstrated is not None and demonstrated != task:
        raise InputError(f"{path} demonstrates {demonstrated!r}, not {task!r}: use demonstrations of {task!r}")
    demos = Demonstrations(*(arrays[name] for name in Demonstrations._fields))
    if demos.obs.ndim != 3 or demos.action.ndim != 3 or 0 in demos.obs.shape:
        raise InputError(
            f"{path}: obs has shape {demos.obs.shape} and action {demos.action.shape}; expected "
            "[episodes, steps, size] for both, with all episodes of one length"
        )
    obs_size, action_size = obs_size or demos.obs.shape[2], action_size or demos.action.shape[2]
    sizes = {"obs": (obs_size,), "action": (action_size,), "next_obs": (obs_size,)}
    return Demonstrations(
        *(_checked(path, name, x, demos.obs.shape[:2] + sizes.get(name, ())) for name, x in demos._asdict().items())
    )


def _checked(path: Path | str, name: str, x: np.ndarray, expected: tuple[int, ...]) -> np.ndarray:
    """The array as float32; `InputError` if it has another shape, or holds anything except finite numbers."""
    if x.dtype.kind not in "biuf":
        raise InputError(f"{path}: {name} has dtype {x.dtype}; expected numbers")
    if x.shape != expected:
        raise InputError(f"{path}: {name} has shape {x.shape}, expected {expected}")
    with np.errstate(over="ignore"):
        x = x.astype(np.float32)
    if not np.isfinite(x).all():
        episode, step = np.argwhere(~np.isfinite(x))[0][:2]
        raise InputError(
            f"{path}: {name} is NaN or infinite at episode {episode}, step {step}: remove this episode, or collect "
            "the demonstrations again"
        )
    return x


def fingerprint(demos: Demonstrations) -> str:
    """Twelve hexadecimal digits that depend on the shapes and values of the arrays, and not on their file."""
    return storage.digest(("", np.ascontiguousarray(x, np.float32)) for x in demos)


def provenance(path: Path | str) -> dict:
    """The content of the JSON beside demonstrations.

    Raises:
      InputError: if the file does not exist or is not a JSON object.
    """
    return storage.read_json(Path(path).with_suffix(".json"))
