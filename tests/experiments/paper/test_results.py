"""Results on disk, and the README's tables made of them."""

from pathlib import Path

from eairl_jax.experiments.paper import published, readme, results

ROOT = Path(__file__).parents[2]


def row(name, method, returns, target="point_maze_right", rule="last", **more):
    """A row as `eairl reproduce` writes it, of a task whose expert has 10 and whose random policy 0."""
    normalized = sum(returns) / len(returns) / 10
    return {"row": name, "method": method, "task": "point_maze_left", "target": target, "rule": rule, "expert": 10.0,
            "random": 0.0, "ceiling": [9.0, 10.0], "returns": returns, "normalized": normalized,
            "is_published": True, "imitation_returns": [7.0, 7.0], "seeds": [0, 1], "settings": {},
            "machine": {}} | more  # fmt: skip


def test_a_row_takes_the_place_of_its_older_self(tmp_path):
    path = tmp_path / "new" / "table1.json"
    first, second = row("airl_s-s", "airl_s", [1.0, 2.0]), row("eairl-sa", "eairl", [3.0, 4.0])
    for each in (first, second, row("airl_s-s", "airl_s", [5.0, 6.0]), row("airl_s-s", "airl_s", [7.0], rule="x")):
        results.add(path, each)
    assert [(r["row"], r["rule"], r["returns"]) for r in results.load(path)] == [
        ("airl_s-s", "last", [5.0, 6.0]), ("eairl-sa", "last", [3.0, 4.0]), ("airl_s-s", "x", [7.0]),
    ]  # fmt: skip


def test_the_table_of_a_transfer():
    rows = [
        row("airl_s-s", "airl_s", [8.0, 10.0]),
        row("airl_s-s", "airl_s", [6.0, 6.0], rule="source_retrain"),
        row("eairl-separable", "eairl", [5.0, 5.0], is_published=False),
        row("airl_s-s", "airl_s", [9.0, 9.0], target="point_maze_left"),
        row("eairl-sa", "eairl", [1.0, 1.0], rule="random"),
    ]
    (table,) = results.tables(rows, published.TRANSFER)
    assert results.markdown(table).splitlines() == [
        "| point_maze_left to point_maze_right | last | paper | source_retrain | back in the source "
        "| imitating, in the source |",
        "| --- | --- | --- | --- | --- | --- |",
        "| expert | 10.00 (1.00) | -4.98 ± 0.29 (1.00) |  |  |  |",
        "| ceiling | 9.50 ± 0.50 (0.95) |  |  |  |  |",
        "| AIRL(s) | 9.00 ± 1.00 (0.90) | -8.07 ± 0.50 (1.62) | 6.00 ± 0.00 (0.60) | 9.00 ± 0.00 (0.90) "
        "| 7.00 ± 0.00 |",
        "| EAIRL, separable | 5.00 ± 0.00 (0.50) |  |  |  | 7.00 ± 0.00 |",
        "| random reward | 1.00 ± 0.00 (0.10) |  |  |  |  |",
        "| random actions | 0.00 (0.00) |  |  |  |  |",
    ]


def test_the_table_of_imitations():
    rows = [
        row("gail-sa", "gail", [8.0, 10.0], target=None, rule=None) | {"task": "ant"},
        row("gail-sa", "gail", [5.0, 5.0], target=None, rule=None) | {"task": "pendulum"},
        row("bc", "bc", [2.0, 2.0], target=None, rule=None) | {"task": "ant"},
    ]
    (table,) = results.tables(rows, published.IMITATION)
    assert results.markdown(table).splitlines() == [
        "| imitation | ant | paper | pendulum | paper |",
        "| --- | --- | --- | --- | --- |",
        "| expert | 10.00 (1.00) | 935.12 ± 10.94 (1.00) | 10.00 (1.00) | -100.11 ± 1.32 (1.00) |",
        "| behaviour cloning | 2.00 ± 0.00 (0.20) |  |  |  |",
        "| GAIL | 9.00 ± 1.00 (0.90) | 738.72 ± 9.49 (0.79) | 5.00 ± 0.00 (0.50) | -116.01 ± 5.45 (1.16) |",
        "| random actions | 0.00 (0.00) |  | 0.00 (0.00) |  |",
    ]


def test_the_releases_protocol_takes_the_best_iteration_in_the_target():
    means = {"iteration=40": 3.0, "iteration=80": 5.0, "last": 1.0, "policy": 9.0}
    tried = [row("eairl-sa", "eairl", [mean], rule=rule) | {"mean": mean} for rule, mean in means.items()]
    picked = results.picked_on_the_target(tried)
    assert picked is not None
    assert picked["rule"] == "iteration=80"
    assert results.picked_on_the_target(tried[2:]) is None  # nothing to choose from


def test_names():
    assert results.name("eairl-sa+lambda_i=0") == "EAIRL, lambda_i=0"
    assert results.color("eairl-sa+lambda_i=0") == results.color("eairl-sa")


def test_the_readme_shows_the_results(monkeypatch):
    monkeypatch.chdir(ROOT)
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert readme.updated(text) == text, "run `python -m eairl_jax.experiments.paper.readme`"
    assert "<!-- table1 -->" in text


def test_rows_are_listed_as_the_paper_lists_them_whichever_was_trained_first():
    trained = ["new", "eairl-sa+tuned", "eairl-separable", "airl_s-s", "bc", "eairl-sa", "airl_s-s"]
    assert results.in_order([{"row": row} for row in trained]) == [
        "bc", "airl_s-s", "eairl-sa", "eairl-sa+tuned", "eairl-separable", "new",
    ]  # fmt: skip
