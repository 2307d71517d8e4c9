"""What a run ends with: the record behind `summary.json`, and behind every line of a table."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from eairl_jax import InputError


class Reference(NamedTuple):
    """The two true returns that a score is normalised by.

    Attributes:
      expert: mean return of the demonstrator.
      random: mean return of uniformly random actions.
    """

    expert: float
    random: float

    def normalized(self, returns):
        """Returns, a number or an array, on a scale from 0 for random actions to 1 for the expert."""
        return (returns - self.random) / (self.expert - self.random)


@dataclass(frozen=True, kw_only=True)
class Result:
    """The score of one experiment, seed by seed, with everything that it depends on.

    Attributes:
      name: method, reward form and variant, for example "eairl-separable+lambda_i=0.1".
      method: key of `METHODS`, or "bc".
      task: the task that was demonstrated.
      target: the task in which the reward is used; None for an imitation.
      rule: from which iteration the reward is taken; None for an imitation.
      seeds: numbers of the seeds.
      returns: mean true return of each seed's policy.
      expert, random: see `Reference`; of the target, if there is one.
      env_steps: environment steps of each policy that was scored.
      compile_seconds, run_seconds: of learning and retraining together.
      peak_memory_gb: of the process that finished the run.
      command_line: what was typed.
      is_published: whether the paper has a figure for exactly this method and form.
      settings: what makes the learning of this experiment different from any other.
      points: of a sweep, the swept values of each point; `returns` then holds the seeds of one point after another.
      imitation_returns: true return, in the source, of the policy that learned each seed's reward.
      chosen_iterations: iteration of each seed's reward.
      ceiling: true return of each seed's policy trained on the true reward under the same budget.
      learned_rewards: of a transfer, mean learned reward a step of each seed's kept policy in the target. It says how
        well the training did on the reward that it was given.
      snapshots, source_returns: of `source_retrain`, the iterations it compared, and `[snapshots, seeds]` true
        returns in the source.
      retrain_settings: how policies were trained in the target.
      saturated_lanes: lanes whose discriminator was right about nearly everything in most iterations.
      closeness: distances between the learned and the true reward, by task (`paper.reward_distance`).
      curve: true return while training: {"env_steps": [points], "true_return": [seeds][points]}.
      machine: versions and devices (`run_folder.machine`).
    """

    name: str
    method: str
    task: str
    target: str | None = None
    rule: str | None = None
    seeds: list[int]
    returns: list[float]
    expert: float
    random: float
    env_steps: int
    compile_seconds: float
    run_seconds: float
    peak_memory_gb: float
    command_line: str
    is_published: bool
    settings: dict[str, Any]
    points: list[dict[str, float]] = field(default_factory=list)
    imitation_returns: list[float] = field(default_factory=list)
    chosen_iterations: list[int] = field(default_factory=list)
    ceiling: list[float] = field(default_factory=list)
    learned_rewards: list[float] = field(default_factory=list)
    snapshots: list[int] = field(default_factory=list)
    source_returns: list[list[float]] = field(default_factory=list)
    retrain_settings: dict[str, Any] | None = None
    saturated_lanes: list[str] = field(default_factory=list)
    closeness: dict[str, dict] | None = None
    curve: dict[str, list] | None = None
    machine: dict[str, Any] | None = None

    @property
    def reference(self) -> Reference:
        """What the scores are normalised by."""
        return Reference(self.expert, self.random)

    @property
    def mean(self) -> float:
        """Mean true return over the seeds."""
        return float(np.mean(self.returns))

    @property
    def std(self) -> float:
        """Standard deviation of the true return over the seeds."""
        return float(np.std(self.returns))

    @property
    def normalized(self) -> float:
        """The mean return, 0 for random actions and 1 for the expert."""
        return self.reference.normalized(self.mean)

    @property
    def scores(self) -> np.ndarray:
        """Each seed's normalised return `[seeds]`."""
        return self.reference.normalized(np.array(self.returns))

    @property
    def identity(self) -> tuple[str, str, str | None, str | None]:
        """What tells this result from every other of the same experiment: a new one takes its place."""
        return self.name, self.task, self.target, self.rule

    def to_json(self) -> dict[str, Any]:
        """The content of `summary.json`: all fields that are set, and mean, std and normalised score."""
        content = {name: value for name, value in dataclasses.asdict(self).items() if value not in (None, [])}
        return content | {"mean": self.mean, "std": self.std, "normalized": self.normalized}

    @classmethod
    def from_json(cls, content: dict[str, Any], where: str) -> Result:
        """Reads what `to_json` gave.

        Args:
          where: what to call the content in an error message.

        Raises:
          InputError: if a field is missing.
        """
        fields = dataclasses.fields(cls)
        needed = [f.name for f in fields if f.default is f.default_factory is dataclasses.MISSING]
        missing = [name for name in needed if name not in content]
        if missing:
            raise InputError(f"{where} lacks {', '.join(missing)}: repeat the command that wrote it")
        return cls(**{f.name: content[f.name] for f in fields if f.name in content})
