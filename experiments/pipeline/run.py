"""`run(experiment, out) -> Result`: from demonstrations to a score, or on from where an interrupted run stopped.

A `Result` is the record behind `summary.json`, and behind every line of a table.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from eairl_jax import InputError, LearnedReward, load_reward, processes, save_reward, schema, storage
from eairl_jax.envs.names import file_name
from eairl_jax.experiments.display import planar
from eairl_jax.experiments.display.plots import Curve, plot, plot_sweep
from eairl_jax.experiments.pipeline import (
    divergence,
    more_seeds,
    points,
    policies,
    records,
    retraining,
    run_page,
    stages,
)
from eairl_jax.experiments.pipeline.experiment import Experiment, Use
from eairl_jax.experiments.pipeline.places import Reference, Target
from eairl_jax.experiments.pipeline.run_folder import RunFolder, machine, peak_memory_gb, settings_digest
from eairl_jax.experiments.pipeline.train import Lane, scores
from eairl_jax.methods import with_method_defaults


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
      expert, random: see `Reference`; of the target, if there is one. `expert` is None if it is unknown.
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
      learned_share: the same on a scale from 0 for random actions to 1 for the best known behaviour, which is one of
        the seed's policies, the demonstrations of the target, or a plan (`retraining.Worth`).
      snapshots, source_returns: of `source_retrain`, the iterations it compared, and `[snapshots, seeds]` true
        returns in the source; None where no episode ended.
      retrain_settings: how policies were trained in the target.
      saturated_lanes: lanes whose discriminator was right about nearly everything in most iterations.
      closeness: distances between the learned and the true reward, by task (`paper.reward_distance`).
      diagnosis: of a transfer, other behaviours judged by the learned reward (`diagnosis.Diagnosis.to_json`).
      more_iterations: how far the training went beyond its plan, at its final rates (`--more`).
      curve: true return while training: {"env_steps": [points], "true_return": [seeds][points]}.
      machine: versions and devices (`run_folder.machine`).
      dropped: what was dropped because a value was not finite, and why (`divergence.entry`): seeds, which are then not
        among `seeds`; of a sweep the seeds of single points, which then have no return. Every list and mean is of the
        rest.
      ceiling_dropped: the same of the ceiling.
    """

    name: str
    method: str
    task: str
    target: str | None = None
    rule: str | None = None
    seeds: list[int]
    returns: list[float]
    expert: float | None
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
    learned_share: list[float] = field(default_factory=list)
    snapshots: list[int] = field(default_factory=list)
    source_returns: list[list[float | None]] = field(default_factory=list)
    retrain_settings: dict[str, Any] | None = None
    saturated_lanes: list[str] = field(default_factory=list)
    closeness: dict[str, dict] | None = None
    diagnosis: dict[str, Any] | None = None
    more_iterations: int | None = None
    curve: dict[str, list] | None = None
    machine: dict[str, Any] | None = None
    dropped: list[dict[str, Any]] = field(default_factory=list)
    ceiling_dropped: list[dict[str, Any]] = field(default_factory=list)

    @property
    def returns_by_point(self) -> list[np.ndarray]:
        """Of a sweep, the returns of each point; a dropped seed has none."""
        of_points = points.returns(self.points, self.seeds, self.returns, self.dropped)
        return [np.array(values) for values in of_points]

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
    def normalized(self) -> Any:
        """The mean return, 0 for random actions and 1 for the expert; None if the expert's return is unknown."""
        return self.reference.normalized(self.mean)

    @property
    def scores(self) -> Any:
        """Each seed's normalised return `[seeds]`; None if the expert's return is unknown."""
        return self.reference.normalized(np.array(self.returns))

    @property
    def trained_seeds(self) -> set[int]:
        """The seeds that have returns, and those that were dropped."""
        return {*self.seeds, *(each["seed"] for each in self.dropped)}

    @property
    def count(self) -> int:
        """How many seeds were trained; a dropped one counts."""
        return len(self.trained_seeds)

    def has(self, seeds: range) -> bool:
        """Whether the result holds all these seeds, as returns or as dropped ones."""
        return set(seeds) <= self.trained_seeds

    def joined(self, other: Result) -> Result:
        """This result and the seeds of another one of the same imitation."""
        return dataclasses.replace(
            self,
            seeds=self.seeds + other.seeds,
            returns=self.returns + other.returns,
            dropped=self.dropped + other.dropped,
            saturated_lanes=self.saturated_lanes + other.saturated_lanes,
            compile_seconds=self.compile_seconds + other.compile_seconds,
            run_seconds=self.run_seconds + other.run_seconds,
            peak_memory_gb=max(self.peak_memory_gb, other.peak_memory_gb),
        )

    @property
    def identity(self) -> tuple[str, str, str | None, str | None]:
        """What tells this result from every other of the same experiment: a new one takes its place."""
        return self.name, self.task, self.target, self.rule

    def to_json(self) -> dict[str, Any]:
        """The content of `summary.json`: all fields that are set, and mean, std and normalised score."""
        content = {name: value for name, value in dataclasses.asdict(self).items() if value not in (None, [])}
        content |= {"expert": self.expert}
        return content | {"mean": self.mean, "std": self.std, "normalized": self.normalized}

    @classmethod
    def from_json(cls, content: dict[str, Any], where: str) -> Result:
        """Reads what `to_json` gave.

        Args:
          where: what to call the content in an error message.

        Raises:
          InputError: if a field is missing, or has another type or length.
        """
        fields, advice = dataclasses.fields(cls), "repeat the command that wrote it"
        needed = [f.name for f in fields if f.default is f.default_factory is dataclasses.MISSING]
        missing = [name for name in needed if name not in content]
        if missing:
            raise InputError(f"{where} lacks {', '.join(missing)}: {advice}")
        content = storage.check(content, schema.record({}, _result_fields()), where, advice)
        result = cls(**{f.name: content[f.name] for f in fields if f.name in content})
        expected = len(result.seeds) * max(1, len(result.points))
        if result.points:
            storage.check({"dropped": result.dropped}, records.DROPPED, where, advice)
            lanes = [point | {"seed": seed} for point in result.points for seed in result.seeds]
            expected = sum(not any(divergence.matches(each, lane) for each in result.dropped) for lane in lanes)
        if not result.seeds or len(result.returns) != expected:
            raise InputError(f"{where} holds {len(result.returns)} returns, expected {expected}: {advice}")
        if result.expert is not None and result.expert == result.random:
            raise InputError(f"{where}: expert and random actions have one return, {result.random:g}: {advice}")
        uneven = result.uneven_lists()
        if uneven:
            raise InputError(f"{where}: {uneven} has another length than the lists beside it: {advice}")
        return result

    def uneven_lists(self) -> str:
        """The name of a list that is shorter or longer than it must be; empty if there is none."""
        curve = self.curve or {"env_steps": [], "true_return": []}
        if any(len(values) != len(curve["env_steps"]) for values in curve["true_return"]):
            return "curve.true_return"
        for place, measures in (self.closeness or {}).items():
            for name, values in measures.items():
                if len(values) != len(self.seeds):
                    return f"closeness.{place}.{name}"
        return ""


@functools.cache
def _result_fields() -> dict[str, schema.Schema]:
    """The schema of each field of `Result` that may stand in a file."""
    measures = schema.table_of(schema.list_of(schema.optional(schema.number())))
    curve = {
        "env_steps": schema.list_of(schema.whole(0)),
        "true_return": schema.list_of(schema.list_of(schema.optional(schema.number()))),
    }
    return schema.of_fields(Result) | {
        "seeds": schema.list_of(schema.whole(0, schema.LARGEST_SEED), low=1),
        "closeness": schema.optional(schema.record({"source": measures, "target": measures})),
        "curve": schema.optional(schema.record(curve)),
    }


def run(experiment: Experiment, out: Path, command_line: str = "") -> Result:
    """Runs an experiment to its end, or goes on with it, or reads the result that it has.

    A result of fewer iterations or seeds than the experiment has (`Recipe.more`, `Experiment.more_seeds`) is extended.

    Args:
      out: folder of the experiment. A transfer shares its learning, and its ceiling, with other transfers through
        folders beside `out`.
      command_line: what the user typed, for the record.

    Raises:
      InputError: if `out` belongs to a different run, or cannot be written, or if the memory is too small.
      Diverged: when a metric is no longer finite.
    """
    team = processes.current()
    if team and experiment.more_seeds:  # they are trained after the others, and the error would come late
        processes.check_lanes(experiment.more_seeds, len(team.devices))
    if not team and not (out / "summary.json").exists():  # before the folder is made
        stages.learner(experiment)[1].check_memory()
    folder = RunFolder(out, experiment.settings(), experiment.track)
    content, more = folder.summary(), experiment.recipe.more
    result = None if content is None else Result.from_json(content, f"{folder.path}/summary.json")
    if result is None or (result.more_iterations or 0) < more:
        folder.prepare()
        result = _transfer(experiment, experiment.use, folder) if experiment.use else _imitate(experiment, folder)
        result = dataclasses.replace(result, command_line=command_line, machine=machine(), more_iterations=more or None)
        run_page.forget(folder.path)
        folder.write_summary(result.to_json())
    if not experiment.points and not experiment.use:
        result = _with_more_seeds(experiment, folder, result, command_line)
    if not folder.is_writable():  # a finished run, read from a place where nobody may write
        return result
    if not (folder.path / "curves.png").exists():
        _draw(experiment, folder, result)
    if not (folder.path / "reward.png").exists():
        _draw_reward(folder.path, experiment)
    if not experiment.points and not (experiment.use and experiment.use.rule.kind == "policy"):
        policies.keep(folder.path)
    if not (folder.path / run_page.PAGE).exists():
        run_page.write(folder.path)
    return result


def _imitate(experiment: Experiment, folder: RunFolder) -> Result:
    """Learns in the source and scores the policies that learned; of a sweep, those of every point."""
    algorithm, state, returns = stages.learn_and_score(folder, experiment)
    kept = divergence.kept(folder, stages.lanes_of(experiment))
    if experiment.has_reward and not experiment.points:
        save_reward(folder.path / "reward", _last_reward(experiment, folder))
    if experiment.points:
        policies.keep_points(folder.path, experiment, algorithm, state, kept)
    return dataclasses.replace(
        _result(experiment, folder, returns[kept], experiment.source.reference),
        env_steps=experiment.recipe.env_steps,
        points=list(experiment.points),
        saturated_lanes=stages.saturated_lanes(folder, experiment),
        **folder.seconds(),
    )


def _last_reward(experiment: Experiment, folder: RunFolder) -> LearnedReward:
    """The rewards with which the learning ended, of the seeds that were not dropped."""
    last = stages.snapshot_path(folder, experiment.recipe.last_iteration)
    return stages.of_kept(load_reward(last), divergence.kept_seeds(folder))


def _with_more_seeds(experiment: Experiment, folder: RunFolder, result: Result, command_line: str) -> Result:
    """The result with the seeds that were added to the run; those that are asked for and missing are trained."""
    recipe = dataclasses.replace(experiment.recipe, more=result.more_iterations or 0)
    groups = more_seeds.groups(folder.path, experiment.seeds, experiment.more_seeds)
    folders = [more_seeds.folder(folder.path, group) for group in groups]
    others = [
        run(dataclasses.replace(experiment, recipe=recipe, seeds=group, more_seeds=0), path, command_line)
        for group, path in zip(groups, folders, strict=True)
    ]
    if all(result.has(group) for group in groups):
        return result
    for group, other in zip(groups, others, strict=True):
        result = result if result.has(group) else result.joined(other)
    if experiment.has_reward:
        own = _last_reward(dataclasses.replace(experiment, recipe=recipe), folder)
        rewards = [own, *(load_reward(path / "reward") for path in folders)]
        save_reward(folder.path / "reward", more_seeds.joined_rewards(rewards))
    run_page.forget(folder.path)
    folder.write_summary(result.to_json())
    return result


def _transfer(experiment: Experiment, use: Use, folder: RunFolder) -> Result:
    """Learns a reward in the source, takes one by the rule, trains fresh policies on it in the target."""
    out, learning = folder.path.parent, learning_folder(experiment, folder.path.parent)
    imitation_returns = _learn_once(experiment, learning)
    folder.drop(learning.dropped())
    target, seeds = use.target, experiment.seeds
    reward = None
    if use.rule.kind == "policy":
        algorithm, state = stages.learn(learning, experiment)
        labels: list[Lane] = [{"seed": seed} for seed in seeds]
        returns = scores(folder, target.recipe, target.env, algorithm, state, labels)
        kept, facts = divergence.kept_seeds(folder), {}
        returns = returns[kept]
    else:
        reward, facts = stages.choose_reward(folder, learning, experiment, use)
        save_reward(folder.path / "reward", stages.of_kept(reward, divergence.kept_seeds(folder)))
        scored = retraining.score(folder, f"{experiment.name} in {target.task}", target, reward, seeds)
        returns, kept = scored.returns, divergence.kept_seeds(folder)
        save_reward(folder.path / "reward", stages.of_kept(reward, kept))
        facts["chosen_iterations"] = [facts["chosen_iterations"][lane] for lane in kept]
        if "source_returns" in facts:
            facts["source_returns"] = [[each[lane] for lane in kept] for each in facts["source_returns"]]
        facts |= {"env_steps": target.recipe.config.env_steps, **_learned(scored.worth)}
    ceiling = retraining.ceiling(target, seeds, out, reward)
    return dataclasses.replace(
        _result(experiment, folder, returns, target.reference),
        target=target.task,
        rule=str(use.rule),
        imitation_returns=[imitation_returns[lane] for lane in kept],
        ceiling=ceiling.returns,
        ceiling_dropped=ceiling.dropped,
        retrain_settings=target.for_reward(experiment.config).settings(),
        saturated_lanes=stages.saturated_lanes(learning, experiment),
        **_sum(learning.seconds(), folder.seconds()),
        **facts,
    )


def learning_folder(experiment: Experiment, out: Path) -> RunFolder:
    """The folder in `out` where the reward of an experiment is learned, shared by all that learn it alike."""
    settings = experiment.learning_settings()
    path = learning_path(out, experiment.source.task, experiment.learning_name, settings)
    return RunFolder(path, settings, experiment.track)


def learning_path(out: Path, task: str, learning_name: str, settings: dict) -> Path:
    """The path of `learning_folder`, from what a `Result` holds."""
    return out / f"learn-{file_name(task)}-{learning_name}-{settings_digest(settings)}"


def _learn_once(experiment: Experiment, learning: RunFolder) -> list[float | None]:
    """Learns the rewards, once; returns how well each seed's policy imitates in the source. None: it was dropped."""
    summary = learning.summary(records.LEARNING)
    if summary is None:
        *_, returns = stages.learn_and_score(learning, experiment)
        summary = {"imitation_returns": divergence.all_finite(returns)}
        learning.write_summary(summary)
    return summary["imitation_returns"]


def reuse(
    saved_reward: Path, reward: LearnedReward, target: Target, out: Path, command_line: str = "", changed: str = ""
) -> Result:
    """Trains fresh policies on a saved reward in the target, one for each of its seeds, and scores them.

    Args:
      saved_reward: folder that `reward` was loaded from; it names the run's folder in `out`.
      changed: how the training differs from the target's recipe, for that name.

    Raises:
      InputError: if that folder belongs to a run of another reward or of other settings.
    """
    seeds = reward.description["seeds"]
    # The content of the reward, not its place: another reward in the same place is another run.
    settings = target.settings() | {"reward": storage.fingerprint(reward.params), "seeds": seeds}
    folder_name = f"reuse-{saved_reward.resolve().parent.name}-in-{file_name(target.task)}"
    folder = RunFolder(out / "-".join(filter(None, (folder_name, changed))), settings)
    content = folder.summary()
    if content is not None:
        return Result.from_json(content, f"{folder.path}/summary.json")
    folder.prepare()
    name = f"{file_name(reward.config.method)}-{with_method_defaults(reward.config).reward_form}"
    save_reward(folder.path / "reward", reward)
    scored = retraining.score(folder, f"{name} in {target.task}", target, reward, seeds)
    kept, ceiling = divergence.kept_seeds(folder), retraining.ceiling(target, seeds, out, reward)
    save_reward(folder.path / "reward", stages.of_kept(reward, kept))
    iterations = reward.description.get("iterations", [])  # a reward that was saved by hand has none
    result = Result(
        name=name,
        method=reward.config.method,
        task=reward.description["task"],
        target=target.task,
        rule="as saved",
        seeds=[seeds[lane] for lane in kept],
        dropped=folder.dropped(),
        returns=scored.returns.tolist(),
        **_learned(scored.worth),
        **target.reference._asdict(),
        env_steps=target.recipe.config.env_steps,
        **folder.seconds(),
        peak_memory_gb=peak_memory_gb(),
        command_line=command_line,
        is_published=False,
        settings=settings,
        chosen_iterations=[iterations[lane] for lane in kept] if iterations else [],
        ceiling=ceiling.returns,
        ceiling_dropped=ceiling.dropped,
    )
    folder.write_summary(result.to_json())
    title = f"{name}: {result.task} to {target.task}"
    plot(folder.path / "curves.png", title, [_retraining_curve(target, scored.curves, result.ceiling)])
    policies.keep(folder.path)
    run_page.write(folder.path)
    return result


def _result(experiment: Experiment, folder: RunFolder, returns: np.ndarray, reference: Reference) -> Result:
    """What every result of an experiment has; `returns` are those of the lanes that were not dropped."""
    kept = range(len(experiment.seeds)) if experiment.points else divergence.kept_seeds(folder)
    return Result(
        name=experiment.name,
        method=experiment.config.method,
        task=experiment.source.task,
        seeds=[experiment.seeds[lane] for lane in kept],
        dropped=folder.dropped(),
        returns=returns.tolist(),
        **reference._asdict(),
        env_steps=0,
        compile_seconds=0.0,
        run_seconds=0.0,
        peak_memory_gb=peak_memory_gb(),
        command_line="",
        is_published=experiment.is_published,
        settings=experiment.learning_settings(),
    )


def _learned(worth: retraining.Worth) -> dict[str, list[float]]:
    return {"learned_rewards": worth.kept.tolist(), "learned_share": worth.share.tolist()}


def _sum(*seconds: dict[str, float]) -> dict[str, float]:
    return {name: sum(part[name] for part in seconds) for name in ("compile_seconds", "run_seconds")}


# Curves --------------------------------------------------------------------------------------------------------------


def _draw(experiment: Experiment, folder: RunFolder, result: Result) -> None:
    """Saves `curves.png`; the pictures of a moved policy would be those of its learning, so it gets none."""
    path, source = folder.path / "curves.png", experiment.source.task
    if experiment.points:
        draw_sweeps(path, f"{experiment.name} in {source}", [(experiment, folder.path, result)])
    elif experiment.use is None:
        curves = imitation_curves(folder, experiment)
        for group in more_seeds.groups(folder.path, experiment.seeds, 0):
            part = dataclasses.replace(experiment, seeds=group)
            others = imitation_curves(RunFolder(more_seeds.folder(folder.path, group), part.settings()), part)
            curves = [
                dataclasses.replace(curve, values=np.concatenate([curve.values, other.values]))
                for curve, other in zip(curves, others, strict=True)
            ]
        plot(path, f"{experiment.name}: imitation of {source}", curves)
    elif experiment.use.rule.kind != "policy":
        target, learning = experiment.use.target, learning_folder(experiment, folder.path.parent)
        curves = [
            dataclasses.replace(curve, panel=f"{curve.panel} while learning")
            for curve in imitation_curves(learning, experiment)[:3]
        ]
        returns = retraining.kept_curves(folder, target, len(experiment.seeds))[divergence.kept_seeds(folder)]
        curves.append(_retraining_curve(target, returns, result.ceiling))
        plot(path, f"{experiment.name}: {source} to {target.task}", curves)


def _draw_reward(path: Path, experiment: Experiment) -> None:
    """Saves `reward.png` if the states of the task are positions in the plane."""
    env = experiment.use.target.env if experiment.use else experiment.source.env
    if planar.is_planar(env) and (path / "reward" / "reward.json").is_file():
        planar.plot_rewards(
            path / "reward.png", f"{experiment.name}: learned reward", env, load_reward(path / "reward")
        )


def draw_sweeps(path: Path, title: str, sweeps: Sequence[tuple[Experiment, Path, Result]]) -> None:
    """Saves the figure that compares all points of sweeps.

    Args:
      path: of the figure.
      sweeps: experiments with their folders and results. Their points have different values of the names, if any.
    """
    names, returns, curves, steps = [], [], [], []
    for experiment, folder, result in sweeps:
        lanes = len(experiment.points) * len(experiment.seeds)
        trained = RunFolder(folder, experiment.settings()).curve("true_return", lanes)
        names += [point_name(experiment, point) for point in experiment.points]
        returns += result.returns_by_point
        curves += list(trained.reshape(len(experiment.points), len(experiment.seeds), -1))
        steps += [experiment.config.steps_per_iteration] * len(experiment.points)
    plot_sweep(path, title, names, returns, curves, steps, sweeps[0][2].expert)


def imitation_curves(folder: RunFolder, experiment: Experiment) -> list[Curve]:
    """True return, discriminator accuracy and reward while learning in `folder`."""
    steps, kept = experiment.config.steps_per_iteration, divergence.kept_seeds(folder)

    def curve(panel: str, label: str, name: str, level: tuple[str, float] | None = None) -> Curve:
        return Curve(panel, label, folder.curve(name, len(experiment.seeds))[kept], steps, level)

    expert = experiment.source.reference.expert
    true = curve("true return", "", "true_return", None if expert is None else ("expert", expert))
    if not experiment.has_reward:
        return [true, curve("log-likelihood", "of the expert's actions", "log_prob_expert")]
    return [
        true,
        curve("discriminator accuracy", "on the expert", "accuracy_expert", ("chance", 0.5)),
        curve("discriminator accuracy", "on the policy", "accuracy_policy"),
        curve("learned reward", "on the expert", "reward_expert"),
        curve("learned reward", "on the policy", "reward_policy"),
    ]


def _retraining_curve(target: Target, returns: np.ndarray, ceiling: Sequence[float]) -> Curve:
    title = f"true return in {target.task}, trained on the learned reward"
    level = ("ceiling: true reward", float(np.mean(ceiling)))
    return Curve(title, "", returns, target.recipe.config.steps_per_iteration, level)


def point_name(experiment: Experiment, point: dict[str, float]) -> str:
    """`activation tanh, lambda_i 0.1`: the names of a sweep, and the floats of one of its points."""
    names = [f"{name} {value}" for name, value in experiment.swept_names.items()]
    return ", ".join([*names, *filter(None, [points.name(point)])])
