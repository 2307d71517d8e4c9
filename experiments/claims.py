"""What the paper claims, judged by the results on disk."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from experiments import results
from experiments.aggregate import probability_of_improvement
from experiments.reproduce import EXPERIMENTS

EQUAL = 0.05  # of normalised score: closer than this counts as the same
HOLDS = ("yes", "no", "partly", "open")
Scores = dict[tuple[str, str | None], np.ndarray]  # (task, target) -> normalised scores [seeds]


def scores(rows: list[dict], row: str, rule: str | None = None) -> Scores:
    """The normalised scores of a row, for each task or pair of tasks that it was run on."""
    return {(each["task"], each["target"]): results.normalized(each) for each in rows
            if each["row"] == row and each.get("rule") == rule}  # fmt: skip


def planned(row: str, rule: str | None = None, source: str = "") -> int:
    """The tasks, or pairs of them from such a source, that a row is meant to be run on."""
    entries = EXPERIMENTS["table1" if rule else "table2"]
    return len({(entry.task, entry.target) for entry in entries
                if entry.row == row and entry.task != entry.target and entry.task.startswith(source)
                and rule in (None, entry.rule)})  # fmt: skip


def _common(ours: Scores, theirs: Scores) -> list[tuple[np.ndarray, np.ndarray]]:
    """The scores of two rows on each task that both were run on."""
    return [(ours[task], theirs[task]) for task in ours if task in theirs]


class Claim(NamedTuple):
    """A statement of the paper (or ours, and nothing of the paper), what was found, and whether it holds (`HOLDS`)."""

    text: str
    paper: str
    here: str
    holds: str


def claims(found: dict[str, list[dict]]) -> list[Claim]:
    """What the paper claims, judged by fixed thresholds on whatever results there are."""
    imitated, moved, ablated = found["table2"], found["table1"], found["ablations"]
    eairl = scores(imitated, "eairl-sa")
    said = []
    for text, theirs, row in (
        ("EAIRL imitates", "0.65 to 0.99 of the expert", "eairl-sa"),
        ("Ours: so it does with settings that were tuned", "", "eairl-sa+tuned"),
    ):
        own = scores(imitated, row)
        each = ", ".join(f"{task} {s.mean():.2f}" for (task, _), s in own.items()) or "not run"
        said.append(Claim(text, theirs, each, _all([s.mean() >= 0.95 for s in own.values()], planned(row))))
    for name, row, claimed in (("GAIL", "gail-sa", "as well"), ("AIRL(s,a)", "airl_sa-sa", "as well"),
                               ("AIRL(s)", "airl_s-s", "better"), ("GAN-GCL", "gan_gcl-sa", "better")):  # fmt: skip
        text = f"EAIRL imitates {'as well as' if claimed == 'as well' else 'better than'} {name}"
        said.append(_compared(text, claimed, eairl, scores(imitated, row), planned(row)))
    in_every_maze = [("0.9 of the expert in every seed", np.min, 0.9)]
    crippled = [("0.81 of the expert, as the paper's EAIRL", np.mean, 0.81), ("0.95 of it in every seed", np.min, 0.95)]
    for place, source, aim, theirs, ours in (
        ("the other maze", "point_maze", 0.9, "-7.01 of -4.98", in_every_maze),
        ("the crippled ant", "ant", 0.81, "0.81 of the expert", crippled),
    ):
        rows = [row for row in results.moved(moved) if row["task"].startswith(source)]
        own, separable = (scores(rows, row, "last") for row in ("eairl-sa", "eairl-separable"))
        tasks = planned("eairl-sa", "last", source)
        said.append(Claim(f"EAIRL's reward r(s,a) transfers to {place}", theirs, _list(own),
                          _all([s.mean() >= aim for s in own.values()], tasks)))  # fmt: skip
        for name, row in (("AIRL(s)", "airl_s-s"), ("AIRL(s,a)", "airl_sa-sa")):
            other = scores(rows, row, "last")
            said.append(_compared(f"There it is better than {name}'s ({place})", "better", own, other, tasks))
        for level, of_seeds, least in ours:
            said.append(Claim(f"Ours: a separable reward transfers to {place}, {level}", "", _range(separable),
                              _all([of_seeds(s) >= least for s in separable.values()], tasks)))  # fmt: skip
    mazes = [row for row in results.moved(moved) if row["task"].startswith("point_maze")]
    full = scores(mazes, "eairl-sa", "last")
    said.append(_compared("Empowerment's Phi is what makes it transfer (against Phi = 0)", "better",
                          full, scores(ablated, "eairl-sa+shaping=none", "last"), 1))  # fmt: skip
    return said


def _all(held: list[bool], tasks: int) -> str:
    """Of a claim that is about so many `tasks`: it stays open while it holds on those that were run."""
    if not held or (all(held) and len(held) < tasks):
        return "open"
    return "yes" if all(held) else "partly" if any(held) else "no"


def _list(own: Scores) -> str:
    return ", ".join(f"{s.mean():.2f}" for s in own.values()) or "not run"


def _range(own: Scores) -> str:
    return ", ".join(f"{s.mean():.2f} ({s.min():.2f} to {s.max():.2f})" for s in own.values()) or "not run"


def _compared(text: str, claimed: str, ours: Scores, theirs: Scores, tasks: int) -> Claim:
    both = _common(ours, theirs)
    if not both:
        return Claim(text, claimed, "not run", "open")
    mine, other = (float(np.mean([own.mean() for own in side])) for side in zip(*both, strict=True))
    chance = probability_of_improvement(*zip(*both, strict=True))
    held = mine >= other - EQUAL if claimed == "as well" else chance.low > 0.5 and mine > other
    here = f"{mine:.2f} against {other:.2f}; better with probability {chance.value:.2f} "
    return Claim(text, claimed, f"{here}[{chance.low:.2f}, {chance.high:.2f}]", _all([held] * len(both), tasks))


def improvements(found: dict[str, list[dict]]) -> list[dict]:
    """Probability that EAIRL, and its separable form, score above every other row."""
    compared = []
    for experiment, row, rule in (("table2", "eairl-sa", None), ("table1", "eairl-sa", "last"),
                                  ("table1", "eairl-separable", "last")):  # fmt: skip
        rows = results.moved(found[experiment]) if rule else found[experiment]
        ours = scores(rows, row, rule)
        for other in dict.fromkeys(each["row"] for each in rows):
            both = _common(ours, scores(rows, other, rule))
            if other != row and both:
                chance = probability_of_improvement(*zip(*both, strict=True))
                compared.append({"what": "imitation" if rule is None else "transfer", "ours": results.name(row),
                                 "theirs": results.name(other), "chance": chance,
                                 "tasks": len(both)})  # fmt: skip
    return compared
