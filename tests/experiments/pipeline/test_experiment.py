"""What a command's options become: checked experiments."""

import dataclasses

import pytest

from eairl_jax import InputError, envs
from eairl_jax.experiments.options import Imitate, Sweep, Transfer
from eairl_jax.experiments.pipeline.experiment import imitations, sweeps, transfers
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


def test_a_sweep_is_one_experiment_of_all_points():
    (swept,) = sweeps(Sweep("pendulum", set=("lambda_i=0,0.1", "beta=1,2", "hidden=8,8")))
    assert swept.config.hidden == (8, 8)
    assert swept.points == tuple({"lambda_i": i, "beta": b} for i in (0.0, 0.1) for b in (1.0, 2.0))
    assert swept.settings()["sweep"] == list(swept.points)


def test_a_sweep_does_not_mix_programs_with_and_without_own_parts():
    with pytest.raises(InputError, match="own_part: with 0 the sources have no parts of their own"):
        sweeps(Sweep("point_maze_left+point_maze_right", set=("own_part=0,0.1",)))
    (swept,) = sweeps(Sweep("point_maze_left+point_maze_right", set=("own_part=0.01,0.1",)))
    assert swept.config.penalties == ("own_part",)


def test_a_sweep_over_names_is_an_experiment_for_each_combination():
    swept = sweeps(Sweep("pendulum", set=("num_envs=2,4", "beta=1,2", "activation=relu,tanh")))
    assert [(each.config.num_envs, each.config.activation) for each in swept] == [
        (n, activation) for n in (2, 4) for activation in ("relu", "tanh")
    ]
    assert all(each.points == ({"beta": 1.0}, {"beta": 2.0}) for each in swept)
    assert len({each.folder_name() for each in swept}) == 4
