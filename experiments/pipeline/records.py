"""What the files of a run hold, so that a damaged or edited file is refused where it is read."""

from __future__ import annotations

from pathlib import Path

from eairl_jax import InputError, schema
from eairl_jax.schema import Schema
from eairl_jax.storage import read_json

AGAIN = "repeat the command that made the run, with another --out"
MOST_SEEDS = 100_000
MORE_SEEDS = "more-seeds"
"""The folder, in a run's folder, of the seeds that were added to the run."""

_count, _numbers = schema.whole(0, 2**31 - 1), schema.list_of(schema.number(), low=1)
_perhaps = schema.list_of(schema.optional(schema.number()), low=1)
_settings = schema.table_of(schema.anything)
_seed = schema.whole(0, schema.LARGEST_SEED)
SEEDS = schema.either(schema.whole(1, MOST_SEEDS), schema.list_of(_seed, low=1))

SETTINGS = schema.record(
    {},
    {
        "task": schema.text,
        "target": schema.text,
        "seeds": SEEDS,
        "demonstrations": schema.text,
        "config": _settings,
        "hparams": _settings,
        "retrain_config": _settings,
        "retrain_hparams": _settings,
        "snapshot_every": schema.whole(1, 2**31 - 1),
        "retrain_snapshot_every": schema.whole(1, 2**31 - 1),
        "restarts": schema.whole(1, MOST_SEEDS),
        "trials": _count,
        "trial_iterations": _count,
        "random_trials": _count,
        "random_std": schema.number(0.0),
        "rule": schema.record({"kind": schema.text}),
        "sweep": schema.list_of(schema.table_of(schema.number())),
    },
)
MACHINE = schema.record(
    {"date": schema.text, "device": schema.text, "devices": _count, "versions": schema.table_of(schema.text)}
)
_reason = {"training": schema.text, "quantity": schema.text, "iteration": _count, "value": schema.text}
DROPPED_LIST = schema.list_of(schema.record({"seed": _seed, **_reason}))
DROPPED = schema.record({"dropped": DROPPED_LIST})
SECONDS = schema.record({"compile_seconds": schema.number(0.0), "run_seconds": schema.number(0.0)})
LEARNING = schema.record({"imitation_returns": _perhaps})  # null: the seed was dropped
CEILING = schema.record({"returns": _numbers})
EXPERT = schema.record(
    {"returns": _numbers, "returns_mean_action": _numbers, "env_steps": schema.whole(0)},
    {"dropped": DROPPED_LIST, "more_iterations": schema.whole(0, 2**31 - 1)},
)
END = schema.record({}, {"more_iterations": schema.whole(0, 2**31 - 1)})
PLANS = schema.record({"learned_per_step": _perhaps})
WORTH = schema.record(
    {"policies": schema.list_of(_perhaps, low=1), "compared": schema.table_of(_perhaps)},
)
_behaviour = schema.record({"learned": _numbers, "true": _numbers})


def diagnosis(*names: str) -> Schema:
    """A diagnosis that judged at least the behaviours of these names."""
    behaviours = schema.record(dict.fromkeys(names, _behaviour))

    def check(value, place: str):
        judged = schema.table_of(_behaviour)
        content = schema.record({"behaviours": behaviours, "expert": schema.number(), "random": schema.number()})(
            value, place
        )
        lengths = {len(x) for each in judged(content["behaviours"], place).values() for x in each.values()}
        if len(lengths) > 1:
            raise schema.Mismatch(place, content["behaviours"], "as many seeds for every behaviour")
        return content

    return check


def settings(path: Path) -> dict:
    """The settings in the folder of a run.

    Raises:
      InputError: if they are missing or damaged.
    """
    content = read_json(path / "config.json", schema.record({"settings": SETTINGS}), AGAIN)
    return content["settings"]


def needed(content: dict, names: list[str], path: Path) -> list:
    """Members of the settings of the run in a folder.

    Raises:
      InputError: if one of them is missing.
    """
    missing = [name for name in names if name not in content]
    if missing:
        raise InputError(f"{path}/config.json lacks {', '.join(missing)}, as if another version had made it: {AGAIN}")
    return [content[name] for name in names]
