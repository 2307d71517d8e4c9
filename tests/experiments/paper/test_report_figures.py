"""The report's figures: which there are, and what they name."""

import base64

from eairl_jax.experiments.paper import report_figures
from eairl_jax.experiments.paper.report_tables import overview

MAZES = ("point_maze_left", "point_maze_right")


def names(figure):
    """The texts of an SVG figure: matplotlib writes each as a comment before its glyphs."""
    return base64.b64decode(figure.partition(",")[2]).decode()


def test_the_overview_names_methods_and_the_tasks_that_are_missing(make_result, results_of):
    results = results_of(
        [
            make_result("eairl-sa", [9.0, 8.0], "ant"),
            make_result("bc", [9.0], "ant"),
            make_result("bc", [9.0], "swimmer"),
        ]
    )
    text = names(report_figures.overview(overview(results)))
    assert "<!-- behaviour cloning -->" in text
    assert "<!-- EAIRL, 1 of 2 tasks -->" in text
    assert report_figures.overview([]) == ""


def test_ablations_stand_beside_the_methods_that_they_change(make_result, results_of):
    changed = make_result("eairl-sa+lambda_i=0", [3.0, 4.0], *MAZES, "last")
    unchanged = [make_result(name, [5.0], *MAZES, "last") for name in ("eairl-sa", "airl_s-s", "gail-sa")]
    (figure,) = report_figures.ablations(results_of(table1=unchanged, ablations=[changed]))
    text = names(figure)
    assert all(f"<!-- {title} -->" in text for title in ("EAIRL", "AIRL(s)", "EAIRL, lambda_i=0"))
    assert "<!-- GAIL -->" not in text
    assert report_figures.ablations(results_of(ablations=[changed])) == []


def test_figures_of_nothing_are_empty():
    assert report_figures.curves("title", []) == report_figures.closeness([]) == ""


def test_the_same_figure_is_the_same_text(make_result):
    measured = [make_result("eairl-sa", [1.0, 2.0], *MAZES, "last")]
    assert report_figures.closeness(measured) == report_figures.closeness(measured)
    curves = [report_figures.curves("title", measured) for _ in range(2)]
    assert curves[0] == curves[1]
    assert "<!-- title -->" in names(curves[0])
