"""The paper's figures: which results they show."""

import numpy as np

from eairl_jax.experiments.paper import figures

MAZES = ("point_maze_left", "point_maze_right")


def test_learning_curves_are_of_each_pair_and_dashed_for_variants(make_result):
    chosen = [
        make_result("eairl-sa+lambda_i=0", [1.0, 2.0], *MAZES, "last"),
        make_result("airl_s-s", [1.0, 2.0], *MAZES, "last"),
        make_result("bc", [1.0, 2.0], curve=None),
    ]
    curves = figures.learning_curves(chosen)
    assert [(curve.panel, curve.label, curve.style) for curve in curves] == [
        (" to ".join(MAZES), "AIRL(s)", "-"),
        (" to ".join(MAZES), "EAIRL, lambda_i=0", "--"),
    ]
    assert curves[0].steps_per_iteration == 10
    assert curves[0].level == ("expert", 10.0)
    np.testing.assert_array_equal(curves[0].values, [[np.nan, 1.0], [0.0, 2.0]])


def test_figure_2_shows_the_last_iterations_transfers_of_the_wanted_tasks(make_result, tmp_path, monkeypatch):
    plotted = []
    monkeypatch.setattr(figures, "plot", lambda path, title, curves: plotted.append((path, curves)))
    results = [
        make_result("eairl-sa", [1.0, 2.0], *MAZES, "last"),
        make_result("eairl-sa", [1.0, 2.0], *MAZES, "policy"),
        make_result("eairl-sa", [1.0, 2.0], MAZES[0], MAZES[0], "last"),
        make_result("eairl-sa", [1.0, 2.0], "ant", "crippled_ant", "last"),
    ]
    figures.figure2(results, tmp_path, tmp_path, ("ant",))
    figures.figure2(results, tmp_path, tmp_path, ())
    figures.figure2(results, tmp_path, tmp_path, ("swimmer",))
    assert [(path, [curve.panel for curve in curves]) for path, curves in plotted] == [
        (tmp_path / "figure2.png", ["ant to crippled_ant"]),
        (tmp_path / "figure2.png", [" to ".join(MAZES), "ant to crippled_ant"]),
    ]


def test_appendix_c_draws_mazes_and_ants_each_in_their_way(make_result, tmp_path, monkeypatch):
    drawn = []
    for name in ("maze_paths", "gaits"):
        monkeypatch.setattr(figures, name, lambda folder, transfer, out, name=name: drawn.append((name, len(transfer))))
    results = [
        make_result("eairl-sa", [1.0], "ant", "crippled_ant", "last"),
        make_result("eairl-sa", [1.0], *MAZES, "last"),
        make_result("airl_s-s", [1.0], *MAZES, "last"),
    ]
    figures.appendix_c(results, tmp_path, tmp_path, ())
    assert sorted(drawn) == [("gaits", 1), ("maze_paths", 2)]


def test_axes_that_share_a_scale_show_everything():
    from matplotlib.figure import Figure

    axes = Figure().subplots(1, 2)
    axes[0].plot([0, 1], [0, 1])
    axes[1].plot([-5, 5], [2, 3])
    figures._share_scale(axes)
    assert axes[0].get_xlim() == axes[1].get_xlim()
    assert axes[0].get_xlim()[0] <= -5
    assert axes[0].get_ylim()[1] >= 3
