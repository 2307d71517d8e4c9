"""Results on disk, their order, and the names and colours by which tables and figures show them."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from pathlib import Path

import filelock

from eairl_jax import InputError, schema
from eairl_jax.experiments.pipeline import records
from eairl_jax.experiments.pipeline.diagnosis import Diagnosis
from eairl_jax.experiments.pipeline.run import Result
from eairl_jax.storage import check, read_json, write_json

_SHIPPED = Path(__file__).resolve().parents[1] / "results"
FOLDER = _SHIPPED if _SHIPPED.is_dir() else Path("runs") / "results"
"""Where results are read and written by default: in the checkout or, where the package is installed, in `runs/`."""

# Names in the order in which everything is listed.
NAMES = {
    "bc": "behaviour cloning",
    "gail-sa": "GAIL",
    "gan_gcl-sa": "GAN-GCL",
    "airl_s-s": "AIRL(s)",
    "airl_sa-sa": "AIRL(s,a)",
    "eairl-sa": "EAIRL",
    "eairl_release-sa": "EAIRL (release)",
    "airl_sa-separable": "AIRL, separable",
    "eairl-separable": "EAIRL, separable",
    "eairl-s": "EAIRL(s)",
}
# The same colour in every figure.
COLORS = {
    "eairl-sa": "C0",
    "airl_s-s": "C1",
    "eairl-separable": "C2",
    "airl_sa-sa": "C3",
    "airl_sa-separable": "C4",
    "eairl_release-sa": "C5",
    "gan_gcl-sa": "C6",
    "bc": "C7",
    "gail-sa": "C8",
    "eairl-s": "C9",
}
MEASURES = ("epic", *(f"rank correlation, {steps}" for steps in ("expert", "policy", "random")))
"""How close a learned reward is to the true one."""
WORTH = ("random", "expert", "retrained")
"""Whose steps are compared by their mean learned reward."""
RETRAIN = "+retrain_"
"""Stands in a result's name before a setting of retraining that differs from the recipe."""


def load(path: Path) -> list[Result]:
    """Reads a file of results; an empty list if the file does not exist.

    Raises:
      InputError: if the file holds no results, or a field of one is missing.
    """
    content = read_json(path) if path.exists() else {"rows": []}
    advice = "give the folder that `eairl reproduce` wrote"
    if not isinstance(content.get("rows"), list):
        raise InputError(f"{path} holds no results of `eairl reproduce`: {advice}")
    loaded = []
    for number, row in enumerate(content["rows"]):
        where = f"result {number} of {path}"
        row = check(row, schema.table_of(schema.anything), where, advice)
        loaded.append(Result.from_json(row, where))
        check(row, _row(), where, advice)
        if loaded[-1].diagnosis is not None:
            Diagnosis.from_json(loaded[-1].diagnosis, where)  # refuses a damaged one
    return loaded


@functools.cache
def _row() -> schema.Schema:
    """What tables and the report read of a result, beside the types of its fields."""
    counts = dict.fromkeys(("iterations", "num_envs", "rollout_length"), schema.whole(1))
    floats = dict.fromkeys(("entropy_weight", "lambda_i"), schema.number())
    settings = schema.record({"config": schema.record(counts), "hparams": schema.record(floats)})
    measures = dict.fromkeys((*MEASURES, *(f"worth, {who}" for who in WORTH)), schema.anything)
    closeness = schema.optional(schema.record({"source": schema.anything, "target": schema.record(measures)}))
    versions = schema.record({"versions": schema.record({"jax": schema.text})})
    return schema.record(
        {
            "expert": schema.number(),
            "settings": settings,
            "machine": lambda value, place: versions(records.MACHINE(value, place), place),
        },
        {"closeness": closeness},
    )


def add(path: Path, result: Result) -> None:
    """Puts a result into a file. It replaces a result of the same identity, and otherwise comes last."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # The lock keeps two processes from losing each other's result.
    with filelock.FileLock(path.with_suffix(".lock")):
        by_identity = {each.identity: each for each in (*load(path), result)}
        write_json(path, {"rows": [each.to_json() for each in by_identity.values()]})


def title(name: str) -> str:
    """How tables and figures call a result: "EAIRL, lambda_i=0" for the name "eairl-sa+lambda_i=0"."""
    method, *variant = name.split("+")
    return ", ".join([NAMES.get(method, method), *variant])


def color(name: str) -> str:
    """The colour of a method with its reward form; variants share it."""
    return COLORS.get(name.split("+")[0], "black")


def names_in_order(results: Iterable[Result]) -> list[str]:
    """The names of results, each once, in the order of `NAMES`."""
    return sorted({result.name for result in results}, key=_place)


def in_order(results: Iterable[Result]) -> list[Result]:
    """Results in the order of `NAMES`, whichever was trained first."""
    return sorted(results, key=lambda result: _place(result.name))


def _place(name: str) -> tuple[int, str]:
    """A key to sort by: a variant follows the method that it varies."""
    methods, method = list(NAMES), name.split("+")[0]
    return methods.index(method) if method in methods else len(methods), name


def by_task(results: Iterable[Result]) -> dict[tuple[str, str | None], list[Result]]:
    """The results of each `(task, target)`, in the order in which they come."""
    groups: dict[tuple[str, str | None], list[Result]] = {}
    for result in results:
        groups.setdefault((result.task, result.target), []).append(result)
    return groups


def transfers(results: Iterable[Result]) -> list[Result]:
    """The results whose reward was used in another task than the one in which it was learned."""
    return [result for result in results if result.target and result.target != result.task]


def pair(result: Result) -> str:
    """The task, or for example "ant to crippled_ant"."""
    return f"{result.task} to {result.target}" if result.target else result.task


def ceilings(results: Iterable[Result]) -> dict[str, Result]:
    """For each budget of retraining the first result that has it; results of one budget share their ceiling.

    Returns:
      Results by the retraining settings in their name; "" stands for the recipe's.
    """
    return {each.name.partition(RETRAIN)[2]: each for each in reversed(list(results)) if each.target}
