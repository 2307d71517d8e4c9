"""`eairl report`: one page that shows what was reproduced, from the results on disk. It needs no network."""

from __future__ import annotations

import base64
import io
from pathlib import Path

import numpy as np

from eairl_jax import InputError
from experiments import figures, paper, results
from experiments.aggregate import interquartile_mean
from experiments.claims import HOLDS, claims, improvements, scores
from experiments.folder import machine, writable
from experiments.reproduce import EXPERIMENTS
from experiments.summary import curve_figure, figure_of
from experiments.training import console

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

    template = (files("experiments") / "viewer" / "report.html").read_text(encoding="utf-8")
    discussion = folder / "discussion.md"
    text = discussion.read_text(encoding="utf-8") if discussion.exists() else ""
    lead, _, rest = (MarkdownIt().render(part) for part in text.partition("\n\n"))
    judged = claims(found)
    transfers = results.moved(found["table1"])
    pictures = [(path.stem, _data_url(path.read_bytes(), "png")) for path in sorted(folder.glob("appendix-c-*.png"))]
    return Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True).from_string(template).render(
        claims=judged,
        count={holds: sum(claim.holds == holds for claim in judged if claim.paper) for holds in HOLDS},
        lead=lead,
        overview=overview(found),
        tables=[table for name in ("table2", "table1") for table in results.tables(found[name], paper.TABLES[name])],
        improvements=improvements(found),
        imitation_curves=_curves("imitation: true return while learning", found["table2"]),
        transfer_curves=_curves("transfer: true return in the target, training on the learned reward",
                                [row for row in transfers if row["rule"] == "last"]),
        ablations=ablation_figures(found),
        closeness=closeness_table(transfers),
        worth=worth_table(transfers),
        closeness_figure=closeness_figure(transfers),
        pictures=pictures,
        discussion=rest,
        budgets=[budget(name, row) for name, rows in found.items() for row in rows],
        missing=missing(found),
        machine=machine(),
    )  # fmt: skip


def overview(found: dict[str, list[dict]]) -> str:
    """The first screen's figure: each row's score with its interval, and the paper's."""
    moved = results.moved(found["table1"])
    panels = [panel for panel in (
        ("imitation", found["table2"], None, paper.IMITATION),
        *((f"the reward in {place}", [row for row in moved if row["task"].startswith(source)], "last", paper.TRANSFER)
          for place, source in (("the other maze", "point_maze"), ("the crippled ant", "ant"))),
    ) if panel[1]]  # fmt: skip
    if not panels:
        return ""
    figure, axes = figure_of(1, len(panels), (4.6, 3.4), "")
    for axis, (title, rows, rule, table) in zip(axes[0], panels, strict=True):
        names = [name for name in results.in_order(rows) if scores(rows, name, rule)]
        for place, name in enumerate(reversed(names)):
            own = scores(rows, name, rule)
            each = interquartile_mean(list(own.values()))
            color = results.color(name)
            axis.plot([each.low, each.high], [place] * 2, color=color, lw=3, alpha=0.5)
            axis.plot(each.value, place, "o", color=color)
            cells = [results.cell(row, table) for row in rows if row["row"] == name and row.get("rule") == rule]
            published = [cell.published_share for cell in cells if cell.published_share is not None]
            if published:
                axis.plot(np.mean(published), place, "D", mfc="none", mec="black", ms=5)
        tasks = len({(row["task"], row["target"]) for row in rows})
        run = [len(scores(rows, name, rule)) for name in names]
        _lay_out(axis, [results.name(name) + (f", {count} of {tasks} tasks" if count < tasks else "")
                        for name, count in zip(names, run, strict=True)])  # fmt: skip
        axis.set_title(f"{title}, {tasks} task{'s' * (tasks > 1)}", fontsize=10)
        if rule:
            ceilings = {(row["task"], row["target"]): results.ceiling(row) for row in rows}
            axis.axvline(float(np.mean(list(ceilings.values()))), color="gray", lw=1, ls=":")
        axis.set_xlabel("0 random actions, 1 expert; ◇ the paper")
    return _svg(figure)


def _lay_out(axis, labels: list[str]) -> None:
    """A line for each row, the first above, and the expert's score."""
    axis.set_yticks(range(len(labels)), labels[::-1])
    axis.axvline(1, color="black", lw=0.8, ls="--")
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
        rows = sorted([*base, *ablated], key=lambda row: results.place(row["row"]))
        figure, axes = figure_of(1, 1, (8.5, 0.32 * len(rows) + 1), "")
        axis = axes[0, 0]
        for place, row in enumerate(reversed(rows)):
            own, color = results.normalized(row), results.color(row["row"])
            axis.plot(own, [place] * len(own), "o", color=color, alpha=0.5, mec="none")
            axis.plot([own.mean()] * 2, [place - 0.3, place + 0.3], color=color, lw=2)
        _lay_out(axis, [results.name(row["row"]) for row in rows])
        axis.tick_params(axis="y", labelsize=8)
        axis.set_xlabel(f"{task} to {target}: normalised true return, a dot a seed, their mean")
        drawn.append(_svg(figure))
    return drawn


def closeness_table(rows: list[dict]) -> list[dict]:
    """EPIC distance and rank correlations of each row that has them, means over the seeds."""
    table = []
    for row in rows:
        if "closeness" in row:
            measures = {f"{place}: {name}": _mean(values) for place, measured in row["closeness"].items()
                        for name, values in measured.items() if not name.startswith("worth")}  # fmt: skip
            table.append({"pair": f"{row['task']} to {row['target']}", "row": results.name(row["row"]),
                          "score": row["normalized"], "measures": measures})  # fmt: skip
    return table


def worth_table(rows: list[dict]) -> list[dict]:
    """What the target's expert, random actions and the retrained policies are worth to each reward, means a step."""
    return [{"pair": f"{row['task']} to {row['target']}", "row": results.name(row["row"]), "score": row["normalized"],
             "worth": [_mean(row["closeness"]["target"][f"worth, {who}"]) for who in WORTH]}
            for row in rows if "closeness" in row]  # fmt: skip


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def closeness_figure(rows: list[dict]) -> str:
    """Does a closer reward transfer better? Each seed's score over its EPIC distance and its rank correlation."""
    rows = [row for row in rows if "closeness" in row]
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


def missing(found: dict[str, list[dict]]) -> list[dict]:
    """The tasks of an experiment of which rows are missing, with the command that finishes them."""
    count: dict[tuple[str, str], int] = {}
    for name, entries in EXPERIMENTS.items():
        there = {results.identity(row) for row in found[name]}
        for entry in entries:
            if entry.identity not in there:
                count[name, entry.task] = count.get((name, entry.task), 0) + 1
    return [{"experiment": name, "task": task, "rows": rows, "command": f"eairl reproduce {name} --task {task}"}
            for (name, task), rows in count.items()]  # fmt: skip


def _svg(figure) -> str:
    from matplotlib import rc_context

    image = io.BytesIO()
    with rc_context({"svg.hashsalt": "eairl_jax"}):  # the same figure is the same text
        figure.savefig(image, format="svg", metadata={"Date": None})
    return _data_url(image.getvalue(), "svg+xml")


def _data_url(data: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
