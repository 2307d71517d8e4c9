"""The folder of a run for which no `--out` was given. Its name holds what was changed: two experiments never clash."""

from __future__ import annotations

import dataclasses
import hashlib
import re
from pathlib import Path
from typing import Any

from eairl_jax import InputError
from eairl_jax.experiments.pipeline import records
from eairl_jax.experiments.pipeline.run_folder import refuse_different
from eairl_jax.experiments.pipeline.train import RUNS

# Options that the names of folders hold already, or that change nothing in the run.
NAMED = frozenset(
    {"task", "source", "target", "method", "reward_form", "rule", "reward", "tuned", "out", "track", "on_nan"}
    | {"more", "more_seeds", "net", "trials", "cluster", "cluster_set", "program"}
    | {"coordinator", "processes", "process"}
)
LONGEST = 80  # characters of what was changed


def default_path(options: Any, name: str, settings: dict) -> Path:
    """`runs/NAME`, followed by the options that differ from their defaults: `runs/NAME-seeds=2-gamma=0.99`.

    Args:
      options: the record of the command.
      name: of the run, without its settings.
      settings: of the run. Where `runs/NAME` itself holds this run, begun by an earlier version, it goes on there.
    """
    plain = RUNS / name
    changed = changed_options(options)
    if not changed or _is_run(plain, settings):
        return plain
    return RUNS / f"{name}-{changed}"


def changed_options(options: Any) -> str:
    """The options that differ from their defaults, as a part of a file name; "" if none does."""
    parts: list[str] = []
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        if field.name in NAMED or value == field.default:
            continue
        if field.name == "set":
            parts += sorted(value)
        elif isinstance(value, tuple):
            parts += [f"{field.name}-{each}" for each in sorted(value)]
        else:
            parts.append(f"{field.name}={value}")
    text = "-".join(parts)
    plain = re.sub(r"[^A-Za-z0-9_.=,+-]+", "_", text)
    if plain == text and len(text) <= LONGEST:
        return text
    return f"{plain[:LONGEST]}-{hashlib.sha256(text.encode(errors='surrogatepass')).hexdigest()[:6]}"


def _is_run(path: Path, settings: dict) -> bool:
    """Whether a folder holds the run of these settings."""
    if not (path / "config.json").is_file():
        return False
    try:
        refuse_different(path, records.settings(path), settings)
    except InputError:
        return False
    return True
