"""The page that shows what was reproduced."""

import re

import pytest

from eairl_jax import InputError
from eairl_jax.experiments.paper import report, results

MAZES = ("point_maze_left", "point_maze_right")


def test_the_page_shows_the_results_and_needs_no_network(tmp_path, make_result, results_of):
    transfers = [make_result("eairl-sa", [1.0, 2.0], *MAZES, rule) for rule in ("last", "policy")]
    transfers.append(make_result("eairl-separable", [7.0, 8.0], "ant", "crippled_ant", "last"))
    imitations = [make_result("eairl-sa", [9.0, 9.5]), make_result("bc", [9.0, 8.0])]
    ablations = [make_result("eairl-sa+lambda_i=0", [3.0, 4.0], *MAZES, "last")]
    (tmp_path / "appendix-c-crippled_ant.png").write_bytes(b"")
    (tmp_path / "discussion.md").write_text("**In short.** All of it.\n\nAnd *more*.")
    text = report.page(results_of(imitations, transfers, ablations), tmp_path)
    for shown in (
        "Appendix C: crippled_ant: a fresh policy on the reward of EAIRL, separable, seed 0: true return 7",
        "<strong>In short.</strong>",
        "And <em>more</em>.",
        "point_maze_left to point_maze_right",
        "behaviour cloning",
        "1.50 ± 0.50",
        "-7.01 ± 0.61",
        "<td>1.50</td>",
        "eairl reproduce table2 --task ant",
    ):
        assert shown in text
    # The overview, two sets of curves, the ablations and the measures of closeness.
    assert text.count("data:image/svg+xml") == 5
    assert not re.search(r'(src|href)="http', text)


def test_a_page_of_ablations_alone_has_no_figure(tmp_path, make_result, results_of):
    ablations = [make_result("eairl-sa+lambda_i=0", [3.0, 4.0], *MAZES, "last", closeness=None)]
    text = report.page(results_of(ablations=ablations), tmp_path)
    assert "data:image" not in text
    assert "eairl reproduce table2 --task ant" in text


def test_the_page_is_written_from_a_folder_of_results(tmp_path, make_result, capsys):
    results.add(tmp_path / "table2.json", make_result("gail-sa", [9.0, 8.0]))
    out = tmp_path / "new" / "report.html"
    report.write(tmp_path, out)
    assert "GAIL" in out.read_text(encoding="utf-8")
    assert str(out) in capsys.readouterr().out.replace("\n", "")


def test_a_folder_without_results_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"holds no results: make some with .*--results"):
        report.write(tmp_path, tmp_path / "report.html")
    assert not (tmp_path / "report.html").exists()


EVIL = "<script>alert('1')</script> \"quoted\""


def test_nothing_that_the_page_shows_is_run(tmp_path, make_result, results_of):
    """Names, tasks, machines and the discussion may come from a stranger."""
    machine = {"date": EVIL, "devices": 2, "device": EVIL, "versions": {"jax": EVIL}}
    transfers = [make_result(f"eairl-sa+{EVIL}", [1.0, 2.0], EVIL, f"{EVIL}2", "last", machine=machine)]
    (tmp_path / f"appendix-c-{EVIL.replace('/', '')}.png").write_bytes(b"")
    folded = (
        "<details><summary>More</summary>\n\n[x](javascript:alert(1)) ![y](https://example.com/y.png)\n\n</details>"
    )
    (tmp_path / "discussion.md").write_text(f"{EVIL}\n\n{folded}\n\n<img src=x onerror=alert(1)>")
    text = report.page(results_of([make_result(EVIL, [1.0, 2.0], EVIL)], transfers), tmp_path)
    assert "<script>alert" not in text
    assert "&lt;script&gt;alert" in text
    assert "<img src=x" not in text
    assert 'href="javascript' not in text
    assert 'src="https' not in text
    assert "<details><summary>More</summary>" in text
    assert "</details>" in text
