"""`eairl search`: a generation of trials in one program, and what is printed of them."""

import json
import re
import shlex
import shutil

import numpy as np
import pytest

from eairl_jax import Diverged, InputError
from eairl_jax.experiments.commands.search import imitate_command
from eairl_jax.experiments.options import SOURCE_ALONE, Imitate, Search
from eairl_jax.experiments.pipeline.experiment import imitations

RANGES = ("lambda_i=log:1e-4..1", "policy_lr=1e-4..0.01")
REFUSED = {
    "no range": ((), "nothing to search: give a range"),
    "no float": (("--set", "num_envs=2..5"), "cannot be searched"),
    "an impossible end": (("--set", "gamma=0.5..1.5"), "gamma = 1.5: expected a number at least 0 and at most 1"),
    "another method's setting": (("--method", "gail", "--set", RANGES[0]), "lambda_i: not a setting of gail"),
    "half a generation": (("--trials", "10", "--generation", "4", "--set", RANGES[0]), "for example --trials 8"),
    "no generation": (("--generation", "0", "--set", RANGES[0]), "--generation 0: expected at least 1 trial"),
    "a target": (("--target", "point_maze_right", "--set", RANGES[0]), f"--target: {SOURCE_ALONE}"),
    "a target's score": (("--objective", "transfer:swimmer", "--set", RANGES[0]), SOURCE_ALONE),
}


@pytest.mark.parametrize("arguments, hint", REFUSED.values(), ids=REFUSED)
def test_bad_input_is_one_clear_message(arguments, hint, tmp_path, monkeypatch, capsys, run):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("eairl_jax.experiments.commands.search.load_optuna", lambda: None)
    assert run("search", "pendulum", *arguments) == 2
    assert hint in capsys.readouterr().err
    assert not list(tmp_path.iterdir()), "nothing is written before the input is checked"


def test_without_optuna_the_extra_is_named(tmp_path, monkeypatch, capsys, run):
    def missing(module, extra):
        raise InputError(f'{module} is missing (): pip install "eairl-jax[{extra}]"')

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("eairl_jax.experiments.pipeline.search.required", missing)
    assert run("search", "pendulum", "--set", RANGES[0]) == 2
    assert 'pip install "eairl-jax[search]"' in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_the_printed_command_trains_the_point_with_other_seeds():
    options = Search("pendulum", method="gail", reward_form="s", seeds=3, first_seed=4, optimizer="trpo")
    words = shlex.split(imitate_command(options, ("gamma=0.9",), {"policy_lr": 0.00123456, "beta": 1.0}))
    assert words[:3] == ["eairl", "imitate", "pendulum"]
    assert " ".join(words[3:]) == (
        "--method gail --reward-form s --optimizer trpo --first-seed 7 --set gamma=0.9 policy_lr=0.00123456 beta=1"
    )
    (experiment,) = imitations(
        Imitate(
            "pendulum", ("gail",), ("s",), first_seed=7, optimizer="trpo", set=("gamma=0.9", "policy_lr=0.00123456")
        )
    )
    assert experiment.recipe.hparams.policy_lr == 0.00123456
    assert experiment.seeds.start == options.first_seed + options.seeds


@pytest.mark.extras
def test_a_search_is_repeatable_goes_on_and_says_what_is_best(tmp_path, tiny, capsys, run, table, monkeypatch):
    pytest.importorskip("optuna")
    out = tmp_path / "run?{a}%20"  # a path may have any name

    def search(trials, *more):
        arguments = ["search", "pendulum", "--seeds", 2, "--generation", 2, "--trials", trials, "--out", out]
        return run(*arguments, "--set", *tiny, *RANGES, *more)

    def read():
        return json.loads((out / "search.json").read_text())

    assert search(4) == 0
    printed, content = table(capsys), read()
    trials = content["trials"]
    assert [trial["number"] for trial in trials] == [0, 1, 2, 3]
    for trial in trials:
        assert 1e-4 <= trial["point"]["lambda_i"] <= 1
        assert 1e-4 <= trial["point"]["policy_lr"] <= 0.01
        mean, random, expert = np.mean(trial["returns"]), content["random"], content["expert"]
        assert trial["score"] == pytest.approx((mean - random) / (expert - random))
        assert re.search(rf"trial {trial['number']} .* {mean:.2f} ± ", printed)
        assert (out / trial["folder"] / "reward" / "reward.json").exists()
    assert content["best"]["score"] == max(trial["score"] for trial in trials)
    assert content["best_command"] in printed
    assert "--first-seed 2" in content["best_command"]
    assert "the score of the best of 4 trials of 2 seeds is optimistic" in printed
    assert (out / "search.png").read_bytes().startswith(b"\x89PNG")
    assert "generation-001/index.html" in (out / "index.html").read_text()
    compiled = [json.loads((out / f"generation-00{g}" / "seconds.json").read_text())["compile_seconds"] for g in (0, 1)]
    assert compiled[1] < 0.1 * compiled[0], "generations share the program"

    # The same command again trains nothing. Another setting is another search.
    with monkeypatch.context() as patch:
        patch.setattr("eairl_jax.experiments.pipeline.stages.learner", lambda _: pytest.fail("computed"))
        assert search(4) == 0
        assert read() == content
        capsys.readouterr()
        assert search(4, "beta=2") == 2
        assert "belongs to a different run (hparams.beta: there 1.0, here 2.0)" in capsys.readouterr().err

    # The database is made again from the generations; a seed that was dropped leaves its trial without a score.
    (out / "search.db").unlink()
    (out / "generation-001" / "summary.json").unlink()
    reason = {"training": "eairl-sa in pendulum", "quantity": "policy_loss", "iteration": 3, "value": "nan"}
    dropped = [{"seed": 1} | trials[3]["point"] | reason]
    (out / "generation-001" / "dropped.json").write_text(json.dumps({"dropped": dropped}))
    assert search(4) == 0
    again = read()["trials"]
    assert again[:3] == trials[:3]
    assert again[3] == trials[3] | {"returns": [], "score": None, "folder": None}
    assert "1 of 4 trials have diverged" in capsys.readouterr().out

    # More trials go on; a generation in which nothing is left has no score.
    def diverged(*_):
        raise Diverged("every seed has diverged", "policy_loss", 0, 1, float("nan"))

    monkeypatch.setattr("eairl_jax.experiments.pipeline.search.run_experiment", diverged)
    assert search(6) == 0
    assert read()["trials"][:4] == again
    assert [trial["score"] for trial in read()["trials"][4:]] == [None, None]
    shutil.rmtree(out)
    capsys.readouterr()
    assert search(2) == 1
    assert "every trial has diverged" in capsys.readouterr().err
