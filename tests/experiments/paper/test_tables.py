"""Tables made of results, as records and as Markdown."""

import dataclasses
from pathlib import Path

import pytest

from eairl_jax import demonstrations
from eairl_jax.experiments.paper import plan, published, tables
from eairl_jax.experiments.pipeline.places import shipped_demonstrations

ROOT = Path(__file__).parents[3]
MAZES = ("point_maze_left", "point_maze_right")


def test_the_table_of_a_transfer(make_result):
    experiment = [
        make_result("airl_s-s", [8.0, 10.0], *MAZES, "last"),
        make_result("airl_s-s", [6.0, 6.0], *MAZES, "source_retrain"),
        make_result("eairl-separable", [5.0, 5.0], *MAZES, "last", is_published=False, diagnosis=None),
        make_result("airl_s-s", [9.0, 9.0], MAZES[0], MAZES[0], "last"),
        make_result("eairl-sa", [1.0, 1.0], *MAZES, "random"),
    ]
    (table,) = tables.tables(experiment, published.TRANSFER)
    assert tables.markdown(table).splitlines() == [
        "| point_maze_left to point_maze_right | last | paper | the reward, by diagnosis | source_retrain "
        "| back in the source | imitating, in the source |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        "| expert | 10.00 (1.00) | -4.98 ± 0.29 (1.00) |  |  |  |  |",
        "| ceiling | 9.50 ± 0.50 (0.95) |  |  |  |  |  |",
        "| AIRL(s) | 9.00 ± 1.00 (0.90) | -8.07 ± 0.50 (1.62) | 1 agrees, 1 mistaken | 6.00 ± 0.00 (0.60) "
        "| 9.00 ± 0.00 (0.90) | 7.00 ± 0.00 |",
        "| EAIRL, separable | 5.00 ± 0.00 (0.50) |  | not diagnosed |  |  | 7.00 ± 0.00 |",
        "| random reward | 1.00 ± 0.00 (0.10) |  |  |  |  |  |",
        "| random actions | 0.00 (0.00) |  |  |  |  |  |",
    ]


def test_the_table_of_diagnoses(make_result, make_diagnosis):
    low, high = (
        make_result(name, returns, *MAZES, "last", diagnosis=make_diagnosis(returns, share))
        for name, returns, share in (("eairl-sa", [4.0, 2.0], 0.5), ("airl_s-s", [10.0, 10.0], 1.0))
    )
    (table,) = tables.diagnoses([low, high, make_result("bc", [1.0], "ant")])
    assert [(name, [cell.ours for cell in cells]) for name, cells in table.lines] == [
        ("AIRL(s)", ["10.00 ± 0.00", "1.000", "1.000", "10.00 ± 0.00", "2 agree"]),
        ("EAIRL", ["3.00 ± 1.00", "0.500", "0.500", "10.00 ± 0.00", "2 not optimised"]),
    ]


def test_the_table_of_one_source_and_of_two(make_result):
    both = "+".join(MAZES)
    experiment = [
        make_result("eairl-sa", [8.0, 10.0], both, "third", "last"),
        make_result("eairl-sa", [4.0, 6.0], MAZES[0], "third", "last", diagnosis=None),
        make_result("airl_s-s", [7.0, 7.0], MAZES[0], "third", "last"),
        make_result("airl_s-s", [7.0, 7.0], MAZES[0], "fourth", "last"),
    ]
    third, fourth = tables.by_source(experiment)
    assert tables.markdown(third).splitlines() == [
        f"| in third | {both} | the reward, by diagnosis | point_maze_left | the reward, by diagnosis |",
        "| --- | --- | --- | --- | --- |",
        "| expert | 10.00 (1.00) |  |  |  |",
        "| ceiling | 9.50 ± 0.50 (0.95) |  |  |  |",
        "| AIRL(s) |  |  | 7.00 ± 0.00, lowest 7.00 (0.70) | 2 mistaken |",
        "| EAIRL | 9.00 ± 1.00, lowest 8.00 (0.90) | 1 agrees, 1 mistaken | 5.00 ± 1.00, lowest 4.00 (0.50) "
        "| not diagnosed |",
        "| random actions | 0.00 (0.00) |  |  |  |",
    ]
    assert (fourth.title, fourth.columns[0]) == ("in fourth", "point_maze_left")


def test_the_table_of_an_exact_phi_says_what_the_same_seeds_gain(make_result):
    exact = "eairl-sa+shaping=exact_empowerment+empowerment_steps="
    group = [
        make_result(f"{exact}20", [6.0, 9.0], *MAZES, "last", diagnosis=None),
        make_result("eairl-sa+shaping=none", [5.0, 7.0], *MAZES, "last"),
        make_result(f"{exact}5", [5.0, 7.0], *MAZES, "last"),
        make_result("eairl-sa+lambda_i=0", [1.0, 1.0], *MAZES, "last"),
        make_result("eairl-sa+shaping=none", [1.0, 1.0], "ant", "crippled_ant", "last"),  # no exact Phi there
    ]
    (table,) = tables.exact_phi(group)
    assert [(name, [cell.ours for cell in cells]) for name, cells in table.lines] == [
        ("EAIRL, Phi = 0", ["6.00 ± 1.00", "", "2 mistaken"]),
        ("EAIRL, Phi over 5 steps", ["6.00 ± 1.00", "+0.00 (+0.00 to +0.00)", "2 mistaken"]),
        ("EAIRL, Phi over 20 steps", ["7.50 ± 1.50", "+1.50 (-4.85 to +7.85)", "not diagnosed"]),
    ]


def test_rewards_that_were_learned_as_the_paper_learns_have_a_table(make_result):
    protocol = "+".join(("eairl-sa", *plan.PROTOCOL))
    group = [make_result(protocol, [9.0, 7.0], *MAZES, "last"), make_result("eairl-sa", [1.0, 1.0], *MAZES, "last")]
    (table,) = tables.by_protocol(group)
    lines = {name: [cell.ours for cell in cells] for name, cells in table.lines}
    assert lines["EAIRL"] == ["8.00 ± 1.00, lowest 7.00", "2 mistaken"]
    assert len(lines) == 4  # expert, ceiling, random actions


def test_the_steps_to_nearly_the_expert_are_those_of_the_first_time(make_result):
    curve = {"env_steps": [10, 20, 30, 40], "true_return": [[None, 9.0, 1.0, 9.5], [0.0, 8.9, 1.0, 9.5], [1.0] * 4]}
    several = make_result("eairl-sa", [9.5, 9.5, 1.0], "ant", curve=curve)
    never = make_result("gail-sa", [1.0], "swimmer", curve={"env_steps": [10], "true_return": [[8.9]]})
    unknown, cloned = (
        make_result("eairl-sa", [1.0], "pendulum", expert=None),
        make_result("bc", [9.5], "ant", curve=curve),
    )
    assert tables.first_steps(several, 0.9) == [20, 40, None]
    (table,) = tables.samples([several, never, unknown, cloned])
    assert table.columns == ["ant", "swimmer"]
    assert [(name, [cell.ours for cell in cells]) for name, cells in table.lines] == [
        ("GAIL", ["", "not reached (0 of 1)"]),
        ("EAIRL", ["30 (2 of 3)", ""]),
    ]
    assert tables.samples([unknown, cloned]) == []


def test_the_table_of_imperfect_demonstrations(make_result):
    demonstrated = demonstrations.provenance(shipped_demonstrations("half_cheetah", "half"))["expert_return"]
    experiment = [
        make_result(
            "eairl-separable+demos=half+retrain_trials=0", [demonstrated, 2 * demonstrated], *["half_cheetah"] * 2, rule
        )
        for rule in ("last", "ssrr")
    ]
    (table,) = tables.imperfect([*experiment, make_result("eairl-sa", [1.0], "ant", "ant", "last")])
    assert table.title == "half_cheetah, demonstrator: half"
    lines = {name: [cell.ours for cell in cells] for name, cells in table.lines}
    assert lines["the demonstrator"] == [f"{demonstrated:.2f}"]
    assert [name for name in lines if name.startswith("EAIRL")] == ["EAIRL, separable, last", "EAIRL, separable, ssrr"]
    assert lines["EAIRL, separable, ssrr"][1] == "1.50, lowest 1.00"


def test_the_table_of_styles_compares_the_same_seeds(make_result):
    tasks = ("half_cheetah+half_cheetah?control_cost=0.5", "half_cheetah", "last")
    names = {"": [1.0, 2.0, 3.0], "+own_part=0.1": [2.0, 3.5, 3.5]}
    experiment = [
        make_result(f"{method}{part}+retrain_trials=0", returns, *tasks)
        for part, returns in names.items()
        for method in ("eairl-separable", "airl_s-s")
        if not (part == "" and method == "airl_s-s")
    ]
    (table,) = tables.by_style(experiment)
    lines = {name: [cell.ours for cell in cells] for name, cells in table.lines}
    assert lines["EAIRL, separable, one reward for all"] == ["2.00 ± 0.82, lowest 1.00", ""]
    assert lines["EAIRL, separable, with a part for each"][1].startswith("+1.00 (")
    assert lines["AIRL(s), with a part for each"] == ["3.00 ± 0.71, lowest 2.00", ""]


def test_what_is_gained_is_of_the_seeds_that_both_have(make_result):
    ours, theirs = make_result("eairl-sa", [1.0, 2.0, 3.0], "ant"), make_result("bc", [1.0, 1.0, 9.0], "ant")
    shared = dataclasses.replace(theirs, seeds=[*ours.seeds[:2], 99])
    assert tables.gain(ours, shared) == tables.gain(
        dataclasses.replace(ours, seeds=ours.seeds[:2], returns=[1.0, 2.0]),
        dataclasses.replace(theirs, seeds=theirs.seeds[:2], returns=[1.0, 1.0]),
    )
    assert tables.gain(ours, dataclasses.replace(theirs, seeds=[97, 98, 99])) == ""


def test_the_table_of_imitations(make_result):
    experiment = [
        make_result("gail-sa", [8.0, 10.0], "ant"),
        make_result("gail-sa", [5.0, 5.0], "pendulum"),
        make_result("bc", [2.0, 2.0], "ant"),
    ]
    (table,) = tables.tables(experiment, published.IMITATION)
    assert tables.markdown(table).splitlines() == [
        "| imitation | ant | paper | pendulum | paper |",
        "| --- | --- | --- | --- | --- |",
        "| expert | 10.00 (1.00) | 935.12 ± 10.94 (1.00) | 10.00 (1.00) | -100.11 ± 1.32 (1.00) |",
        "| behaviour cloning | 2.00 ± 0.00 (0.20) |  |  |  |",
        "| GAIL | 9.00 ± 1.00 (0.90) | 738.72 ± 9.49 (0.79) | 5.00 ± 0.00 (0.50) | -116.01 ± 5.45 (1.16) |",
        "| random actions | 0.00 (0.00) |  | 0.00 (0.00) |  |",
    ]


def test_a_changed_method_stands_beside_no_figure_of_the_paper(make_result):
    result = make_result("eairl-sa", [5.0], "ant")
    assert tables.cell(result, published.IMITATION).paper
    assert not tables.cell(dataclasses.replace(result, is_published=False), published.IMITATION).paper
    assert tables.cell(None, published.IMITATION) == tables.Cell()


def test_the_releases_protocol_picks_the_best_iteration_in_the_target(make_result):
    returns = {"iteration=40": 3.0, "iteration=80": 5.0, "last": 1.0, "policy": 9.0}
    tried = [make_result("eairl-sa", [value], *MAZES, rule) for rule, value in returns.items()]
    picked = tables.picked_in_the_target(tried)
    assert picked is not None
    assert picked.rule == "iteration=80"
    assert tables.picked_in_the_target(tried[2:]) is None  # one iteration leaves no choice


@pytest.mark.parametrize("page", [page for page in tables.PAGES if page.exists()], ids=lambda page: page.name)
def test_the_pages_show_the_results(page):
    text = page.read_text(encoding="utf-8")
    assert tables.updated(text) == text, "run `python -m eairl_jax.experiments.paper.tables`"


def test_the_tables_of_a_page_are_replaced_and_nothing_else():
    text = "before\n<!-- table2 -->\nold\n<!-- end -->\nafter <!-- other -->\nkept\n<!-- end -->"
    start, _, rest = tables.updated(text).partition("| imitation |")
    assert start == "before\n<!-- table2 -->\n"
    assert rest.endswith("\n<!-- end -->\nafter <!-- other -->\nkept\n<!-- end -->")
    assert "old" not in rest
