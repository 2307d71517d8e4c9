"""Demonstrations on disk: an `.npz` of whole episodes and a JSON that says where they came from."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from eairl_jax import storage
from eairl_jax.errors import InputError
from eairl_jax.types import Demonstrations


def save(path: Path | str, demos: Demonstrations, provenance: dict) -> None:
    """Writes `path` (`.npz`, float32) and, beside it, its provenance as `.json`.

    Args:
      provenance: has at least "task", the name of the task that was demonstrated.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = {name: np.asarray(x, np.float32) for name, x in demos._asdict().items()}
    storage.write_arrays(path, arrays | {"task": np.asarray(provenance["task"])})
    storage.write_json(path.with_suffix(".json"), provenance)


def load(
    path: Path | str, task: str | None = None, obs_size: int | None = None, action_size: int | None = None
) -> Demonstrations:  # fmt: skip
    """Reads demonstrations and checks everything about them that training would trip over.

    Args:
      path: an `.npz` with `obs [E, T, obs]`, `action [E, T, act]`, `next_obs [E, T, obs]`, `reward [E, T]`,
        `terminated [E, T]` and optionally `task`.
      task, obs_size, action_size: if given, what they must be.

    Raises:
      InputError: if the file is missing or cut short, an array is missing, misshapen, or holds NaN or infinite
        values, or it demonstrates another task.
    """
    arrays = storage.read_arrays(Path(path))
    missing = [name for name in Demonstrations._fields if name not in arrays]
    if missing:
        raise InputError(f"{path} lacks {', '.join(missing)}; demonstrations have {', '.join(Demonstrations._fields)}")
    shown = str(arrays["task"]) if "task" in arrays else None
    if task is not None and shown is not None and shown != task:
        raise InputError(f"{path} demonstrates {shown!r}, not {task!r}: give demonstrations of {task!r}")
    demos = Demonstrations(*(arrays[name] for name in Demonstrations._fields))
    if demos.obs.ndim != 3 or demos.action.ndim != 3 or 0 in demos.obs.shape:
        raise InputError(
            f"{path}: obs has shape {demos.obs.shape} and action {demos.action.shape}; "
            "expected [episodes, steps, size] for both, episodes of one length"
        )
    leading = demos.obs.shape[:2]
    sizes = {"obs": obs_size or demos.obs.shape[2], "action": action_size or demos.action.shape[2]}
    tails = {"obs": (sizes["obs"],), "action": (sizes["action"],), "next_obs": (sizes["obs"],)}
    for name, x in demos._asdict().items():
        if x.dtype.kind not in "biuf":
            raise InputError(f"{path}: {name} holds {x.dtype}, not numbers")
        expected = leading + tails.get(name, ())
        if x.shape != expected:
            raise InputError(f"{path}: {name} has shape {x.shape}, expected {expected}")
        with np.errstate(over="ignore"):
            x = x.astype(np.float32)
        if not np.isfinite(x).all():
            episode, step = np.argwhere(~np.isfinite(x))[0][:2]
            raise InputError(f"{path}: {name} is NaN or infinite at episode {episode}, step {step}: collect it again")
    return Demonstrations(*(np.asarray(x, np.float32) for x in demos))


def fingerprint(demos: Demonstrations) -> str:
    """Twelve characters that tell these episodes from others, wherever they are kept."""
    arrays = (np.ascontiguousarray(x, np.float32) for x in demos)
    return hashlib.sha256(b"".join(f"{x.shape}".encode() + x.tobytes() for x in arrays)).hexdigest()[:12]


def provenance(path: Path | str) -> dict:
    """The JSON beside demonstrations.

    Raises:
      InputError: if it is missing or no JSON.
    """
    return storage.read_json(Path(path).with_suffix(".json"))
