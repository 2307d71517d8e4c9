"""The paper's own numbers (Tables 1 and 2: mean and std of total reward over 5 trials), shown beside ours."""

from __future__ import annotations

Row = tuple[float, float]

# Table 1, reward transfer, by (target task without its side, row).
TRANSFER: dict[tuple[str, str], Row] = {
    ("point_maze", "expert"): (-4.98, 0.29),
    ("point_maze", "airl_s"): (-8.07, 0.50),
    ("point_maze", "airl_sa"): (-19.28, 2.03),
    ("point_maze", "eairl"): (-7.01, 0.61),
}

# Table 2, imitation.
IMITATION: dict[tuple[str, str], Row] = {
    ("pendulum", "expert"): (-100.11, 1.32),
    ("pendulum", "gail"): (-116.01, 5.45),
    ("pendulum", "airl_sa"): (-118.13, 11.33),
    ("pendulum", "airl_s"): (-134.82, 10.89),
    ("pendulum", "eairl"): (-116.26, 8.313),
}


def row(table: dict[tuple[str, str], Row], task: str, name: str) -> Row | None:
    """The paper's figure for a task and a row, or None where it gives none. Both mazes are one task to it."""
    return table.get((task.removesuffix("_left").removesuffix("_right"), name))


def show(figure: Row | None) -> str:
    """`-7.01 ± 0.61`, or a dash."""
    return "-" if figure is None else f"{figure[0]:.2f} ± {figure[1]:.2f}"
