"""What a command's options become: checked experiments."""

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from eairl_jax import InputError, demonstrations, envs
from eairl_jax.experiments.options import Imitate, Sweep, Transfer
from eairl_jax.experiments.pipeline import experiment
from eairl_jax.experiments.pipeline.experiment import (
    Reference,
    imitations,
    make_env,
    make_target,
    shipped_demonstrations,
    sweeps,
    transfers,
)
from eairl_jax.methods import method_names

MAZES = ("point_maze_left", "point_maze_right")


def test_a_setting_of_one_of_the_methods_is_accepted():
    experiments = imitations(Imitate("pendulum", method=("eairl", "gail"), set=("lambda_i=1",)))
    assert [experiment.name for experiment in experiments] == ["eairl-sa", "gail-sa"]
    assert experiments[0].recipe.hparams.lambda_i == 1.0


def test_tuned_settings_make_an_experiment_of_their_own_and_give_way_to_a_users():
    paper, changed, tuned = (
        imitations(Imitate("ant", tuned=is_tuned, set=settings))[0]
        for settings, is_tuned in (
            (("optimizer=trpo", "iterations=120"), False),
            (("ppo_epochs=3",), False),
            (("ppo_epochs=3",), True),
        )
    )
    assert (paper.name, changed.name, tuned.name) == ("eairl-sa", "eairl-sa", "eairl-sa+tuned")
    assert [experiment.is_published for experiment in (paper, changed, tuned)] == [True, False, False]
    assert (paper.config.actions, tuned.config.actions) == ("sampled", "clipped")
    assert tuned.config.ppo_epochs == 3
    assert changed.config.iterations == tuned.config.iterations


def test_a_setting_that_one_form_reads_is_accepted_beside_others():
    options = Imitate("pendulum", reward_form=("sa", "separable"), set=("action_part=net",))
    for _ in range(2):  # what is refused once is not refused for ever
        assert [experiment.config.action_part for experiment in imitations(options)] == ["net", "net"]


@pytest.mark.parametrize("task", envs.TASKS)
def test_every_method_has_a_recipe_for_every_task(task):
    for purpose in ("imitate", "reward"):
        experiments = imitations(Imitate(task, method=method_names()), purpose)
        assert [experiment.config.method for experiment in experiments] == list(method_names())


def test_a_transfer_has_an_experiment_for_each_method_form_and_rule():
    options = Transfer(*MAZES, method=("eairl", "gail"), reward_form=("sa", "separable"), rule=("last", "policy"))
    experiments = transfers(options)
    assert [(e.name, str(e.use.rule)) for e in experiments] == [
        (f"{method}-{form}", rule)
        for method in ("eairl", "gail")
        for form in ("sa", "separable")
        for rule in ("last", "policy")
    ]
    assert {e.use.target.task for e in experiments} == {MAZES[1]}
    assert {e.use.back_home.task for e in experiments} == {MAZES[0]}
    assert len({e.folder_name() for e in experiments}) == len(experiments)


def test_rules_that_share_a_learning_share_its_settings():
    last, policy = transfers(Transfer(*MAZES, rule=("last", "policy")))
    assert last.learning_settings() == policy.learning_settings()
    assert last.settings() != policy.settings()


def test_a_changed_retraining_is_named_and_not_the_papers():
    (usual,) = transfers(Transfer(*MAZES, rule=("last",)))
    use = dataclasses.replace(usual.use, target=dataclasses.replace(usual.use.target, variant="longer"))
    changed = dataclasses.replace(usual, use=use)
    assert (usual.name, usual.is_published) == ("eairl-sa", True)
    assert (changed.name, changed.learning_name, changed.is_published) == ("eairl-sa+longer", "eairl-sa", False)


def test_cloning_moves_its_policy_and_no_reward():
    (cloned,) = transfers(Transfer(*MAZES, method=("bc",), rule=("policy",)))
    assert cloned.name == "bc"
    with pytest.raises(InputError, match="learns no reward"):
        transfers(Transfer(*MAZES, method=("bc",), rule=("policy", "last")))


def test_restarts_are_the_users_or_the_recipes():
    assert make_target("point_maze_left").recipe.restarts == 4
    assert make_target("point_maze_left", restarts=2).recipe.restarts == 2


def test_a_sweep_is_one_experiment_of_all_points():
    (swept,) = sweeps(Sweep("pendulum", set=("lambda_i=0,0.1", "beta=1,2", "hidden=8,8")))
    assert swept.config.hidden == (8, 8)
    assert swept.points == tuple({"lambda_i": i, "beta": b} for i in (0.0, 0.1) for b in (1.0, 2.0))
    assert swept.settings()["sweep"] == list(swept.points)


def test_a_sweep_over_names_is_an_experiment_for_each_combination():
    swept = sweeps(Sweep("pendulum", set=("num_envs=2,4", "beta=1,2", "activation=relu,tanh")))
    assert [(each.config.num_envs, each.config.activation) for each in swept] == [
        (n, activation) for n in (2, 4) for activation in ("relu", "tanh")
    ]
    assert all(each.points == ({"beta": 1.0}, {"beta": 2.0}) for each in swept)
    assert len({each.folder_name() for each in swept}) == 4


@pytest.fixture
def copied(tmp_path, monkeypatch):
    """`(changes) -> path` of the pendulum's demonstrations, their provenance changed; played episodes are refused."""

    def refuse(env):
        raise AssertionError("computed")

    monkeypatch.setattr(experiment, "random_return", refuse)

    def copy(changes):
        shipped, path = shipped_demonstrations("pendulum"), tmp_path / "mine.npz"
        shutil.copy(shipped, path)
        provenance = json.loads(shipped.with_suffix(".json").read_text())
        path.with_suffix(".json").write_text(json.dumps(provenance | changes))
        return path

    return copy


@pytest.mark.parametrize("name", ["expert_return", "random_return"])
@pytest.mark.parametrize(
    "value", ["-100", None, float("nan"), float("inf"), True, [1.0], pytest.param(10**400, id="huge")]
)
def test_a_reference_that_is_no_number_is_refused_before_anything_is_computed(name, value, copied):
    with pytest.raises(InputError, match=rf"mine.json.*{name} is .*: expected (a finite number|at most 64 bits)"):
        imitations(Imitate("pendulum", demos=copied({name: value})))


def test_an_expert_that_is_as_good_as_random_actions_is_refused(copied):
    with pytest.raises(InputError, match=r"random actions both have the return -7, so no score"):
        imitations(Imitate("pendulum", demos=copied({"expert_return": -7, "random_return": -7.0})))


def test_a_source_without_rewards_has_no_expert(copied, monkeypatch):
    path = copied({})
    provenance = json.loads(path.with_suffix(".json").read_text())
    del provenance["expert_return"]
    path.with_suffix(".json").write_text(json.dumps(provenance))
    load = demonstrations.load
    monkeypatch.setattr(demonstrations, "load", lambda *arguments: load(*arguments)._replace(reward=None))
    (learning,) = imitations(Imitate("pendulum", demos=path))
    assert learning.source.reference == Reference(None, provenance["random_return"])
    assert learning.source.reference.normalized(3.0) is None


TASK = """
import jax, jax.numpy as jnp
from eairl_jax.envs.foreign import ForeignState

class Point:
    observation_size, action_size, episode_length = 3, 1, 10
    def reset(self, rng): return ForeignState((), jnp.zeros(3), jnp.zeros(()), jnp.zeros(()))
    def step(self, state, action): return state.replace(reward=-action[0] ** 2)
"""


@pytest.fixture
def point(tmp_path, monkeypatch):
    """The name of a task in a file of the current folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "point.py").write_text(TASK)
    monkeypatch.setattr(experiment, "SCORE_EPISODES", 3)
    make_env.cache_clear()
    yield "point.py:Point"
    make_env.cache_clear()


def test_a_target_needs_no_expert(point, capsys):
    experiment.say_once.cache_clear()
    (moved,) = transfers(Transfer("pendulum", point, rule=("last",)))
    reference = moved.use.target.reference
    assert (reference.expert, moved.use.target.demos) == (None, None)
    assert -1.0 * 10 < reference.random < 0.0
    assert f"{point} has no recipe: it is trained with defaults" in capsys.readouterr().out
    assert moved.folder_name() == "transfer-pendulum-to-point-Point-eairl-sa-last"


def test_the_recorded_demonstrations_of_a_task_are_found_and_said(point, tmp_path, capsys):
    with pytest.raises(InputError, match=r"no demonstrations of point\.py:Point come with the package"):
        imitations(Imitate(point))
    with np.load(shipped_demonstrations("pendulum")) as archive:
        arrays = {name: x[:, :10] for name, x in archive.items() if x.ndim} | {"task": np.asarray(point)}
    (tmp_path / "demos").mkdir()
    np.savez(tmp_path / "demos" / "point-Point.npz", **arrays)
    experiment.say_once.cache_clear()
    (learning,) = imitations(Imitate(point))
    assert learning.source.demos_path == Path("demos/point-Point.npz")
    assert f"demonstrations of {point}: demos/point-Point.npz" in capsys.readouterr().out
    assert transfers(Transfer("pendulum", point, rule=("last",)))[0].use.target.reference.expert is not None


@pytest.mark.parametrize(
    ("rule", "settings"), [("best", ()), ("iteration=7", ()), ("last", ("lambda_i=x",)), ("last", ("num_envs=0",))]
)
def test_bad_input_is_refused_before_random_actions_are_played(point, rule, settings, monkeypatch):
    monkeypatch.setattr(experiment, "random_return", lambda env: pytest.fail("computed"))
    with pytest.raises(InputError):
        transfers(Transfer("pendulum", point, rule=(rule,), set=settings))
