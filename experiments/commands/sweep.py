"""`eairl sweep`: one method with many values of its floats, all in one compiled program."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from eairl_jax import InputError
from eairl_jax.config import choose
from eairl_jax.experiments.display.plots import Row, plot_sweep, print_table, summarize
from eairl_jax.experiments.pipeline.learn import Job, learn, prepare, warn_if_saturated
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.experiments.pipeline.train import default_out, final_returns, say
from eairl_jax.experiments.recipes import SETTINGS, parse_overrides, recipe
from eairl_jax.types import HParams


def command(task: str, methods: tuple[str, ...], forms: tuple[str, ...], seeds: range, demos: Path | None,
            out: Path | None, assignments: tuple[str, ...], line: str) -> None:  # fmt: skip
    """Trains every combination of the listed values with every seed and prints one table."""
    fixed, grid = split(assignments)
    # The largest value decides what has to be computed at all (a penalty of weight 0 is not).
    largest = tuple(f"{name}={max(values)}" for name, values in grid.items())
    jobs = prepare(task, methods, forms, seeds, demos, "imitate", (*fixed, *largest))
    if len(jobs) != 1:
        raise InputError(f"a sweep is of one method and reward form, these are {len(jobs)}: run one sweep for each")
    job, points = jobs[0], [dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())]
    given = {"method": methods[0], "reward_form": forms[0]} | parse_overrides(fixed)
    for point in points:
        recipe(task, job.env, "imitate", given | point)  # an impossible point is refused before any is trained
    where = out or default_out(f"sweep-{task}-{job.row}-{'-'.join(grid)}")
    summary = sweep(job, points, where, line)
    rows = [Row("expert", np.array([job.reference.expert]), None, 1.0)]
    rows += [Row(name_of(r["point"]), np.array(r["returns"]), None, r["normalized"]) for r in summary["rows"]]
    lanes = [f"{name_of(point)} seed {seed}" for point in points for seed in job.seeds]
    warn_if_saturated(RunFolder(where, job.settings() | {"sweep": points}), job, lanes)
    print_table(f"{job.row} in {task}: true return, {len(seeds)} seeds for each setting", rows)
    say(f"in {where}/; curves.png shows them side by side")


def split(assignments: tuple[str, ...]) -> tuple[tuple[str, ...], dict[str, list[float]]]:
    """Separates `name=a,b,c` of floats, which are swept, from single values.

    Raises:
      InputError: if nothing is swept, or a listed setting is no float.
    """
    grid, fixed = {}, []
    for assignment in assignments:
        name, _, text = assignment.partition("=")
        choose("setting", name, SETTINGS)
        if "," not in text or name in ("hidden", "policy_hidden", "value_hidden"):
            fixed.append(assignment)
            continue
        if name not in HParams.__dataclass_fields__:
            raise InputError(
                f"--set {assignment}: only floats of HParams can be swept, in one compiled program "
                f"({', '.join(HParams.__dataclass_fields__)}); run the command once for each value of {name}"
            )
        grid[name] = [parse_overrides((f"{name}={value}",))[name] for value in text.split(",")]
    if not grid:
        raise InputError("nothing to sweep: give a list of values, e.g. --set lambda_i=0,0.001,0.1,1")
    return tuple(fixed), grid


def name_of(point: dict[str, float]) -> str:
    """`lambda_i 0.1, beta 1`."""
    return ", ".join(f"{name} {value:g}" for name, value in point.items())


def sweep(job: Job, points: list[dict[str, float]], out: Path, command: str) -> dict:
    """Runs a sweep to its end, or goes on with it; returns the summary that it leaves."""
    folder = RunFolder(out, job.settings() | {"sweep": points})
    summary = folder.summary()
    if summary is None:
        algorithm, state = learn(folder, job, points)
        by_lane = final_returns(job.env, algorithm, state, list(job.seeds) * len(points)).mean(axis=1)
        returns = by_lane.reshape(len(points), len(job.seeds))
        config = job.recipe.config
        rows = [
            summarize(command, job.task, None, config.method, job.seeds, own, config.env_steps, folder.seconds(),
                      job.reference, point=point)
            for own, point in zip(returns, points, strict=True)
        ]  # fmt: skip
        curves = folder.curve("true_return", returns.size).reshape(*returns.shape, -1)
        names = [name_of(point) for point in points]
        plot_sweep(folder.path / "curves.png", f"{job.row} in {job.task}", names, returns, curves,
                   config.steps_per_iteration, job.reference.expert)  # fmt: skip
        summary = {"command": command, "rows": rows}
        folder.write_summary(summary)
    return summary
