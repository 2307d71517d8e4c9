"""Pictures of curves: what the axes hold."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgba

from eairl_jax.experiments.display.plots import (
    Axis,
    Curve,
    Dots,
    curve_figure,
    dots_figure,
    plot,
    plot_ranking,
    plot_search,
    plot_sweep,
)


def test_a_curve_shows_the_mean_and_the_range_over_seeds():
    values = np.array([[1.0, 3.0, np.nan], [3.0, 5.0, np.nan]])
    figure = curve_figure("title", [Curve("return", "EAIRL", values, 10, ("expert", 7.0), "C3", "--")])
    (axis,) = figure.axes
    mean, expert = axis.lines
    np.testing.assert_array_equal(mean.get_xdata(), [10, 20, 30])
    np.testing.assert_array_equal(np.ma.filled(np.ma.masked_invalid(mean.get_ydata()), -1), [2.0, 4.0, -1])
    assert (mean.get_color(), mean.get_linestyle(), mean.get_label()) == ("C3", "--", "EAIRL")
    assert set(expert.get_ydata()) == {7.0}
    band = axis.collections[0].get_paths()[0].vertices[:, 1]
    assert (band.min(), band.max()) == (1.0, 5.0)
    assert axis.get_title() == "return"


def test_every_panel_has_its_curves_and_spare_axes_are_hidden():
    curves = [
        Curve(panel, label, np.ones((1, 2)), 1) for panel, label in (("a", "x"), ("b", "x"), ("a", "y"), ("c", ""))
    ]
    figure = curve_figure("title", curves, columns=2)
    shown = [axis for axis in figure.axes if axis.get_visible()]
    assert [(axis.get_title(), len(axis.lines)) for axis in shown] == [("a", 2), ("b", 1), ("c", 1)]
    assert len(figure.axes) == 4
    assert shown[0].get_legend()
    assert not shown[2].get_legend()


def test_a_plot_is_a_picture(tmp_path):
    plot(tmp_path / "curves.png", "title", [Curve("return", "", np.ones((2, 3)), 10)])
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")
    assert [path.name for path in tmp_path.iterdir()] == ["curves.png"]


def test_a_picture_is_there_only_when_it_is_whole(tmp_path, monkeypatch):
    """A run draws no picture that is there, so half a picture would stay for ever."""

    def killed(figure, path, **_):
        Path(path).write_bytes(b"\x89PNG")
        raise KeyboardInterrupt

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", killed)
    with pytest.raises(KeyboardInterrupt):
        plot(tmp_path / "curves.png", "title", [Curve("return", "", np.ones((2, 3)), 10)])
    assert not (tmp_path / "curves.png").exists()


def test_scores_are_dots_with_their_mean_and_a_level():
    lines = {"eairl-sa+entropy_weight=0.1+lambda_i=0.5": np.array([1.0, 3.0]), "gail": np.array([])}
    figure = dots_figure("title", [Dots("a", "return", lines, ["C3", "C1"], ("expert", 5.0)), Dots("b", "x", lines)])
    first, second = figure.axes
    dots, mean, expert = (line for line in first.lines if len(line.get_xdata()))
    assert (list(dots.get_xdata()), list(dots.get_ydata()), dots.get_color()) == ([1.0, 3.0], [0, 0], "C3")
    assert set(mean.get_xdata()) == {2.0}
    assert set(expert.get_xdata()) == {5.0}
    assert [label.get_text() for label in first.get_yticklabels()] == [
        "eairl-sa\n+entropy_weight=0.1\n+lambda_i=0.5",
        "gail",
    ]
    assert first.get_ylim()[0] > first.get_ylim()[1]  # the first line is the upper one
    assert (second.get_title(loc="left"), second.lines[0].get_color()) == ("b", "C0")


def test_a_panel_in_which_no_episode_has_ended_says_so():
    (axis,) = curve_figure("title", [Curve("return", "", np.full((2, 3), np.nan), 10)]).axes
    assert [text.get_text() for text in axis.texts] == ["no episode has ended"]
    assert list(axis.get_yticks()) == []


def test_a_sweep_shows_a_dot_for_each_seed_and_the_expert(tmp_path, monkeypatch):
    figures = []
    monkeypatch.setattr("eairl_jax.experiments.display.plots.save", lambda figure, path: figures.append(figure))
    returns, curves = np.array([[1.0, 3.0], [5.0, 5.0]]), np.arange(12.0).reshape(2, 2, 3)
    plot_sweep(tmp_path / "sweep.png", "title", ["lambda_i=0", "lambda_i=1"], returns, curves, [10, 20], 6.0)
    final, learning = figures[0].axes
    first_dots, first_mean = final.lines[:2]
    assert list(first_dots.get_ydata()) == [1.0, 3.0]
    assert set(first_mean.get_ydata()) == {2.0}
    assert [label.get_text() for label in final.get_xticklabels()] == ["lambda_i=0", "lambda_i=1"]
    np.testing.assert_array_equal(learning.lines[1].get_ydata(), curves[1].mean(axis=0))
    assert to_rgba(final.lines[0].get_color()) == to_rgba(learning.lines[0].get_color())
    assert all(set(axis.lines[-1].get_ydata()) == {6.0} for axis in (final, learning))


@pytest.mark.parametrize("count", [1, 5])
def test_panels_stand_in_rows_of_four(count):
    curves = [Curve(str(number), "", np.ones((1, 1)), 1) for number in range(count)]
    assert len(curve_figure("title", curves).axes) == (1 if count == 1 else 8)


def test_a_name_is_drawn_as_it_is(tmp_path):
    """Two dollar signs would begin and end a formula, and this one cannot be drawn."""
    name = r"a $\nowhere{$ b"
    plot(tmp_path / "x.png", name, [Curve(name, name, np.ones((1, 2)), 1, (name, 1.0))])
    assert (tmp_path / "x.png").stat().st_size > 1000


def test_a_search_shows_a_dot_for_each_trial_and_marks_the_best(tmp_path, monkeypatch):
    figures = []
    monkeypatch.setattr("eairl_jax.experiments.display.plots.save", lambda figure, path: figures.append(figure))
    axes = [Axis("a", np.array([0.1, 1.0, 10.0]), True), Axis("b", np.array([1.0, 2.0, 3.0]), False)]
    plot_search(tmp_path / "search.png", "title", axes, np.array([0.5, np.nan, 0.2]), "score", 1.0)
    (figure,) = figures
    panels = [panel for panel in figure.axes if panel.get_xlabel() in ("a", "b")]
    assert [panel.get_xscale() for panel in panels] == ["log", "linear"]
    for panel, axis in zip(panels, axes, strict=True):
        lost, best, expert = panel.lines
        np.testing.assert_array_equal(lost.get_xdata(), axis.values[[1]])
        np.testing.assert_array_equal(best.get_xydata(), [[axis.values[0], 0.5]])
        assert set(expert.get_ydata()) == {1.0}
        np.testing.assert_array_equal(
            panel.collections[0].get_offsets(), [[axis.values[0], 0.5], [axis.values[2], 0.2]]
        )
    plot_search(tmp_path / "search.png", "title", axes, np.full(3, np.nan), "score", None)
    assert [len(panel.lines) for panel in figures[1].axes[:2]] == [1, 1]


def test_a_ranking_shows_noise_true_returns_and_the_curve_that_the_new_reward_follows(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr("eairl_jax.experiments.display.plots.save", lambda figure, path: drawn.append(figure))
    noise, true = np.array([0.0, 0.5, 1.0]), np.array([[3.0, 2.0, 1.0], [5.0, 5.0, 2.0]])
    rated, fitted = {"first": 10.0 * true, "new": true}, np.sqrt(1.5) * np.array([[1.0, 0.0, -1.0]] * 2)
    plot_ranking(tmp_path / "x.png", "title", noise, true, rated, fitted)
    plot_ranking(tmp_path / "x.png", "title", noise, true, {"new": true}, None)
    with_first, without = (figure.axes for figure in drawn)
    assert [axis.get_ylabel() for axis in with_first] == ["true return", "first", "new"]
    assert [axis.get_ylabel() for axis in without] == ["true return", "new"]
    dots, curve = with_first[1].lines[0].get_ydata(), with_first[1].lines[2].get_ydata()
    np.testing.assert_allclose(dots, curve, atol=1e-6)  # of seed 0, whose ratings lie on the curve
    np.testing.assert_array_equal(with_first[2].lines[1].get_xdata(), true[1])
