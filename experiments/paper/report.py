"""`eairl report`: one page that shows what was reproduced, from the results on disk. The page needs no network."""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path

from eairl_jax import InputError
from eairl_jax.experiments.display.console import console
from eairl_jax.experiments.display.page import data_url
from eairl_jax.experiments.paper import published, report_figures, report_tables, results, tables
from eairl_jax.experiments.paper.claims import VERDICTS, claims, improvements
from eairl_jax.experiments.paper.plan import EXPERIMENTS, missing
from eairl_jax.experiments.pipeline.run import Result
from eairl_jax.experiments.pipeline.run_folder import check_writable, machine

OPENED = r"<details><summary>\1</summary>"
PAGE = Path("runs") / "report.html"


def write(results_folder: Path | None = None, out: Path | None = None) -> None:
    """Writes the page.

    Args:
      results_folder: where `eairl reproduce` wrote; default `results.FOLDER`.
      out: the page's file; default `PAGE`.

    Raises:
      InputError: if the folder holds no results, or the page cannot be written.
    """
    folder, out = results_folder or results.FOLDER, out or PAGE
    results_of = {name: results.load(folder / f"{name}.json") for name in EXPERIMENTS}
    if not any(results_of.values()):
        raise InputError(
            f"{folder} holds no results: make some with `eairl reproduce all --quick --results {folder}`, or give "
            "another folder with --results"
        )
    check_writable(out)
    out.write_text(page(results_of, folder), encoding="utf-8")
    console.print(f"{out} shows it in any browser, without a network", soft_wrap=True, markup=False)


def page(results_of: dict[str, list[Result]], folder: Path) -> str:
    """The page, as text.

    Args:
      results_of: the results of each of `EXPERIMENTS`.
      folder: holds the pictures of Appendix C and discussion.md, if there are any.
    """
    from jinja2 import Environment

    template = (files("eairl_jax.experiments.paper") / "report.html").read_text(encoding="utf-8")
    discussion = folder / "discussion.md"
    text = discussion.read_text(encoding="utf-8") if discussion.exists() else ""
    summary, _, rest = map(_rendered, text.partition("\n\n"))
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    return environment.from_string(template).render(
        summary=summary,
        discussion=rest,
        missing=missing(results_of),
        machine=machine(),
        **_judgements(results_of),
        **_scores(results_of),
        **_measures(results_of),
        **_pictures(results_of, folder),
        **_costs(results_of),
    )


def _rendered(text: str) -> str:
    """Markdown as HTML. Of a text's own HTML only what folds a part away remains; everything else is shown as text."""
    from markdown_it import MarkdownIt

    shown = MarkdownIt("commonmark", {"html": False}).disable("image").render(text)
    opened = re.sub(r"<p>&lt;details&gt;&lt;summary&gt;(.*?)&lt;/summary&gt;</p>", OPENED, shown)
    return opened.replace("<p>&lt;/details&gt;</p>", "</details>")


def _judgements(results_of: dict[str, list[Result]]) -> dict:
    judged = claims(results_of)
    of_the_paper = [claim.verdict for claim in judged if claim.paper]
    return {
        "claims": judged,
        "count": {verdict: of_the_paper.count(verdict) for verdict in VERDICTS},
        "improvements": improvements(results_of),
    }


def _scores(results_of: dict[str, list[Result]]) -> dict:
    panels = report_tables.overview(results_of)
    all_tables = [tables.tables(results_of[name], published.TABLES[name]) for name in ("table2", "table1")]
    return {
        "panels": panels,
        "overview": report_figures.overview(panels),
        "tables": [table for group in all_tables for table in group],
        "diagnoses": tables.diagnoses(results_of["table1"]),
        "exact_phi": tables.exact_phi(results_of["ablations"]),
        "by_source": tables.by_source(results_of["sources"]),
        "protocol": tables.by_protocol(results_of["ablations"]),
        "samples": tables.samples(results_of["table2"]),
        "imperfect": tables.imperfect(results_of["imperfect"]),
        "by_style": tables.by_style(results_of["styles"]),
        "ablations": report_figures.ablations(results_of),
    }


def _measures(results_of: dict[str, list[Result]]) -> dict:
    transfers = results.transfers(results_of["table1"])
    measured = [
        result
        for group in results.by_task([*transfers, *results_of["ablations"]]).values()
        for result in results.in_order(group)
        if result.closeness
    ]
    return {
        "closeness": report_tables.closeness(measured),
        "worth": report_tables.worth(measured),
        "closeness_figure": report_figures.closeness([result for result in transfers if result.closeness]),
    }


def _pictures(results_of: dict[str, list[Result]], folder: Path) -> dict:
    transfers = results.transfers(results_of["table1"])
    longer = [result for result in results_of["ablations"] if results.RETRAIN in result.name]
    last = [result for result in transfers if result.rule == "last"]
    return {
        "imitation_curves": report_figures.curves("imitation: true return while learning", results_of["table2"]),
        "transfer_curves": report_figures.curves(
            "transfer: true return in the target, training on the learned reward", [*last, *longer]
        ),
        "pictures": [
            {
                "caption": report_tables.caption(path.stem.removeprefix("appendix-c-"), transfers),
                "url": data_url(path.read_bytes(), "png"),
            }
            for path in sorted(folder.glob("appendix-c-*.png"))
        ],
    }


def _costs(results_of: dict[str, list[Result]]) -> dict:
    budgets = [report_tables.budget(name, result) for name, group in results_of.items() for result in group]
    return {"budgets": budgets, "hours": report_tables.hours(results_of)}
