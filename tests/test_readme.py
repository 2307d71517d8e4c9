"""The README's program runs as it stands, only shorter. `tests/docs/test_pages.py` checks the rest of the README."""

import re
from pathlib import Path

import numpy as np

README = Path(__file__).parents[1] / "README.md"


def test_the_program_runs(capsys):
    (program,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL)
    shorter, count = re.subn(r"iterations, keys = \d+,", "iterations, keys = 2,", program)
    assert count == 1
    assert len(program.splitlines()) <= 20
    names: dict = {}
    exec(compile(shorter, "README.md", "exec"), names)
    assert "true return in the right maze" in capsys.readouterr().out
    assert names["metrics"]["true_return"].shape == (2, 2)
    assert np.isfinite(names["metrics"]["policy_reward"]).all()
