"""`eairl report`: one page that shows what was reproduced, from the results on disk. It needs no network."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import NamedTuple

import numpy as np

from eairl_jax import InputError
from eairl_jax.experiments.display.plots import curve_figure, figure_of
from eairl_jax.experiments.paper import figures, results
from eairl_jax.experiments.paper import published as paper
from eairl_jax.experiments.paper.claims import HOLDS, claims, improvements, scores
from eairl_jax.experiments.paper.plan import EXPERIMENTS, Entry
from eairl_jax.experiments.paper.statistics import Estimate, interquartile_mean
from eairl_jax.experiments.pipeline.run_folder import machine, writable
from eairl_jax.experiments.pipeline.train import console

WORTH = ("random", "expert", "retrained")


def command(folder: Path | None, out: Path | None) -> None:
    """Writes the page."""
    folder = folder or results.FOLDER
    out = out or Path("runs") / "report.html"
    found = {name: results.load(folder / f"{name}.json") for name in EXPERIMENTS}
    if not any(found.values()):
        raise InputError(f"{folder} holds no results: make some with `eairl reproduce all --quick --results {folder}`")
    writable(out)
    out.write_text(page(found, folder), encoding="utf-8")
    console.print(f"{out} shows it in any browser, without a network", soft_wrap=True, markup=False)


def page(found: dict[str, list[dict]], folder: Path) -> str:
    """The page, as text."""
    from importlib.resources import files

    from jinja2 import Environment
    from markdown_it import MarkdownIt

    template = (files("eairl_jax.experiments.display") / "viewer" / "report.html").read_text(encoding="utf-8")
    discussion = folder / "discussion.md"
    text = discussion.read_text(encoding="utf-8") if discussion.exists() else ""
    lead, _, rest = (MarkdownIt().render(part) for part in text.partition("\n\n"))
    judged = claims(found)
    longer = [row for row in found["ablations"] if "+retrain_" in row["row"]]
    transfers, panels = results.moved(found["table1"]), overview_panels(found)
    measured = [row for _, own in results.by_task([*transfers, *found["ablations"]]).items()
                for row in results.listed(own) if "closeness" in row]  # fmt: skip
    pictures = [{"caption": caption(path.stem.removeprefix("appendix-c-"), transfers),
                 "url": _data_url(path.read_bytes(), "png")}
                for path in sorted(folder.glob("appendix-c-*.png"))]  # fmt: skip
    return Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True).from_string(template).render(
        claims=judged,
        count={holds: sum(claim.holds == holds for claim in judged if claim.paper) for holds in HOLDS},
        lead=lead,
        overview=overview(panels),
        panels=panels,
        tables=[table for name in ("table2", "table1") for table in results.tables(found[name], paper.TABLES[name])],
        improvements=improvements(found),
        imitation_curves=_curves("imitation: true return while learning", found["table2"]),
        transfer_curves=_curves("transfer: true return in the target, training on the learned reward",
                                [*(row for row in transfers if row["rule"] == "last"), *longer]),
        ablations=ablation_figures(found),
        closeness=closeness_table(measured),
        worth=worth_table(measured),
        closeness_figure=closeness_figure([row for row in transfers if "closeness" in row]),
        pictures=pictures,
        discussion=rest,
        budgets=[budget(name, row) for name, rows in found.items() for row in rows],
        hours=hours(found),
        missing=missing(found),
        machine=machine(),
    )  # fmt: skip


class Line(NamedTuple):
    """A row of a panel of the overview: its scores over all tasks, and the paper's mean."""

    row: str
    name: str
    middle: Estimate
    mean: float
    published: float | None
    tasks: int


class Panel(NamedTuple):
    """A part of the overview: the lines of its rows, the number of its tasks, the true reward's score if it has one."""

    title: str
    lines: list[Line]
    tasks: int
    ceiling: float | None


def overview_panels(found: dict[str, list[dict]]) -> list[Panel]:
    """Imitation, and the transfers to each kind of target."""
    moved = [row for row in results.moved(found["table1"]) if row["rule"] == "last"]
    parts = [("imitation", found["table2"], None, paper.IMITATION)]
    for place, source in (("the other maze", "point_maze"), ("the crippled ant", "ant")):
        rows = [row for row in moved if row["task"].startswith(source)]
        parts.append((f"the reward in {place}", rows, "last", paper.TRANSFER))
    return [_panel(*part) for part in parts if part[1]]


def _panel(title: str, rows: list[dict], rule: str | None, table: dict) -> Panel:
    lines, by_task = [], results.by_task(rows)
    for name in results.in_order(rows):
        if "=" in name:
            continue  # a question about one setting is for the tables
        own = list(scores(rows, name, rule).values())
        cells = [results.cell(row, table) for row in rows if row["row"] == name]
        published = [cell.published_share for cell in cells if cell.published_share is not None]
        lines.append(Line(name, results.name(name), interquartile_mean(own), float(np.mean([s.mean() for s in own])),
                          float(np.mean(published)) if published else None, len(own)))  # fmt: skip
    ceiling = float(np.mean([results.ceiling(own[0]) for own in by_task.values()])) if rule else None
    return Panel(f"{title}, {len(by_task)} task{'s' * (len(by_task) > 1)}", lines, len(by_task), ceiling)


def overview(panels: list[Panel]) -> str:
    """The first screen's figure: each row's score with its interval, and the paper's."""
    if not panels:
        return ""
    figure, axes = figure_of(1, len(panels), (4.6, 3.4), "")
    for axis, panel in zip(axes[0], panels, strict=True):
        for place, line in enumerate(reversed(panel.lines)):
            color = results.color(line.row)
            axis.plot([line.middle.low, line.middle.high], [place] * 2, color=color, lw=3, alpha=0.5)
            axis.plot(line.middle.value, place, "o", color=color)
            if line.published is not None:
                axis.plot(line.published, place, "D", mfc="none", mec="black", ms=5)
        _lay_out(axis, [line.name + (f", {line.tasks} of {panel.tasks} tasks" if line.tasks < panel.tasks else "")
                        for line in panel.lines])  # fmt: skip
        axis.set_title(panel.title, fontsize=10)
        if panel.ceiling is not None:
            axis.axvline(panel.ceiling, color="gray", lw=1, ls=":")
        axis.set_xlabel("0 random actions, 1 expert; ◇ the paper")
    return _svg(figure)


def _lay_out(axis, labels: list[str]) -> None:
    """A line for each row, the first above, and the expert's score."""
    axis.set_yticks(range(len(labels)), labels[::-1])
    axis.axvline(1, color="black", lw=0.8, ls="--")
    axis.set_xlim(left=min(axis.get_xlim()[0], -0.05))
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(axis="x", alpha=0.3)


def _curves(title: str, rows: list[dict]) -> str:
    curves = figures.learning_curves(rows)
    return _svg(curve_figure(title, curves, columns=2)) if curves else ""


def ablation_figures(found: dict[str, list[dict]]) -> list[str]:
    """For each transfer a dot a seed for EAIRL and each change of it, beside the rows that were changed."""
    drawn = []
    for (task, target), ablated in results.by_task(found["ablations"]).items():
        beside = {row["row"].split("+")[0] for row in ablated} | {"airl_s-s"}
        base = [row for row in found["table1"] if (row["task"], row["target"], row["rule"]) == (task, target, "last")
                and row["row"] in beside]  # fmt: skip
        if not base:
            continue
        rows = results.listed([*base, *ablated])
        figure, axes = figure_of(1, 1, (8.5, 0.32 * len(rows) + 1), "")
        axis = axes[0, 0]
        for place, row in enumerate(reversed(rows)):
            own, color = results.normalized(row), results.color(row["row"])
            axis.plot(own, [place] * len(own), "o", color=color, alpha=0.5, mec="none")
            axis.plot([own.mean()] * 2, [place - 0.3, place + 0.3], color=color, lw=2)
            axis.plot([results.ceiling(row)] * 2, [place - 0.5, place + 0.5], color="gray", lw=1, ls=":")
        _lay_out(axis, [results.name(row["row"]) for row in rows])
        axis.tick_params(axis="y", labelsize=8)
        axis.set_title(f"{task} to {target}", fontsize=10)
        axis.set_xlabel("0 random actions, 1 expert: a dot a seed, their mean; dotted: the true reward's")
        drawn.append(_svg(figure))
    return drawn


def closeness_table(rows: list[dict]) -> list[dict]:
    """EPIC distance and rank correlations of each row, means over the seeds."""
    table = []
    for row in rows:
        measures = {f"{place}: {name}": _mean(values) for place, measured in row["closeness"].items()
                    for name, values in measured.items() if not name.startswith("worth")}  # fmt: skip
        table.append({"pair": f"{row['task']} to {row['target']}", "row": results.name(row["row"]),
                      "score": row["normalized"], "measures": measures})  # fmt: skip
    return table


def worth_table(rows: list[dict]) -> list[dict]:
    """What the target's expert, random actions and the retrained policies are worth to each reward, means a step."""
    return [{"pair": f"{row['task']} to {row['target']}", "row": results.name(row["row"]), "score": row["normalized"],
             "worth": [_mean(row["closeness"]["target"][f"worth, {who}"]) for who in WORTH]}
            for row in rows]  # fmt: skip


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def closeness_figure(rows: list[dict]) -> str:
    """Does a closer reward transfer better? Each seed's score over its EPIC distance and its rank correlation."""
    if not rows:
        return ""
    measures = ("epic", "rank correlation, expert", "rank correlation, policy", "rank correlation, random")
    figure, axes = figure_of(1, len(measures), (3.1, 3.0), "")
    for axis, measure in zip(axes[0], measures, strict=True):
        for row in rows:
            x = np.array(row["closeness"]["target"][measure], float)
            first = row["task"] == rows[0]["task"] and measure == measures[0]
            axis.plot(x, results.normalized(row), "o", color=results.color(row["row"]), alpha=0.7, mec="none",
                      label=results.name(row["row"]) if first else None)  # fmt: skip
        axis.set_xlabel(f"{measure} (in the target)", fontsize=8)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0, 0].set_ylabel("normalised return")
    figure.legend(loc="outside lower center", ncols=6, frameon=False, fontsize=8)
    return _svg(figure)


def budget(experiment: str, row: dict) -> dict:
    """What a row cost, and where it came from."""
    learned = row["settings"]["config"]
    steps = learned["iterations"] * learned["num_envs"] * learned["rollout_length"]
    return {
        "experiment": experiment,
        "row": results.name(row["row"]),
        "tasks": f"{row['task']} to {row['target']}" if row["target"] else row["task"],
        "rule": row.get("rule", ""),
        "seeds": f"{row['seeds'][0]} to {row['seeds'][-1]}",
        "learned": steps,
        "retrained": row["env_steps"] if row["target"] else None,
        "minutes": row["run_seconds"] / 60,
        "date": row["machine"]["date"],
        "device": f"{row['machine']['devices']} x {row['machine']['device']}",
        "jax": row["machine"]["versions"]["jax"],
        "entropy_weight": row["settings"]["hparams"]["entropy_weight"],
        "lambda_i": row["settings"]["hparams"]["lambda_i"],
    }


def hours(found: dict[str, list[dict]]) -> list[dict]:
    """What each experiment took, compilation included."""
    return [{"experiment": name, "rows": len(rows),
             "hours": sum(row["run_seconds"] + row["compile_seconds"] for row in rows) / 3600}
            for name, rows in found.items() if rows]  # fmt: skip


def caption(picture: str, transfers: list[dict]) -> str:
    """What a picture of Appendix C shows, by its name: a task, and "-ways" if it is of ways.

    Args:
      transfers: the rows that it may be of.
    """
    task = picture.removesuffix("-ways")
    if task.startswith("point_maze"):
        return (f"{task}: each row's learned reward (its first seed's, of action 0; bright is high) and the paths of "
                "every seed; above the policies that learned it, below fresh ones on it in the other maze")  # fmt: skip
    if picture != task:
        return (f"{task}: the ways of every seed; above the policies that learned each reward, below fresh ones "
                "trained on it")  # fmt: skip
    name = results.name(figures.SHOWN)
    for row in (row for row in transfers if row["row"] == figures.SHOWN and row["rule"] == "last"):
        seed = row["seeds"][0]
        if row["target"] == task:
            return f"{task}: a fresh policy on the reward of {name}, seed {seed}: true return {row['returns'][0]:.0f}"
        if row["task"] == task:
            return (f"{task}: the policy beside which {name} learned its reward, seed {seed}: true return "
                    f"{row['imitation_returns'][0]:.0f} (how well each imitates is in the first table)")  # fmt: skip
    return task


def missing(found: dict[str, list[dict]]) -> list[dict]:
    """The tasks of an experiment of which rows are missing, which ones, and the command that finishes them."""
    lacking: dict[tuple[str, str], list[str]] = {}
    for name, entries in EXPERIMENTS.items():
        there = {results.identity(row) for row in found[name]}
        for entry in entries:
            if entry.identity not in there:
                lacking.setdefault((name, entry.task), []).append(_called(entry))
    return [{"experiment": name, "task": task, "rows": rows, "command": f"eairl reproduce {name} --task {task}"}
            for (name, task), rows in lacking.items()]  # fmt: skip


def _called(entry: Entry) -> str:
    """A row as one says it: "EAIRL (random)", "EAIRL (back in the source)", "GAIL" of an imitation."""
    rule = results.HOME if entry.target == entry.task else entry.rule
    return results.name(entry.row) + (f" ({rule})" if entry.target else "")


def _svg(figure) -> str:
    from matplotlib import rc_context

    image = io.BytesIO()
    with rc_context({"svg.hashsalt": "eairl_jax"}):  # the same figure is the same text
        figure.savefig(image, format="svg", metadata={"Date": None})
    return _data_url(image.getvalue(), "svg+xml")


def _data_url(data: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
