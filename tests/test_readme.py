"""The README's example is run as it stands, only smaller; its commands exist."""

import re
from pathlib import Path

import pytest

README = Path(__file__).parents[1] / "README.md"


def test_the_example_runs(capsys):
    (example,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL)
    smaller, count = re.subn(r"iterations, seeds = \d+, \d+", "iterations, seeds = 5, 2", example)
    assert count == 1
    assert len(example.splitlines()) <= 40
    names = {}
    exec(compile(smaller, "README.md", "exec"), names)
    assert "true return" in capsys.readouterr().out
    assert names["rewards"].shape == (20, 200)


@pytest.mark.parametrize("command", sorted(set(re.findall(r"^eairl (\w+)", README.read_text(), flags=re.MULTILINE))))
def test_its_commands_exist(command, capsys):
    from eairl_jax.experiments import cli

    with pytest.raises(SystemExit) as stopped:
        cli.main([command, "--help"])
    assert stopped.value.code == 0
    assert f"eairl {command}" in capsys.readouterr().out
