"""The paper's claims and ours, judged by fixed thresholds on the results on disk."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from eairl_jax.experiments.paper import published, results, tables
from eairl_jax.experiments.paper.plan import EXPERIMENTS, LONG, LONG_ONE_POLICY, retrain_variant
from eairl_jax.experiments.pipeline.diagnosis import Diagnosis
from eairl_jax.experiments.pipeline.run import Result
from eairl_jax.experiments.pipeline.statistics import Estimate, difference, probability_of_improvement

EQUAL = 0.05
"""A normalised score counts as equal if it is less than this below the other."""
VERDICTS = ("yes", "no", "partly", "unclear", "open")
Scores = dict[tuple[str, str | None], np.ndarray]
"""Normalised scores `[seeds]` by (task, target)."""


class Claim(NamedTuple):
    """A statement and the judgement on it.

    Attributes:
      text: the statement.
      paper: what the paper reports; empty for a claim of ours.
      here: what our results are.
      verdict: one of `VERDICTS`; "open" until enough tasks were run.
    """

    text: str
    paper: str
    here: str
    verdict: str


def claims(results_of: dict[str, list[Result]]) -> list[Claim]:
    """The judged claims.

    Args:
      results_of: the results of each of `EXPERIMENTS`, as many as there are.
    """
    imitations, ablations = results_of["table2"], results_of["ablations"]
    transfers = [*results.transfers(results_of["table1"]), *ablations]
    last = [result for result in transfers if result.rule == "last"]
    return [*_on_imitation(imitations), *_on_the_mazes(last), *_on_the_ant(last), *_on_phi(transfers)]


def scores(chosen: Iterable[Result], name: str, rule: str | None = None) -> Scores:
    """The normalised scores of the results of one name and rule, for each task or pair of tasks."""
    return {
        (result.task, result.target): result.scores for result in chosen if result.name == name and result.rule == rule
    }


def planned_tasks(name: str, rule: str | None = None, source: str = "") -> int:
    """How many tasks, or pairs of tasks, a method is planned to be run on.

    Args:
      rule: None for imitations.
      source: how the names of the source tasks begin.
    """
    experiments = EXPERIMENTS["table1" if rule else "table2"]
    tasks = {
        (planned.task, planned.target)
        for planned in experiments
        if planned.name == name
        and planned.task != planned.target
        and planned.task.startswith(source)
        and rule in (None, planned.rule)
    }
    return len(tasks)


def _on_imitation(imitations: list[Result]) -> list[Claim]:
    eairl, tasks = scores(imitations, "eairl-sa"), planned_tasks("eairl-sa")
    # The paper does not say what random actions score in its tasks. Ours stand in for them.
    cells = {
        (result.task, result.target): tables.cell(result, published.IMITATION)
        for result in imitations
        if result.name == "eairl-sa"
    }
    paper = {task: cell.paper_score for task, cell in cells.items() if cell.paper_score is not None}
    at_paper_level = [task_scores.mean() >= paper[task] - EQUAL for task, task_scores in eairl.items() if task in paper]
    tuned = eairl | scores(imitations, "eairl-sa+tuned")
    judged = [
        Claim(
            "EAIRL imitates at the paper's level",
            ", ".join(f"{task} {score:.2f}" for (task, _), score in paper.items()),
            _means_and_ranges(eairl),
            _verdict(at_paper_level, tasks),
        ),
        Claim(
            "Ours: EAIRL imitates at 0.95 of the expert, with tuned settings for ant and half_cheetah",
            "",
            _means_and_ranges(tuned),
            _verdict([task_scores.mean() >= 0.95 for task_scores in tuned.values()], tasks),
        ),
    ]
    for title, name in (("GAIL", "gail-sa"), ("AIRL(s,a)", "airl_sa-sa")):
        text = f"EAIRL imitates as well as {title}"
        judged.append(_as_well(text, eairl, scores(imitations, name), planned_tasks(name)))
    for title, name in (("AIRL(s)", "airl_s-s"), ("GAN-GCL", "gan_gcl-sa")):
        text = f"EAIRL imitates better than {title}"
        judged.append(_better(text, eairl, scores(imitations, name), planned_tasks(name)))
    return judged


def _on_the_mazes(last: list[Result]) -> list[Claim]:
    mazes = [result for result in last if result.task.startswith("point_maze")]
    tasks = planned_tasks("eairl-sa", "last", "point_maze")
    text = "the other maze, within 10 % of the expert's return in every seed"
    return [
        *_on_eairls_reward(mazes, "the other maze", tasks, 0.9, "0.95 of the expert (-7.01 of -4.98)"),
        _on_the_separable_reward(mazes, text, "eairl-separable", tasks, within_a_tenth),
    ]


def _on_the_ant(last: list[Result]) -> list[Claim]:
    ants, tasks = [result for result in last if result.task.startswith("ant")], planned_tasks("eairl-sa", "last", "ant")
    levels = (
        ("0.81 of the expert, as the paper's EAIRL", "eairl-separable", of_the_expert(0.81, np.mean)),
        ("0.95 of the expert in every seed", "eairl-separable", of_the_expert(0.95, np.min)),
        *(
            (
                f"0.95 of the expert in every seed, retrained for 10M steps, {policies}",
                f"eairl-separable+{retrain_variant(settings)}",
                of_the_expert(0.95, np.min),
            )
            for policies, settings in (("one policy a seed", LONG_ONE_POLICY), ("the best of four", LONG))
        ),
    )
    return [
        *_on_eairls_reward(ants, "the crippled ant", tasks, 0.81, "0.81 of the expert"),
        *(
            _on_the_separable_reward(ants, f"the crippled ant, {level}", name, tasks, holds)
            for level, name, holds in levels
        ),
    ]


def _on_eairls_reward(transfers: list[Result], place: str, tasks: int, level: float, paper: str) -> list[Claim]:
    """Whether EAIRL's r(s,a) reaches a score in a place, and whether it beats the rewards of AIRL."""
    eairl = scores(transfers, "eairl-sa", "last")
    verdict = _verdict([task_scores.mean() >= level for task_scores in eairl.values()], tasks)
    if verdict in ("no", "partly") and not is_optimised(transfers, "eairl-sa"):
        verdict = "unclear"
    compared = []
    for title, name in (("AIRL(s)", "airl_s-s"), ("AIRL(s,a)", "airl_sa-sa")):
        text = f"In {place} EAIRL's reward is better than that of {title}"
        compared.append(_better_if_optimised(text, transfers, ("eairl-sa", name), tasks))
    text = f"EAIRL's reward r(s,a) transfers to {place}"
    return [Claim(text, paper, _means_and_ranges(eairl), verdict), *compared]


def is_optimised(transfers: Iterable[Result], *names: str) -> bool:
    """Whether the trainings on the rewards of these names found the best known, by their diagnoses.

    Where they did not, or where no diagnosis was made, a low score says nothing against the reward.
    """
    chosen = [result for result in transfers if result.name in names and result.rule == "last"]
    return all(result.diagnosis and Diagnosis.from_json(result.diagnosis).is_optimised for result in chosen)


def _better_if_optimised(text: str, transfers: list[Result], names: tuple[str, str], tasks: int) -> Claim:
    """Whether the first of two rewards is better; "unclear" unless both were optimised."""
    ours, theirs = (scores(transfers, name, "last") for name in names)
    claim = _better(text, ours, theirs, tasks)
    if claim.verdict == "open" or is_optimised(transfers, *names):
        return claim
    return claim._replace(verdict="unclear", here=f"{claim.here}; not shown to be optimised")


def _on_the_separable_reward(
    transfers: list[Result], text: str, name: str, tasks: int, holds: Callable[[Result], bool]
) -> Claim:
    """Whether the result of a name holds on each of so many pairs of tasks."""
    verdict = _verdict([holds(result) for result in transfers if result.name == name], tasks)
    here = _means_and_ranges(scores(transfers, name, "last"))
    return Claim(f"Ours: a separable reward transfers to {text}", "", here, verdict)


def of_the_expert(score: float, of_seeds: Callable[[np.ndarray], float]) -> Callable[[Result], bool]:
    """A condition on a result: the mean (`np.mean`) or the worst (`np.min`) of its seeds reaches a score."""
    return lambda result: bool(of_seeds(result.scores) >= score)


def within_a_tenth(result: Result) -> bool:
    """Whether every seed's return is at most a tenth of the expert's return below the expert's."""
    assert result.expert is not None  # every task of the paper has an expert
    return min(result.returns) >= result.expert - 0.1 * abs(result.expert)


def _on_phi(transfers: list[Result]) -> list[Claim]:
    """Compares rewards that are shaped by empowerment alone with rewards that are not shaped."""
    mazes = [result for result in transfers if result.task.startswith("point_maze")]
    return [
        _better_if_optimised(
            f"Empowerment's Phi is what makes {form} transfer (compared with Phi = 0)",
            mazes,
            (with_phi, without_phi),
            1,
        )
        for form, with_phi, without_phi in (
            ("r(s,a)", "eairl-sa", "eairl-sa+shaping=none"),
            ("a separable reward", "eairl-separable+shaping=empowerment", "eairl-separable+shaping=none"),
        )
    ]


def _verdict(holds: list[bool], tasks: int) -> str:
    """The verdict on a claim about so many `tasks`; `holds` says on which of the tasks that were run it holds."""
    if not holds or (all(holds) and len(holds) < tasks):
        return "open"
    return "yes" if all(holds) else "partly" if any(holds) else "no"


def _means_and_ranges(by_task: Scores) -> str:
    """For example "ant 0.69 (0.65 to 0.74)": the mean over seeds, the lowest and the highest seed."""
    parts = [
        f"{'' if target else task} {seeds.mean():.2f} ({seeds.min():.2f} to {seeds.max():.2f})".strip()
        for (task, target), seeds in by_task.items()
    ]
    return ", ".join(parts) or "not run"


def _on_common_tasks(ours: Scores, theirs: Scores) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """The scores of both on the tasks that both were run on."""
    common = [task for task in ours if task in theirs]
    return [ours[task] for task in common], [theirs[task] for task in common]


def _grand_mean(tasks: list[np.ndarray]) -> float:
    return float(np.mean([seeds.mean() for seeds in tasks]))


def _as_well(text: str, ours: Scores, theirs: Scores, tasks: int) -> Claim:
    """Holds if the whole interval of the difference lies above `-EQUAL`; "unclear" if only a part does."""
    sides = _on_common_tasks(ours, theirs)
    if not sides[0]:
        return Claim(text, "as well", "not run", "open")
    gap = difference(*sides)
    here = f"{_grand_mean(sides[0]):.2f} against {_grand_mean(sides[1]):.2f}; difference {gap.value:+.2f} "
    here += f"[{gap.low:+.2f}, {gap.high:+.2f}]"
    if gap.low < -EQUAL <= gap.high:
        return Claim(text, "as well", here, "unclear")
    return Claim(text, "as well", here, _verdict([gap.low >= -EQUAL] * len(sides[0]), tasks))


def _better(text: str, ours: Scores, theirs: Scores, tasks: int) -> Claim:
    """Holds if the mean is higher and the whole interval of the probability of improvement lies above a half."""
    sides = _on_common_tasks(ours, theirs)
    if not sides[0]:
        return Claim(text, "better", "not run", "open")
    our_mean, their_mean = map(_grand_mean, sides)
    chance = probability_of_improvement(*sides)
    here = f"{our_mean:.2f} against {their_mean:.2f}; better with probability {chance.value:.2f} "
    here += f"[{chance.low:.2f}, {chance.high:.2f}]"
    holds = chance.low > 0.5 and our_mean > their_mean
    return Claim(text, "better", here, _verdict([holds] * len(sides[0]), tasks))


class Improvement(NamedTuple):
    """The probability that a seed of one method scores above a seed of another.

    Attributes:
      kind: "imitation" or "transfer".
      ours, theirs: titles of the two methods.
      chance: the probability, a mean over the tasks that both were run on.
      tasks: how many tasks these are.
    """

    kind: str
    ours: str
    theirs: str
    chance: Estimate
    tasks: int


def improvements(results_of: dict[str, list[Result]]) -> list[Improvement]:
    """The probability that EAIRL, and its separable form, score above every other method."""
    compared = []
    for experiment, name, rule in (
        ("table2", "eairl-sa", None),
        ("table1", "eairl-sa", "last"),
        ("table1", "eairl-separable", "last"),
    ):
        kind, chosen = (
            ("transfer", results.transfers(results_of[experiment])) if rule else ("imitation", results_of[experiment])
        )
        ours = scores(chosen, name, rule)
        for other in dict.fromkeys(result.name for result in chosen):
            sides = _on_common_tasks(ours, scores(chosen, other, rule))
            if other != name and sides[0]:
                chance = probability_of_improvement(*sides)
                titles = results.title(name), results.title(other)
                compared.append(Improvement(kind, *titles, chance, len(sides[0])))
    return compared
