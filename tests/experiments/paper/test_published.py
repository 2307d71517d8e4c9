"""The paper's figures."""

from eairl_jax.experiments.paper.plan import EXPERIMENTS
from eairl_jax.experiments.paper.published import IMITATION, TABLES, TRANSFER, figure, show


def test_both_mazes_are_one_task():
    assert (
        figure(TRANSFER, "point_maze_left", "eairl") == figure(TRANSFER, "point_maze_right", "eairl") == (-7.01, 0.61)
    )


def test_a_method_that_the_paper_lacks_is_a_dash():
    assert show(figure(IMITATION, "ant", "bc")) == "-"
    assert show(figure(IMITATION, "ant", "gail")) == "738.72 ± 9.49"


def test_every_experiment_has_figures_and_every_task_an_expert():
    assert set(TABLES) == set(EXPERIMENTS)
    for table in TABLES.values():
        assert {task for task, _ in table} == {task for task, method in table if method == "expert"}
