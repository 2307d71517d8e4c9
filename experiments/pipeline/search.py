"""The trials of `eairl search`: Optuna proposes a generation, one program trains it, and its scores are written.

`search.db` holds the finished trials, and no others. What is proposed next follows from them and from the seed alone.
So a search that was killed proposes the same generation again, whose training goes on from its last checkpoint.
"""

from __future__ import annotations

import contextlib
import dataclasses
import sqlite3
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from eairl_jax import Diverged, InputError
from eairl_jax.experiments.display.console import say
from eairl_jax.experiments.pipeline import points
from eairl_jax.experiments.pipeline.experiment import Experiment
from eairl_jax.experiments.pipeline.points import Point
from eairl_jax.experiments.pipeline.ranges import Domain, Interval, rounded
from eairl_jax.experiments.pipeline.run import run as run_experiment
from eairl_jax.experiments.pipeline.run_folder import LOCK, locked, refuse_different
from eairl_jax.extras import required

DATABASE, STUDY = "search.db", "search"
GENERATION = "generation-"
# What a search writes into its folder, by the beginnings of the names.
WRITTEN = (GENERATION, "search.", "index.html", LOCK)
SETTINGS, RETURNS = "settings", "true_returns"


@dataclass(frozen=True)
class Plan:
    """How to search.

    Attributes:
      domains: what the value of each searched setting is chosen from.
      trials: how many settings are tried; a multiple of `generation`.
      generation: trials that are proposed together, and trained side by side.
      seed: of the proposals.

    Raises:
      InputError: for an impossible number of trials.
    """

    domains: dict[str, Domain]
    trials: int
    generation: int
    seed: int

    def __post_init__(self):
        if self.generation < 1:
            raise InputError(f"--generation {self.generation}: expected at least 1 trial")
        if self.trials < 1 or self.trials % self.generation:
            near = max(1, self.trials // self.generation) * self.generation
            raise InputError(
                f"--trials {self.trials}: expected a multiple of --generation {self.generation}, the trials that one "
                f"program trains side by side, for example --trials {near}"
            )


class Trial(NamedTuple):
    """A setting that was tried.

    Attributes:
      number: from 0, in the order of the proposals.
      point: the values of the searched settings.
      returns: true return of each seed; empty if a seed has diverged.
      score: the mean of the returns, from 0 for random actions to 1 for the expert where the expert is known. None if
        a seed has diverged: such a setting counts as worse than any other.
    """

    number: int
    point: Point
    returns: list[float]
    score: float | None


def settings(experiment: Experiment, plan: Plan) -> dict[str, Any]:
    """What makes a search different from any other. More trials are the same search."""
    domains = {name: str(domain) for name, domain in plan.domains.items()}
    return experiment.settings() | {"search": domains, "generation": plan.generation}


def search(experiment: Experiment, plan: Plan, out: Path, command_line: str = "") -> list[Trial]:
    """Runs a search to its end, or goes on with it.

    Args:
      experiment: without points (`experiment.searched`).
      out: folder of the search. Each generation is a sweep in a folder of its own in it.

    Returns:
      All trials in the folder, in the order of their numbers.

    Raises:
      InputError: if Optuna is not installed, if `out` belongs to something else, or if it cannot be written.
    """
    load_optuna()
    with locked(out):
        database = Database(out / DATABASE, settings(experiment, plan))
        while (done := len(database.finished())) < plan.trials:
            number = done // plan.generation
            first = number * plan.generation
            proposals = proposed(plan, database.finished()[:first], number)
            swept = dataclasses.replace(experiment, points=tuple(proposals))
            say(
                f"generation {number + 1} of {plan.trials // plan.generation}: {'; '.join(map(points.name, proposals))}"
            )
            returns = _returns(swept, generation_folder(out, number), command_line)
            for trial in range(done - first, plan.generation):  # a kill may have come after some of them
                score = _score(experiment, returns[trial])
                database.add(plan, Trial(first + trial, proposals[trial], returns[trial], score))
        return [_trial(each, plan) for each in database.finished()]


def load_optuna() -> ModuleType:
    """The library, which prints warnings alone from then on.

    Raises:
      InputError: if it is not installed.
    """
    optuna = required("optuna", "search")
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


def generation_folder(out: Path, number: int) -> Path:
    """The folder of a generation, `number` from 0."""
    return out / f"{GENERATION}{number:03d}"


def proposed(plan: Plan, finished: Sequence[Any], number: int) -> list[Point]:
    """The points of a generation; the same arguments give the same points.

    Args:
      finished: Optuna's trials of all generations before.
      number: of the generation, from 0.
    """
    optuna, distributions = load_optuna(), _distributions(plan)
    seed = int(np.random.SeedSequence((plan.seed, number)).generate_state(1)[0])
    study = optuna.create_study(direction="maximize", sampler=optuna.samplers.TPESampler(seed=seed))
    study.add_trials(finished)
    asked = [study.ask(distributions).params for _ in range(plan.generation)]
    return [{name: rounded(params[name]) for name in plan.domains} for params in asked]


def best(trials: Sequence[Trial]) -> list[Trial]:
    """The trials that have a score, the best first."""
    return sorted((trial for trial in trials if trial.score is not None), key=lambda trial: -(trial.score or 0.0))


def _distributions(plan: Plan) -> dict[str, Any]:
    kinds = load_optuna().distributions
    return {
        name: kinds.FloatDistribution(domain.low, domain.high, log=domain.is_log)
        if isinstance(domain, Interval)
        else kinds.CategoricalDistribution(domain.values)
        for name, domain in plan.domains.items()
    }


def _returns(experiment: Experiment, path: Path, command_line: str) -> list[list[float]]:
    """True returns of each point's seeds; none for a point of which a seed has diverged."""
    try:
        result = run_experiment(experiment, path, command_line)
    except Diverged as e:  # the others go on without a seed that diverges, so none is left
        say(f"no trial of this generation has a score: {e}")
        return [[] for _ in experiment.points]
    return [each.tolist() if len(each) == len(experiment.seeds) else [] for each in result.returns_by_point]


def _score(experiment: Experiment, returns: list[float]) -> float | None:
    if not returns:
        return None
    mean = float(np.mean(returns))
    normalized = experiment.source.reference.normalized(mean)
    return mean if normalized is None else normalized


class Database:
    """The finished trials of a search, as a study of Optuna in SQLite.

    Args:
      path: of the file, made if there is none.
      settings: everything that makes this search different from any other; JSON values.

    Raises:
      InputError: if the folder is that of another search or of something else, or if the file is damaged.
    """

    def __init__(self, path: Path, settings: dict[str, Any]):
        optuna, self.path = load_optuna(), path
        if not path.exists() and any(not each.name.startswith(WRITTEN) for each in path.parent.iterdir()):
            raise InputError(
                f"{path.parent} holds files but no {path.name}, so it is no search's folder: choose another with --out"
            )
        with self._told():
            # A URL would give some characters of a path a meaning.
            storage = optuna.storages.RDBStorage("sqlite://", engine_kwargs={"creator": lambda: sqlite3.connect(path)})
            self._study = optuna.create_study(
                storage=storage, study_name=STUDY, direction="maximize", load_if_exists=True
            )
            if SETTINGS not in self._study.user_attrs:
                self._study.set_user_attr(SETTINGS, settings)
            before = self._study.user_attrs[SETTINGS]
        refuse_different(path.parent, before, settings)

    def finished(self) -> list[Any]:
        """Optuna's trials, in the order of their numbers."""
        with self._told():
            return self._study.get_trials(deepcopy=False)

    def add(self, plan: Plan, trial: Trial) -> None:
        """Adds a trial, whole or not at all."""
        of_optuna = load_optuna().trial
        states = of_optuna.TrialState
        with self._told():
            self._study.add_trial(
                of_optuna.create_trial(
                    state=states.PRUNED if trial.score is None else states.COMPLETE,
                    value=trial.score,
                    params=trial.point,
                    distributions=_distributions(plan),
                    user_attrs={RETURNS: trial.returns},
                )
            )

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        """Turns an error of the database into one message."""
        of_optuna, of_sql = load_optuna().exceptions.OptunaError, required("sqlalchemy.exc", "search").SQLAlchemyError
        try:
            yield
        except (of_optuna, of_sql, sqlite3.Error) as e:
            cause = " ".join(str(e.__cause__ or e).split())
            raise InputError(
                f"{self.path} cannot be used ({cause}): if it is damaged, remove it and repeat the command; it is made "
                f"again from the {GENERATION} folders beside it"
            ) from None


def _trial(each: Any, plan: Plan) -> Trial:
    point = {name: each.params[name] for name in plan.domains}
    return Trial(each.number, point, each.user_attrs[RETURNS], each.value)
