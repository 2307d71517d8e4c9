"""Results on disk, and the README's tables made of them."""

from pathlib import Path

from experiments import paper, readme, results

ROOT = Path(__file__).parents[2]


def row(name, method, returns, target="point_maze_right", rule="last", **more):
    """A row as `eairl reproduce` writes it, of a task whose expert has 10 and whose random policy 0."""
    normalized = sum(returns) / len(returns) / 10
    return {"row": name, "method": method, "task": "point_maze_left", "target": target, "rule": rule, "expert": 10.0,
            "random": 0.0, "ceiling": [9.0, 10.0], "returns": returns, "normalized": normalized,
            "is_published": True} | more  # fmt: skip


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
    ]
    assert results.markdown(rows, paper.TRANSFER).splitlines() == [
        "| point_maze_left to point_maze_right | `last` | `source_retrain` | normalized | paper |",
        "| --- | --- | --- | --- | --- |",
        "| expert | 10.00 |  | 1 | -4.98 ± 0.29 |",
        "| ceiling | 9.50 ± 0.50 |  | 0.950 |  |",
        "| AIRL(s) | 9.00 ± 1.00 | 6.00 ± 0.00 | 0.900 / 0.600 | -8.07 ± 0.50 |",
        "| EAIRL, separable | 5.00 ± 0.00 |  | 0.500 |  |",
        "| random actions | 0.00 |  | 0 |  |",
    ]


def test_the_readme_shows_the_results(monkeypatch):
    monkeypatch.chdir(ROOT)
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert readme.updated(text) == text, "run `python -m experiments.readme`"
    assert "<!-- table1 -->" in text
