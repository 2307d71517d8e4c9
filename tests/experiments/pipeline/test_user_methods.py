"""Methods of a user's own file, in the commands."""

import json
from pathlib import Path

import numpy as np
import pytest

from eairl_jax import METHODS, load_reward

pytestmark = pytest.mark.usefixtures("no_trace")
EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "method_of_your_own.py"


def test_a_critic_of_a_users_file_learns_a_reward_that_needs_no_file(tmp_path, monkeypatch, tiny, run, capsys):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "losses.py").write_text(EXAMPLE.read_text())
    monkeypatch.chdir(folder)
    read = [setting for setting in tiny if not setting.startswith("empowerment")]
    command = ["imitate", "pendulum", "--method", "losses.py:critic", "--seeds", 1, "--set", *read]
    assert run(*command, "gradient_penalty=10", "--out", tmp_path / "run") == 0
    assert "losses-critic-sa" in capsys.readouterr().out
    assert np.isfinite(json.loads((tmp_path / "run" / "summary.json").read_text())["returns"]).all()
    del METHODS["losses.py:critic"]
    (folder / "losses.py").unlink()
    reward = load_reward(tmp_path / "run" / "reward")
    assert (reward.description["method"], reward.config.reward_form) == ("losses.py:critic", "sa")
    assert np.isfinite(reward(np.zeros(3), np.zeros(1)))
    assert run("evaluate", tmp_path / "run", "--episodes", 2) == 2
    assert "--method losses.py:critic: no file losses.py" in capsys.readouterr().err


WRONG = {
    "no.py:critic": "no file no.py",
    f"{EXAMPLE}:critik": "has no eairl_jax.methods.Method critik; did you mean critic",
    f"{EXAMPLE}:forward_kl": "has no eairl_jax.methods.Method forward_kl",
    "brax:hopper": "names no method: expected FILE.py:NAME",
    "eairll": "unknown method 'eairll'; did you mean eairl",
    "no_module:critic": "no module no_module is installed",
}


@pytest.mark.parametrize(("name", "message"), WRONG.items(), ids=["file", "name", "kind", "task", "word", "module"])
def test_what_is_no_method_is_refused(run, capsys, name, message):
    assert run("imitate", "pendulum", "--method", name) == 2
    assert message in " ".join(capsys.readouterr().err.split())
