"""The paper's figures (Tables 1 and 2: mean and standard deviation of total reward over 5 trials)."""

from __future__ import annotations

from eairl_jax.experiments.display.console import mean_and_std

Figure = tuple[float, float]
"""Mean and standard deviation."""
Table = dict[tuple[str, str], Figure]
"""Figures by task and method. Both mazes are one task, `point_maze`, as in the paper."""

# Table 1, reward transfer. The tasks are the targets.
TRANSFER: Table = {
    ("point_maze", "expert"): (-4.98, 0.29),
    ("point_maze", "airl_s"): (-8.07, 0.50),
    ("point_maze", "airl_sa"): (-19.28, 2.03),
    ("point_maze", "eairl"): (-7.01, 0.61),
    ("crippled_ant", "expert"): (432.66, 14.38),
    ("crippled_ant", "airl_s"): (175.51, 27.31),
    ("crippled_ant", "airl_sa"): (46.12, 14.37),
    ("crippled_ant", "eairl"): (348.43, 43.17),
}

# Table 2, imitation.
IMITATION: Table = {
    ("half_cheetah", "expert"): (2139.83, 30.22),
    ("half_cheetah", "gail"): (1880.05, 15.72),
    ("half_cheetah", "gan_gcl"): (-189.90, 44.42),
    ("half_cheetah", "airl_sa"): (1826.26, 19.64),
    ("half_cheetah", "airl_s"): (121.10, 42.31),
    ("half_cheetah", "eairl"): (1870.10, 17.86),
    ("ant", "expert"): (935.12, 10.94),
    ("ant", "gail"): (738.72, 9.49),
    ("ant", "gan_gcl"): (16.74, 36.59),
    ("ant", "airl_sa"): (645.90, 41.75),
    ("ant", "airl_s"): (271.31, 9.35),
    ("ant", "eairl"): (641.12, 25.92),
    ("swimmer", "expert"): (76.21, 1.79),
    ("swimmer", "gail"): (50.21, 0.26),
    ("swimmer", "gan_gcl"): (15.75, 7.32),
    ("swimmer", "airl_sa"): (49.52, 0.48),
    ("swimmer", "airl_s"): (33.21, 2.40),
    ("swimmer", "eairl"): (49.55, 0.29),
    ("pendulum", "expert"): (-100.11, 1.32),
    ("pendulum", "gail"): (-116.01, 5.45),
    ("pendulum", "gan_gcl"): (-578.18, 72.84),
    ("pendulum", "airl_sa"): (-118.13, 11.33),
    ("pendulum", "airl_s"): (-134.82, 10.89),
    ("pendulum", "eairl"): (-116.26, 8.313),
}

# Which of them stand beside each experiment of `eairl reproduce`.
TABLES = {"table2": IMITATION} | dict.fromkeys(("table1", "ablations", "sources", "imperfect", "styles"), TRANSFER)


def figure(table: Table, task: str, method: str) -> Figure | None:
    """The paper's figure for a method in a task; None where the paper has none."""
    return table.get((task.removesuffix("_left").removesuffix("_right"), method))


def show(figure: Figure | None) -> str:
    """For example `-7.01 ± 0.61`; a dash for None."""
    return "-" if figure is None else mean_and_std(*figure)
