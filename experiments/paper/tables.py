"""The tables of results as records and as Markdown.

`python -m eairl_jax.experiments.paper.tables` writes those of README.md and docs/results.md anew.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import stats

from eairl_jax import demonstrations
from eairl_jax.experiments.display.console import mean_and_std
from eairl_jax.experiments.paper import published, results
from eairl_jax.experiments.pipeline.diagnosis import FROM_EXPERT, TRAINED, VERDICTS, Diagnosis
from eairl_jax.experiments.pipeline.places import Reference, shipped_demonstrations
from eairl_jax.experiments.pipeline.run import Result
from eairl_jax.storage import replacing

ROOT = Path(__file__).resolve().parents[2]
PAGES = (ROOT / "README.md", ROOT / "docs" / "results.md")
RULES = ("last", "source_retrain", "policy")
"""The rules that have a column in the table of a transfer."""
FAULT = "the reward, by diagnosis"
"""The column that says of how many seeds the reward of the last iteration is mistaken."""
HOME = "back in the source"
"""The column of rewards that are used in the task where they were learned."""
IMITATING = "imitating, in the source"
"""The column of the policies that learned the rewards."""


class Cell(NamedTuple):
    """A figure and the paper's, each as text and as a score from 0 (random actions) to 1 (the expert)."""

    ours: str = ""
    score: float | None = None
    paper: str = ""
    paper_score: float | None = None


class Table(NamedTuple):
    """A table. `lines` hold a name and at most one cell for each column."""

    title: str
    columns: list[str]
    lines: list[tuple[str, list[Cell]]]

    def has_paper(self, column: int) -> bool:
        """Whether the paper has a figure for any line of a column."""
        return any(len(cells) > column and cells[column].paper for _, cells in self.lines)


def cell(result: Result | None, figures: published.Table) -> Cell:
    """The cell of a result; an empty one for None.

    Args:
      figures: the paper's.
    """
    if result is None:
        return Cell()
    task = result.target or result.task
    ours = mean_and_std(result.mean, result.std)
    if result.dropped:
        ours += f", {len(result.seeds)} of {result.count} seeds"
    figure = published.figure(figures, task, result.method) if result.is_published else None
    expert = published.figure(figures, task, "expert")
    if figure is None or expert is None:
        return Cell(ours, result.normalized)
    # The paper does not say what random actions score in its tasks. Ours stand in for them.
    paper_score = Reference(expert[0], result.random).normalized(figure[0])
    return Cell(ours, result.normalized, published.show(figure), paper_score)


def ceiling(result: Result) -> float:
    """The normalised score of policies trained on the true reward under the same budget."""
    return result.reference.normalized(float(np.mean(result.ceiling)))


def picked_in_the_target(transfer: list[Result]) -> Result | None:
    """What the authors' release reports: the iteration of EAIRL's reward with the best score *in the target*.

    Returns:
      The result of that iteration, or None if fewer than two iterations were tried.
    """
    iterations = [each for each in transfer if each.name == "eairl-sa" and _names_an_iteration(each.rule)]
    return max(iterations, key=lambda result: result.mean) if len(iterations) > 1 else None


def _names_an_iteration(rule: str | None) -> bool:
    return rule is not None and rule.startswith(("iteration=", "last"))


def tables(experiment: list[Result], figures: published.Table) -> list[Table]:
    """The tables of an experiment: one of all imitations, and one for each pair of source and target.

    Args:
      figures: the paper's, `published.TRANSFER` or `published.IMITATION`.
    """
    imitations = [result for result in experiment if result.target is None]
    pairs = results.by_task(results.transfers(experiment)).values()
    first = [_imitation_table(imitations, figures)] if imitations else []
    return [*first, *(_transfer_table(transfer, experiment, figures) for transfer in pairs)]


def _imitation_table(imitations: list[Result], figures: published.Table) -> Table:
    by_name = {(result.name, result.task): result for result in imitations}
    tasks = list(dict.fromkeys(result.task for result in imitations))
    of_tasks = [next(result for result in imitations if result.task == task) for task in tasks]
    methods = [
        (results.title(name), [cell(by_name.get((name, task)), figures) for task in tasks])
        for name in results.names_in_order(imitations)
    ]
    expert = ("expert", [_expert(result, figures) for result in of_tasks])
    random = ("random actions", [_random_actions(result) for result in of_tasks])
    return Table("imitation", tasks, [expert, *methods, random])


def _transfer_table(transfer: list[Result], experiment: list[Result], figures: published.Table) -> Table:
    """The table of one pair of tasks; `experiment` holds the results back in the source, too."""
    first = transfer[0]
    by_column = {(result.name, result.rule): result for result in transfer}
    by_column |= {(result.name, HOME): result for result in experiment if result.task == result.target == first.task}
    by_column |= {(result.name, FAULT): result for result in transfer if result.rule == "last"}
    columns = [column for column in ("last", FAULT, *RULES[1:], HOME) if any(column == each for _, each in by_column)]
    lines = _above(first, figures)
    for name in results.names_in_order(result for result in transfer if result.rule in RULES):
        # The paper's rewards are those of the last iteration.
        cells = [_transfer_cell(by_column.get((name, column)), column, figures) for column in columns]
        imitating = next(result for result in transfer if result.name == name).imitation_returns
        lines.append((results.title(name), [*cells, Cell(_mean_and_std(imitating))]))
    picked = picked_in_the_target(transfer)
    if picked:
        lines.append(("EAIRL, iteration picked by its score in the target", [cell(picked, {})]))
    lines += [("random reward", [cell(result, {})]) for result in transfer if result.rule == "random"]
    return Table(results.pair(first), [*columns, IMITATING], [*lines, _below(first)])


def _above(result: Result, figures: published.Table) -> list[tuple[str, list[Cell]]]:
    """The first lines of the table of a transfer: what the rewards are measured by."""
    best = Cell(_mean_and_std(result.ceiling), ceiling(result))
    return [("expert", [_expert(result, figures)]), ("ceiling", [best])]


def _below(result: Result) -> tuple[str, list[Cell]]:
    """The last line of the table of a transfer."""
    return "random actions", [_random_actions(result)]


def _transfer_cell(result: Result | None, column: str, figures: published.Table) -> Cell:
    return Cell(fault(result)) if column == FAULT else cell(result, figures if column == "last" else {})


def fault(result: Result | None) -> str:
    """What the diagnosis says of the seeds' rewards, for example "4 agree, 1 mistaken"."""
    if result is None:
        return ""
    if result.diagnosis is None:
        return "not diagnosed"
    counts = Counter(Diagnosis.from_json(result.diagnosis).verdicts)
    words = {"agrees": "agree" if counts["agrees"] > 1 else "agrees"}
    return ", ".join(f"{counts[verdict]} {words.get(verdict, verdict)}" for verdict in VERDICTS if counts[verdict])


def _expert(result: Result, figures: published.Table) -> Cell:
    figure = published.figure(figures, result.target or result.task, "expert")
    return Cell(f"{result.expert:.2f}", 1.0, *((published.show(figure), 1.0) if figure else ()))


def _random_actions(result: Result) -> Cell:
    return Cell(f"{result.random:.2f}", 0.0)


def _mean_and_std(returns: list[float]) -> str:
    return mean_and_std(float(np.mean(returns)), float(np.std(returns)))


def markdown(table: Table) -> str:
    """A table as Markdown: every figure with its score, and the paper's column beside ours where it has one."""
    with_paper = [table.has_paper(column) for column in range(len(table.columns))]

    def texts(cells: list[Cell]) -> list[str]:
        padded = [*cells, *[Cell()] * (len(table.columns) - len(cells))]
        columns = []
        for each, has_paper in zip(padded, with_paper, strict=True):
            columns.append(_with_score(each.ours, each.score))
            if has_paper:
                columns.append(_with_score(each.paper, each.paper_score))
        return columns

    titles = []
    for column, has_paper in zip(table.columns, with_paper, strict=True):
        titles += [column, "paper"] if has_paper else [column]
    lines = [
        [table.title, *titles],
        ["---"] * (1 + len(titles)),
        *([name, *texts(cells)] for name, cells in table.lines),
    ]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def _with_score(figure: str, score: float | None) -> str:
    return figure if score is None else f"{figure} ({score:.2f})"


# The rewards, and the transfers, of the compact table.
COMPACT_NAMES = ("gail-sa", "airl_s-s", "airl_sa-sa", "eairl-sa", "airl_sa-separable", "eairl-separable")
COMPACT_PAIRS = (
    ("point_maze_left", "point_maze_right"),
    ("point_maze_right", "point_maze_left"),
    ("ant", "crippled_ant"),
)


def compact(experiment: list[Result], figures: published.Table) -> Table:
    """One table of all transfers by the last iteration's reward: a line for each reward, a column for each transfer."""
    lines_of = {table.title: dict(table.lines) for table in tables(experiment, figures)}
    columns = [f"{source} to {target}" for source, target in COMPACT_PAIRS]
    names = ("expert", "ceiling", *map(results.title, COMPACT_NAMES), "random actions")
    lines = [(name, [(lines_of.get(pair, {}).get(name) or [Cell()])[0] for pair in columns]) for name in names]
    return Table("reward of", columns, lines)


def diagnoses(experiment: list[Result]) -> list[Table]:
    """For each pair of tasks what each reward pays for: learned rewards, on a scale from 0 to 1, and true returns."""
    judged = [result for result in experiment if result.diagnosis]
    return [_diagnosis_table(group) for group in results.by_task(judged).values()]


DIAGNOSIS_COLUMNS = (
    "trained on the reward",
    "share of the best known",
    "lowest seed",
    "trained from the expert",
    FAULT,
)


def _diagnosis_table(group: list[Result]) -> Table:
    lines = []
    for result in results.in_order(group):
        diagnosis = Diagnosis.from_json(result.diagnosis or {})
        trained, from_expert = (diagnosis.behaviours[name].true.tolist() for name in (TRAINED, FROM_EXPERT))
        share = f"{diagnosis.share.mean():.3f}", f"{diagnosis.share.min():.3f}"
        texts = (_mean_and_std(trained), *share, _mean_and_std(from_expert), fault(result))
        lines.append((results.title(result.name), [Cell(text) for text in texts]))
    return Table(results.pair(group[0]), list(DIAGNOSIS_COLUMNS), lines)


def by_source(experiment: list[Result]) -> list[Table]:
    """For each target the rewards that were learned in different sources: a line for each method."""
    chosen = [result for result in results.transfers(experiment) if result.rule == "last"]
    targets = dict.fromkeys(result.target for result in chosen)
    return [_source_table([result for result in chosen if result.target == target]) for target in targets]


def _source_table(group: list[Result]) -> Table:
    first, sources = group[0], list(dict.fromkeys(result.task for result in group))
    of = {(result.name, result.task): result for result in group}
    lines = _above(first, {})
    for name in results.names_in_order(group):
        found = [of.get((name, source)) for source in sources]
        cells = [cell for result in found for cell in (_with_lowest(result), Cell(fault(result)))]
        lines.append((results.title(name), cells))
    columns = [column for source in sources for column in (source, FAULT)]
    return Table(f"in {first.target}", columns, [*lines, _below(first)])


NEARLY = 0.9
"""The share of the expert's return up to which `samples` counts."""


def samples(imitations: list[Result]) -> list[Table]:
    """For each method and task the environment steps until a policy first has `NEARLY` the expert's return.

    Behaviour cloning learns without any.
    """
    chosen = [each for each in imitations if each.curve and each.expert is not None and each.method != "bc"]
    if not chosen:
        return []
    tasks, by_name = list(results.by_task(chosen)), {(result.name, result.task): result for result in chosen}
    lines = [
        (results.title(name), [_samples_cell(by_name.get((name, task[0]))) for task in tasks])
        for name in results.names_in_order(chosen)
    ]
    return [Table(f"steps to {NEARLY} of the expert", [task for task, _ in tasks], lines)]


def _samples_cell(result: Result | None) -> Cell:
    """The median over the seeds that get there, and how many they are."""
    reached = [] if result is None else [each for each in first_steps(result, NEARLY) if each is not None]
    if result is None:
        return Cell()
    count = f"{len(reached)} of {len(result.seeds)}"
    return Cell(f"{np.median(reached):,.0f} ({count})" if reached else f"not reached ({count})")


def first_steps(result: Result, score: float) -> list[int | None]:
    """For each seed the environment steps after which its return while training first has a normalised score."""
    curve = result.curve or {"env_steps": [], "true_return": []}
    returns = np.array(curve["true_return"], float)  # None, where no episode has ended, becomes NaN
    above = np.asarray(result.reference.normalized(returns)) >= score
    return [int(curve["env_steps"][seed.argmax()]) if seed.any() else None for seed in above]


DEMOS = "+demos="
"""Stands in a result's name before the quality of its demonstrations."""


def imperfect(experiment: list[Result]) -> list[Table]:
    """For each task and quality of demonstrations the rewards learned from them, and used in the same task."""
    groups: dict[tuple[str, str], list[Result]] = {}
    for result in experiment:
        if DEMOS in result.name and result.task == result.target:
            quality = result.name.partition(DEMOS)[2].partition("+")[0]
            groups.setdefault((result.task, quality), []).append(result)
    return [_imperfect_table(group, quality) for (_, quality), group in groups.items()]


def _imperfect_table(group: list[Result], quality: str) -> Table:
    first = group[0]
    demonstrated = demonstrations.provenance(shipped_demonstrations(first.task, quality))["expert_return"]
    demonstrator = Cell(f"{demonstrated:.2f}", first.reference.normalized(demonstrated))
    lines = [*_above(first, {}), ("the demonstrator", [demonstrator])]
    for result in results.in_order(group):
        name = f"{results.title(result.name.partition(DEMOS)[0])}, {result.rule}"
        over = [f"{each / demonstrated:.2f}" for each in (result.mean, min(result.returns))]
        lines.append((name, [_with_lowest(result), Cell(f"{over[0]}, lowest {over[1]}")]))
    columns = ["in the same task", "over the demonstrator"]
    return Table(f"{first.task}, demonstrator: {quality}", columns, [*lines, _below(first)])


def _with_lowest(result: Result | None) -> Cell:
    """The score of a result, and its lowest seed's beside it."""
    if result is None:
        return Cell()
    return Cell(f"{mean_and_std(result.mean, result.std)}, lowest {min(result.returns):.2f}", result.normalized)


OWN_PART = "+own_part="
"""Stands in the name of a result with a part of the reward for each demonstrator."""


def by_style(experiment: list[Result]) -> list[Table]:
    """For each group of demonstrators the rewards learned from all: one for all, or with a part for each beside it."""
    return [_style_table(group) for group in results.by_task(experiment).values()]


def _style_table(group: list[Result]) -> Table:
    shared = {result.name: result for result in group if OWN_PART not in result.name}
    lines = _above(group[0], {})
    for result in results.in_order(group):
        name = result.name.partition("+")[0]
        has_part = OWN_PART in result.name
        alone = shared.get(re.sub(rf"{re.escape(OWN_PART)}[^+]*", "", result.name))
        gained = gain(result, alone) if has_part and alone else ""
        kind = "with a part for each" if has_part else "one reward for all"
        lines.append((f"{results.title(name)}, {kind}", [_with_lowest(result), Cell(gained)]))
    columns = [f"in {group[0].target}", "gained by the parts, 95 % interval"]
    return Table("from demonstrators of several styles", columns, [*lines, _below(group[0])])


EXACT_PHI, NO_PHI = "+shaping=exact_empowerment+empowerment_steps=", "+shaping=none"


def exact_phi(ablations: list[Result]) -> list[Table]:
    """For each pair of tasks the scores with an exact Phi and with none, and what the same seeds gain by it."""
    chosen = [result for result in ablations if EXACT_PHI in result.name or result.name.endswith(NO_PHI)]
    groups = results.by_task(chosen).values()
    return [_exact_phi_table(group) for group in groups if any(EXACT_PHI in result.name for result in group)]


def _exact_phi_table(group: list[Result]) -> Table:
    lines = []
    for form in dict.fromkeys(result.name.partition("+")[0] for result in group):
        of_form = [result for result in group if result.name.partition("+")[0] == form]
        without = next((result for result in of_form if result.name == form + NO_PHI), None)
        for result in sorted(of_form, key=_steps_of_phi):
            steps = _steps_of_phi(result)
            phi = f"Phi over {steps} step{'s' * (steps > 1)}" if steps else "Phi = 0"
            gained = "" if without in (None, result) else gain(result, without)
            lines.append((f"{results.title(form)}, {phi}", [cell(result, {}), Cell(gained), Cell(fault(result))]))
    return Table(results.pair(group[0]), ["last", "gained by Phi, 95 % interval", FAULT], lines)


def _steps_of_phi(result: Result) -> int:
    return int(result.name.partition(EXACT_PHI)[2] or 0)


PROTOCOL = "+optimizer=trpo+num_envs=200+iterations=130"
"""Stands in the name of a result that was learned as the paper learns in the mazes."""


def by_protocol(ablations: list[Result]) -> list[Table]:
    """For each pair of tasks the rewards that were learned as the paper learns."""
    groups = results.by_task([result for result in ablations if result.name.endswith(PROTOCOL)]).values()
    return [_protocol_table(group) for group in groups]


def _protocol_table(group: list[Result]) -> Table:
    lines = [
        (results.title(result.name.removesuffix(PROTOCOL)), [_with_lowest(result), Cell(fault(result))])
        for result in results.in_order(group)
    ]
    return Table(results.pair(group[0]), ["last", FAULT], [*_above(group[0], {}), *lines, _below(group[0])])


def gain(result: Result, other: Result) -> str:
    """The mean difference of the returns of the same seeds, with its 95 % interval by Student's t."""
    ours, theirs = (dict(zip(each.seeds, each.returns, strict=True)) for each in (result, other))
    both = sorted(ours.keys() & theirs.keys())
    if len(both) < 2:
        return ""
    difference = np.array([ours[seed] - theirs[seed] for seed in both])
    low, high = stats.ttest_1samp(difference, 0.0).confidence_interval(0.95)
    return f"{difference.mean():+.2f} ({low:+.2f} to {high:+.2f})"


# Tables that the paper does not have: by their names in a page, the file of results and what is made of it.
OWN = {
    "transfer": ("table1", lambda loaded: [compact(loaded, published.TRANSFER)]),
    "diagnosis": ("table1", diagnoses),
    "sources": ("sources", by_source),
    "exact-phi": ("ablations", exact_phi),
    "imperfect": ("imperfect", imperfect),
    "styles": ("styles", by_style),
    "samples": ("table2", samples),
    "protocol": ("ablations", by_protocol),
}


def updated(text: str, folder: Path = results.FOLDER) -> str:
    """The text with new tables between `<!-- NAME -->` and `<!-- end -->`.

    NAME is a key of `OWN` or of `published.TABLES`.
    """

    def block(match: re.Match) -> str:
        name = match[1]
        if name in OWN:
            experiment, make = OWN[name]
            shown = make(results.load(folder / f"{experiment}.json"))
        else:
            shown = tables(results.load(folder / f"{name}.json"), published.TABLES[name])
        return "\n".join([f"<!-- {name} -->", "\n\n".join(map(markdown, shown)), "<!-- end -->"])

    return re.sub(
        rf"<!-- ({'|'.join((*OWN, *published.TABLES))}) -->\n.*?<!-- end -->",
        block,
        text,
        flags=re.DOTALL,
    )


def main() -> None:
    """Rewrites the tables of `PAGES`."""
    for page in PAGES:
        if page.exists():
            with replacing(page) as unfinished:
                unfinished.write_text(updated(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
