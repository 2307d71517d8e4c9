"""What the paper claims, judged by the results on disk."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from experiments import results
from experiments.aggregate import probability_of_improvement

EQUAL = 0.05  # of normalised score: closer than this counts as the same
HOLDS = ("yes", "no", "partly", "open")
Scores = dict[tuple[str, str | None], np.ndarray]  # (task, target) -> normalised scores [seeds]


def scores(rows: list[dict], row: str, rule: str | None = None) -> Scores:
    """The normalised scores of a row, for each task or pair of tasks that it was run on."""
    return {(each["task"], each["target"]): results.normalized(each) for each in rows
            if each["row"] == row and each.get("rule") == rule}  # fmt: skip


def _common(ours: Scores, theirs: Scores) -> list[tuple[np.ndarray, np.ndarray]]:
    """The scores of two rows on each task that both were run on."""
    return [(ours[task], theirs[task]) for task in ours if task in theirs]


class Claim(NamedTuple):
    """A statement of the paper (or ours), what was found, and whether it holds: one of `HOLDS`."""

    text: str
    paper: str
    here: str
    holds: str


def claims(found: dict[str, list[dict]]) -> list[Claim]:
    """What the paper claims, judged by fixed thresholds on whatever results there are."""
    imitated, moved, ablated = found["table2"], found["table1"], found["ablations"]
    mazes, ants = ([row for row in results.moved(moved) if row["task"].startswith(name)]
                   for name in ("point_maze", "ant"))  # fmt: skip
    eairl = scores(imitated, "eairl-sa")
    said = []
    for text, theirs, own in (
        ("EAIRL imitates", "0.65 to 0.99 of the expert", eairl),
        ("Ours: so it does with settings that were tuned", "", scores(imitated, "eairl-sa+tuned")),
    ):
        each = ", ".join(f"{task} {s.mean():.2f}" for (task, _), s in own.items())
        said.append(Claim(text, theirs, each or "not run", _all(s.mean() >= 0.95 for s in own.values())))
    said.append(_compared("EAIRL imitates as well as GAIL", "as well", eairl, scores(imitated, "gail-sa")))
    said.append(_compared("EAIRL imitates as well as AIRL(s,a)", "as well", eairl, scores(imitated, "airl_sa-sa")))
    said.append(_compared("EAIRL imitates better than AIRL(s)", "better", eairl, scores(imitated, "airl_s-s")))
    said.append(_compared("EAIRL imitates better than GAN-GCL", "better", eairl, scores(imitated, "gan_gcl-sa")))
    for place, rows, aim, theirs in (("the other maze", mazes, 0.9, "-7.01 of -4.98"),
                                     ("the crippled ant", ants, 0.81, "0.81 of the expert")):  # fmt: skip
        own, airl_s, airl_sa = (scores(rows, row, "last") for row in ("eairl-sa", "airl_s-s", "airl_sa-sa"))
        said.append(Claim(f"EAIRL's reward r(s,a) transfers to {place}", theirs, _list(own),
                          _all(s.mean() >= aim for s in own.values())))  # fmt: skip
        said.append(_compared(f"There it is better than AIRL(s)'s ({place})", "better", own, airl_s))
        said.append(_compared(f"There it is better than AIRL(s,a)'s ({place})", "better", own, airl_sa))
        separable = scores(rows, "eairl-separable", "last")
        said.append(Claim(f"Ours: a separable reward transfers to {place}", "", _list(separable),
                          _all(s.min() >= 0.9 for s in separable.values())))  # fmt: skip
    full = scores(mazes, "eairl-sa", "last")
    said.append(_compared("Empowerment's Phi is what makes it transfer (against Phi = 0)", "better",
                          full, scores(ablated, "eairl-sa+shaping=none", "last")))  # fmt: skip
    return said


def _all(conditions) -> str:
    held = list(conditions)
    if not held:
        return "open"
    return "yes" if all(held) else "partly" if any(held) else "no"


def _list(own: Scores) -> str:
    return ", ".join(f"{s.mean():.2f}" for s in own.values()) or "not run"


def _compared(text: str, claimed: str, ours: Scores, theirs: Scores) -> Claim:
    both = _common(ours, theirs)
    if not both:
        return Claim(text, claimed, "not run", "open")
    mine, other = (float(np.mean([own.mean() for own in side])) for side in zip(*both, strict=True))
    chance = probability_of_improvement(*zip(*both, strict=True))
    held = mine >= other - EQUAL if claimed == "as well" else chance.low > 0.5 and mine > other
    here = f"{mine:.2f} against {other:.2f}; better with probability {chance.value:.2f} "
    return Claim(text, claimed, f"{here}[{chance.low:.2f}, {chance.high:.2f}]", "yes" if held else "no")


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
