"""Whole commands on tiny settings: what they leave, how they resume, what they refuse."""

import csv
import dataclasses
import json
import re
import shutil

import jax
import numpy as np
import pytest

from eairl_jax import Checkpoints, InputError, LearnedReward, envs, load_reward
from eairl_jax.experiments import cli
from eairl_jax.experiments.commands import bench
from eairl_jax.experiments.display.plots import Row, print_table
from eairl_jax.experiments.paper import plan
from eairl_jax.experiments.paper.plan import Entry
from eairl_jax.experiments.pipeline import train, transfer
from eairl_jax.experiments.pipeline.learn import describe, prepare, untrained
from eairl_jax.experiments.pipeline.retrain import as_target
from eairl_jax.experiments.pipeline.run_folder import digest
from eairl_jax.experiments.pipeline.select import Rule
from eairl_jax.experiments.recipes import parse_overrides, recipe
from eairl_jax.methods import METHODS, names


def run(*arguments):
    """Runs `eairl` and returns its exit code."""
    try:
        cli.main([str(a) for a in arguments])
    except SystemExit as e:
        return e.code
    return 0


def rl_settings(tiny):
    """Those of `tiny` that retraining has too."""
    return [a for a in tiny if not a.startswith(("history", "discriminator", "empowerment", "hidden"))]


def imitate(out, tiny, *more):
    return run("imitate", "pendulum", "--seeds", 2, *more, "--out", out, "--set", *tiny)


def rows_of(folder):
    """The rows of `metrics.csv`, as text."""
    with open(folder / "metrics.csv", newline="") as f:
        return list(csv.DictReader(f))


def table(capsys):
    """What was printed; the lines of its tables fit the 80 columns of a terminal, their cells are whole."""
    printed = capsys.readouterr().out
    lines = [line for line in printed.splitlines() if re.search("[─━│┃]", line)]
    assert lines
    assert max(map(len, lines)) <= 80
    assert "…" not in "".join(lines)
    return printed


@pytest.fixture(autouse=True)
def columns(monkeypatch):
    """A terminal of 80 columns."""
    monkeypatch.setenv("COLUMNS", "80")


def test_imitate_leaves_what_it_promises(finished, tiny, capsys):
    folder, before = finished, (finished / "metrics.csv").stat().st_mtime_ns
    assert imitate(folder, tiny) == 0  # computes nothing, and prints the same score
    assert (folder / "metrics.csv").stat().st_mtime_ns == before
    summary = json.loads((folder / "summary.json").read_text())
    promised = ["command", "task", "target", "method", "seeds", "env_steps", "compile_seconds", "run_seconds",
                "expert", "random", "returns", "mean", "std", "normalized"]  # fmt: skip
    assert set(promised) <= set(summary)
    assert summary["env_steps"] == 4 * 2 * 20
    scale = summary["expert"] - summary["random"]
    assert summary["normalized"] == pytest.approx((np.mean(summary["returns"]) - summary["random"]) / scale)
    rows = rows_of(folder)
    assert [(r["seed"], r["iteration"]) for r in rows] == [(str(s), str(i)) for i in range(1, 5) for s in range(2)]
    wanted = {"true_return", "discriminator_loss", "accuracy", "reward_policy", "reward_expert", "empowerment", "l_i",
              "l_q", "kl", "entropy", "value_loss"}  # fmt: skip
    assert wanted <= set(rows[0])
    assert (folder / "curves.png").read_bytes().startswith(b"\x89PNG")
    assert "normalized" in table(capsys)
    reward = load_reward(folder / "reward", 3, 1)
    assert np.isfinite(reward(np.ones(3), np.ones(1), seed=1))


def test_a_killed_run_goes_on_bit_identically(finished, tmp_path, tiny, monkeypatch):
    class Killed(Checkpoints):
        """Dies before the second checkpoint: the second chunk's metrics are on disk, its state is not."""

        def save(self, iteration, state):
            if iteration == 4:
                raise KeyboardInterrupt
            super().save(iteration, state)

    monkeypatch.setattr(train, "Checkpoints", Killed)
    assert imitate(tmp_path / "killed", tiny) == 130
    assert Checkpoints(tmp_path / "killed" / "checkpoints").latest() == 2
    monkeypatch.setattr(train, "Checkpoints", Checkpoints)
    assert imitate(tmp_path / "killed", tiny) == 0
    for name in ("metrics.csv", "reward/reward.npz"):
        assert (tmp_path / "killed" / name).read_bytes() == (finished / name).read_bytes(), name
    states = [read_state(folder) for folder in (finished, tmp_path / "killed")]
    assert states[0].keys() == states[1].keys()
    for name, leaf in states[0].items():
        np.testing.assert_array_equal(leaf, states[1][name], err_msg=name)


def read_state(folder):
    """The last checkpoint's leaves."""
    import orbax.checkpoint as ocp

    manager = ocp.CheckpointManager((folder / "checkpoints").resolve())
    return manager.restore(4, args=ocp.args.StandardRestore())


def test_methods_side_by_side(tmp_path, tiny, capsys):
    """One table, a folder a row; behaviour cloning is a method like any other, but learns no reward."""
    assert imitate(tmp_path, tiny, "--method", "eairl", "bc") == 0
    printed = table(capsys)
    assert printed.count("Imitation of pendulum") == 1
    assert {path.name for path in tmp_path.iterdir()} == {"eairl-sa", "bc"}
    for name in ("eairl-sa", "bc"):
        summary = json.loads((tmp_path / name / "summary.json").read_text())
        assert summary["row"] == name
        line = next(line for line in printed.splitlines() if line.startswith(f"│ {name} "))
        assert f"{summary['mean']:.2f} ± {summary['std']:.2f}" in line
        assert f"{summary['normalized']:.3f}" in line
        assert (tmp_path / name / "curves.png").is_file()
        for reward in ("reward", "snapshots"):
            assert (tmp_path / name / reward).exists() == (name != "bc")
    assert {"log_prob_expert", "true_return"} <= set(rows_of(tmp_path / "bc")[0])
    assert "accuracy" not in rows_of(tmp_path / "bc")[0]


def test_the_policy_by_trpo(tmp_path, tiny):
    own = [a for a in tiny if not a.startswith("empowerment")]
    assert imitate(tmp_path / "run", [*own, "kl_limit=0.003"], "--method", "gail", "--optimizer", "trpo") == 0
    settings = json.loads((tmp_path / "run" / "config.json").read_text())["settings"]
    assert settings["config"]["optimizer"] == "trpo"
    rows = rows_of(tmp_path / "run")
    assert all(0 <= float(r["kl"]) <= 0.003 * 1.001 for r in rows)
    assert max(float(r["kl"]) for r in rows) > 1e-3
    assert all(float(r["step_fraction"]) in (0.0, *(0.5 ** np.arange(10))) for r in rows)


def test_a_sweep_is_its_single_runs_side_by_side(tmp_path, tiny, capsys):
    arguments = ["sweep", "pendulum", "--seeds", 2, "--out", tmp_path / "sweep", "--set", *tiny]
    arguments += ["lambda_i=0,10", "gradient_penalty=0,1"]
    assert run(*arguments) == 0
    printed = table(capsys)
    summary = json.loads((tmp_path / "sweep" / "summary.json").read_text())["rows"]
    points = [(i, g) for i in (0.0, 10.0) for g in (0.0, 1.0)]
    assert [(r["point"]["lambda_i"], r["point"]["gradient_penalty"]) for r in summary] == points
    for row, (i, g) in zip(summary, points, strict=True):
        line = next(line for line in printed.splitlines() if f"lambda_i {i:g}, gradient_penalty {g:g} " in line)
        assert f"{row['mean']:.2f} ± {row['std']:.2f}" in line
    assert (tmp_path / "sweep" / "curves.png").read_bytes().startswith(b"\x89PNG")
    swept = rows_of(tmp_path / "sweep")
    assert len(swept) == 4 * len(points) * 2
    curves, returns = {}, []
    for point, row in zip(points, summary, strict=True):
        curves[point] = [r for r in swept if (float(r["lambda_i"]), float(r["gradient_penalty"])) == point]
        if point[1]:
            continue
        single = tmp_path / f"single {point}"
        assert imitate(single, [*tiny, f"lambda_i={point[0]}"]) == 0
        alone = rows_of(single)
        numbers = [[[float(r[name]) for name in alone[0]] for r in rows] for rows in (curves[point], alone)]
        np.testing.assert_allclose(*numbers, rtol=1e-3, atol=1e-4)
        returns.append((row["returns"], json.loads((single / "summary.json").read_text())["returns"]))
    losses = {tuple(float(r["policy_loss"]) for r in rows) for rows in curves.values()}
    assert len(losses) == len(points), "every setting counts"
    # The same command again computes nothing.
    before = (tmp_path / "sweep" / "metrics.csv").stat().st_mtime_ns
    assert run(*arguments) == 0
    assert (tmp_path / "sweep" / "metrics.csv").stat().st_mtime_ns == before
    for together, alone in returns:
        np.testing.assert_allclose(together, alone, rtol=1e-3, err_msg="scored in the same episodes")


def test_another_first_seed(finished, tmp_path, tiny):
    """A run's random numbers are those of its seed, not of its place among the others."""
    assert run("imitate", "pendulum", "--seeds", 1, "--first-seed", 1, "--out", tmp_path / "one", "--set", *tiny) == 0
    both, one = ([r for r in rows_of(folder) if r["seed"] == "1"] for folder in (finished, tmp_path / "one"))
    assert len(both) == 4
    np.testing.assert_allclose(*([[float(x) for x in r.values()] for r in rows] for rows in (both, one)), rtol=1e-3)
    summaries = [json.loads((folder / "summary.json").read_text()) for folder in (finished, tmp_path / "one")]
    assert [s["seeds"] for s in summaries] == [[0, 1], [1]]


def test_bench_measures_methods_in_turns(tmp_path, tiny, monkeypatch, capsys):
    monkeypatch.setattr(bench, "ROUNDS", 1)
    path = tmp_path / "figures" / "bench.json"
    assert run("bench", "pendulum", "--method", "eairl", "gail", "--iterations", 2, "--json", path, "--set", *tiny) == 0
    printed = table(capsys)
    written = json.loads(path.read_text())
    simulation, rows = written["simulation"], written["rows"]
    assert (simulation["devices"], simulation["envs"]) == (2, 4)
    ratio = simulation["mjx_steps_per_second"] / simulation["c_steps_per_second"]
    assert simulation["mjx_over_c"] == pytest.approx(ratio)
    assert f"MJX over C {ratio:.2f}" in printed
    assert list(rows) == ["eairl-sa", "gail-sa"]
    stages = {"simulation alone", "rollout", "discriminator", "policy", "iteration", "iteration, five seeds"}
    for name, row in rows.items():
        assert row["env_steps_per_iteration"] == 40
        ms = row["milliseconds"]
        assert set(ms) == stages | ({"empowerment"} if name == "eairl-sa" else set())
        assert all(np.isfinite(x) and x > 0 for x in ms.values())
        assert row["iteration_over_simulation"] == pytest.approx(ms["simulation alone"] / ms["iteration"])
        assert row["five_seeds_over_one"] == pytest.approx(ms["iteration, five seeds"] / ms["iteration"])
        assert row["iteration_steps_per_second"] == pytest.approx(40 / (1e-3 * ms["iteration"]))
        assert set(row["compile_seconds"]) == {"1", "5"}
        assert printed.count(name) >= 2, "a table of its own and a row beside the others"
    ratio = rows["gail-sa"]["milliseconds"]["iteration"] / rows["eairl-sa"]["milliseconds"]["iteration"]
    assert f"{ratio:.2f}" in next(line for line in reversed(printed.splitlines()) if "gail-sa" in line)


def test_a_saturated_discriminator_is_told(finished, tiny, capsys):
    path, rows = finished / "metrics.csv", rows_of(finished)
    for right, told in ((0, False), (2, False), (3, True), (4, True)):  # iterations of 4
        with open(path, "w", newline="") as f:
            writer = csv.DictWriter(f, rows[0])
            writer.writeheader()
            for r in rows:
                nearly_all = r["seed"] == "1" and int(r["iteration"]) <= right
                writer.writerow(r | {"accuracy": "0.995" if nearly_all else "0.98"})
        capsys.readouterr()
        assert imitate(finished, tiny) == 0
        printed = capsys.readouterr().out
        assert ("accuracy in most iterations (seed 1)" in printed) == told, right
        assert ("discriminator_lr" in printed) == told


@pytest.mark.parametrize(
    "name", ["gan_gcl-separable", "eairl_release-separable", "lambda_i 0.001, gradient_penalty 0.5, policy_lr 0.0003"]
)
def test_tables_fit_80_columns(name, capsys):
    rows = [Row(name, np.array([-1226.05, -1181.27]), (-116.26, 8.313), -0.123, "reward of iteration 120")]
    print_table("Reward learned in point_maze_left, used in point_maze_right: true return, 25 seeds", rows)
    printed = table(capsys)
    for cell in ("-1203.66 ± 22.39", "-116.26 ± 8.31", "-0.123"):
        assert cell in printed
    first_column = "".join(line.split("│")[1] for line in printed.splitlines() if line.startswith("│"))
    assert "".join(first_column.split()) == "".join(name.split()), "a long name may be broken, not cut"


@pytest.mark.parametrize("command", ["imitate", "transfer", "bench"])
def test_the_help_names_every_method(command, capsys):
    assert run(command, "--help") == 0
    text = " ".join(re.sub("[│╭╮╰╯─]", " ", capsys.readouterr().out).split())
    assert re.search(r"One or more of (.*?) \(to imitate\);", text)[1].split(", ") == list(names())


def test_a_setting_of_one_of_the_methods_is_accepted():
    jobs = prepare("pendulum", ("eairl", "gail"), ("default",), range(1), None, "imitate", ("lambda_i=1",))
    assert [job.row for job in jobs] == ["eairl-sa", "gail-sa"]
    assert jobs[0].recipe.hparams.lambda_i == 1.0


def test_tuned_settings_make_a_row_of_their_own_and_give_way_to_a_users():
    (papers,), (changed,), (ours,) = (
        prepare("ant", ("eairl",), ("default",), range(1), None, "imitate", own, tuned)
        for own, tuned in ((("optimizer=trpo", "iterations=120"), False), (("ppo_epochs=3",), False),
                           (("ppo_epochs=3",), True))
    )  # fmt: skip
    assert (papers.row, changed.row, ours.row) == ("eairl-sa", "eairl-sa", "eairl-sa+tuned")
    assert [job.is_published for job in (papers, changed, ours)] == [True, False, False]
    assert (papers.recipe.config.actions, ours.recipe.config.actions) == ("sampled", "clipped")
    assert ours.recipe.config.ppo_epochs == 3
    assert changed.recipe.config.iterations == ours.recipe.config.iterations


def test_a_setting_that_one_form_reads_is_accepted_beside_others():
    for _ in range(2):  # what is refused once is not refused for ever
        jobs = prepare("pendulum", ("eairl",), ("sa", "separable"), range(1), None, "imitate", ("action_part=net",))
        assert [job.recipe.config.action_part for job in jobs] == ["net", "net"]


def test_transfer_scores_a_chosen_reward(tmp_path, tiny, capsys):
    arguments = ["transfer", "point_maze_left", "point_maze_right", "--reward-form", "separable", "--seeds", 2]
    settings = ["--set", *tiny, "--retrain-set", *rl_settings(tiny)]
    assert run(*arguments, "--out", tmp_path / "run", *settings) == 0
    (folder,), (learned,) = ((tmp_path / "run").glob(f"{name}-*") for name in ("transfer", "learn"))
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["target"] == "point_maze_right"
    source = np.array(summary["source_returns"])  # [snapshot, seed]
    chosen = [summary["snapshots"][best] for best in source.argmax(axis=0)]
    assert summary["chosen_iterations"] == chosen
    reward = load_reward(folder / "reward")
    assert reward.description["iterations"] == chosen
    for seed, iteration in enumerate(chosen):
        snapshot = load_reward(learned / "snapshots" / f"{iteration:06d}")
        obs, action = np.array([0.1, 0.2]), np.array([0.3, -0.4])
        assert reward(obs, action, seed) == snapshot(obs, action, seed)
    assert len(summary["ceiling"]) == 2
    # The policies that were kept of the restarts can be scored again, also by the C engine.
    figures = tmp_path / "figures.json"
    assert run("evaluate", folder, "--engine", "c", "--episodes", 2, "--json", figures) == 0
    returns = json.loads(figures.read_text())["returns"]
    np.testing.assert_allclose(np.mean(returns["MJX"], axis=1), summary["returns"], rtol=1e-5)
    np.testing.assert_allclose(returns["C engine"], returns["MJX"], rtol=0.02)
    # And the artefact can be put to use again.
    assert run("transfer", "point_maze_right", "point_maze_left", "--reward", folder / "reward") == 2
    assert "was learned in point_maze_left, not in point_maze_right" in capsys.readouterr().err
    again = ["transfer", "point_maze_left", "point_maze_right", "--reward", folder / "reward"]
    assert run(*again, "--out", tmp_path / "again", "--retrain-set", *rl_settings(tiny)) == 0
    (folder,) = (tmp_path / "again").glob("reuse-*")
    reused = json.loads((folder / "summary.json").read_text())
    assert reused["returns"] == summary["returns"]


def test_expert_and_demos_make_what_imitate_reads(tmp_path, tiny, monkeypatch, capsys):
    assert run("expert", "pendulum", "--seeds", 2, "--out", tmp_path / "expert", "--set", *rl_settings(tiny)) == 0
    path = tmp_path / "pendulum.npz"
    assert run("demos", "pendulum", "--expert", tmp_path / "expert", "--episodes", 3, "--out", path) == 0
    provenance = json.loads(path.with_suffix(".json").read_text())
    with np.load(path, allow_pickle=False) as arrays:
        assert arrays["obs"].shape == (3, 200, 3)
        np.testing.assert_allclose(arrays["reward"].sum(axis=1), provenance["returns"], rtol=1e-5)
    assert provenance["expert"]["chosen_seed"] in (0, 1)
    arguments = ["imitate", "pendulum", "--seeds", 2, "--demos", path, "--out", tmp_path / "run", "--set", *tiny]
    assert run(*arguments) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["expert"] == provenance["expert_return"]
    figures = tmp_path / "figures.json"
    assert run("evaluate", tmp_path / "run", "--episodes", 2, "--json", figures) == 0
    returns = json.loads(figures.read_text())["returns"]
    assert list(returns) == ["MJX"]
    np.testing.assert_allclose(np.mean(returns["MJX"], axis=1), summary["returns"], rtol=1e-5)
    # An episode of it can be looked at, with pictures or, where nothing can draw, without.
    monkeypatch.setenv("MUJOCO_GL", "disable")
    assert run("view", tmp_path / "run", "--seed", 1, "--out", tmp_path / "view") == 0
    assert "no pictures: this machine cannot draw with OpenGL" in capsys.readouterr().out
    assert [path.name for path in (tmp_path / "view").iterdir()] == ["episode.html"]
    assert run("view", tmp_path / "run", "--seed", 7) == 2
    assert "--seed 7: the run has seeds 0, 1" in capsys.readouterr().err
    assert run("evaluate", tmp_path / "run", "--json", tmp_path) == 2
    assert "cannot write" in capsys.readouterr().err
    # An imitator is no expert.
    assert run("demos", "pendulum", "--expert", tmp_path / "run", "--out", tmp_path / "no.npz") == 2
    assert "no expert of pendulum" in capsys.readouterr().err
    shutil.rmtree(tmp_path / "run" / "checkpoints")
    assert run("evaluate", tmp_path / "run") == 2
    assert "has lost its last checkpoint" in capsys.readouterr().err


def test_nan_stops_the_run_and_keeps_the_last_good_checkpoint(tmp_path, tiny, monkeypatch, capsys):
    from eairl_jax import Lanes

    run_lanes = Lanes.run

    def poisoned(self, state, length):
        state, metrics = run_lanes(self, state, length)
        if (tmp_path / "run" / "snapshots" / "000002").exists():
            metrics["value_loss"] = metrics["value_loss"].copy()
            metrics["value_loss"][1, 1] = np.nan
        return state, metrics

    monkeypatch.setattr(Lanes, "run", poisoned)
    assert imitate(tmp_path / "run", tiny) == 1
    message = capsys.readouterr().err
    assert "value_loss" in message
    assert "iteration 4" in message
    assert Checkpoints(tmp_path / "run" / "checkpoints").latest() == 2


def damaged(folder, change):
    """A copy of the shipped pendulum demonstrations with one thing wrong."""
    from eairl_jax.experiments.pipeline.scores import shipped

    with np.load(shipped("pendulum")) as archive:
        arrays = change(dict(archive))
    path = folder / "damaged.npz"
    np.savez(path, **arrays)
    return path


REFUSED = {
    "unknown task": (["imitate", "pendulm"], "did you mean pendulum"),
    "unknown method": (["imitate", "pendulum", "--method", "eairll"], "did you mean eairl"),
    "unknown setting": (["imitate", "pendulum", "--set", "lamda_i=1"], "did you mean lambda_i"),
    "no value": (["imitate", "pendulum", "--set", "lambda_i"], "expected name=value"),
    "wrong type": (["imitate", "pendulum", "--set", "num_envs=many"], "expected something like num_envs="),
    "indivisible batch": (["imitate", "pendulum", "--set", "ppo_minibatches=7"], "divisor"),
    "negative rate": (["imitate", "pendulum", "--set", "policy_lr=-1"], "policy_lr"),
    "snapshots": (["imitate", "pendulum", "--set", "iterations=50"], "snapshot_every=25"),
    "nothing tuned": (["imitate", "pendulum", "--tuned"], "half_cheetah"),
    "a temperature of its own": (["imitate", "pendulum", "--set", "temperature=1"], "temperature: not a setting of"),
    "no seeds": (["imitate", "pendulum", "--seeds", "0"], "at least 1"),
    "sizes": (["transfer", "pendulum", "point_maze_left"], "same sizes"),
    "unknown rule": (["transfer", "point_maze_left", "point_maze_right", "--rule", "best"], "source_retrain"),
    "unkept iteration": (["transfer", "point_maze_left", "point_maze_right", "--rule", "iteration=7"], "no snapshot"),
    "no reward": (["transfer", "point_maze_left", "point_maze_right", "--reward", "nowhere"], "reward.json"),
    "learning beside a learned reward": (
        ["transfer", "point_maze_left", "point_maze_right", "--reward", "nowhere", "--seeds", "2", "--rule", "last"],
        "--seeds, --rule: of learning a reward",
    ),
    "no expert": (["demos", "pendulum", "--expert", "nowhere"], "eairl expert pendulum"),
    "nothing to transfer": (["transfer", "point_maze_left", "point_maze_right", "--method", "bc"], "learns no reward"),
    "another method's setting": (["imitate", "pendulum", "--method", "gail", "--set", "lambda_i=1"], "leave it out"),
    "cut trajectories": (["imitate", "pendulum", "--method", "gan_gcl", "--set", "rollout_length=150"], "multiple"),
    "no trust region": (["imitate", "pendulum", "--optimizer", "trpo", "--set", "kl_limit=0"], "kl_limit"),
    "PPO's setting": (["imitate", "pendulum", "--optimizer", "trpo", "--set", "clip_eps=0.1"], "clip_eps"),
    "TRPO's setting": (["imitate", "pendulum", "--set", "kl_limit=0.1"], "not a setting of eairl with ppo"),
    "sweep of an integer": (["sweep", "pendulum", "--set", "num_envs=5,10"], "only floats"),
    "sweep of nothing": (["sweep", "pendulum", "--set", "lambda_i=1"], "give a list of values"),
    "a bad point": (["sweep", "pendulum", "--set", "gradient_penalty=0,-1"], "gradient_penalty = -1.0"),
    "sweep of no setting": (["sweep", "pendulum", "--set", "lamda_i=0,1"], "did you mean lambda_i"),
    "penalties": (["imitate", "pendulum", "--set", "penalties=gradient"], "gradient_penalty="),
    "clipped cloning": (["imitate", "pendulum", "--method", "bc", "--set", "clip_eps=0.1"], "clip_eps"),
    "no experts": (["expert", "pendulum", "--seeds", "0"], "at least 1"),
    "bench of bc": (["bench", "pendulum", "--method", "bc"], "not adversarial"),
    "evaluation of nothing": (["evaluate", "nowhere"], "no run's folder"),
    "view of nothing": (["view", "nowhere"], "no run's folder"),
    "brackets": (["evaluate", "[/x]"], "[/x] is no run's folder"),
    "snapshots of nothing": (["imitate", "pendulum", "--set", "snapshot_every=0"], "snapshot_every = 0"),
    "one episode": (["evaluate", "nowhere", "--episodes", "1"], "at least 2"),
    "std that ends at nothing": (["imitate", "pendulum", "--set", "std_final_fraction=0"], "std_final_fraction = 0.0"),
    "actions that a reward does not know": (
        ["transfer", "point_maze_left", "point_maze_right", "--retrain-set", "actions=clipped"],
        "give --set actions",
    ),
    "no quick row": (["reproduce", "table1", "--quick", "--task", "pendulum"], "no quick row"),
    "missing demonstrations": (["imitate", "pendulum", "--demos", "nowhere.npz"], "is not there"),
}


@pytest.mark.parametrize("arguments, hint", REFUSED.values(), ids=REFUSED)
def test_bad_input_is_one_clear_message(arguments, hint, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(*arguments) == 2
    error = capsys.readouterr().err
    assert hint in error
    assert "Traceback" not in error
    assert not list(tmp_path.iterdir()), "nothing is written before the input is checked"


DAMAGES = {
    "another task": (lambda a: a | {"task": np.asarray("ant")}, "ant"),
    "wrong shape": (lambda a: a | {"action": a["action"][:, :-1]}, "expected"),
    "NaN": (lambda a: a | {"obs": np.full_like(a["obs"], np.nan)}, "NaN or infinite at episode 0, step 0"),
    "missing array": (lambda a: {k: v for k, v in a.items() if k != "next_obs"}, "lacks next_obs"),
    "other sizes": (lambda a: a | {"obs": a["obs"][..., :2]}, "expected"),
}


@pytest.mark.parametrize("change, hint", DAMAGES.values(), ids=DAMAGES)
def test_damaged_demonstrations_are_refused(change, hint, tmp_path, capsys):
    assert run("imitate", "pendulum", "--demos", damaged(tmp_path, change), "--out", tmp_path / "run") == 2
    assert hint in capsys.readouterr().err


def test_a_folder_of_another_run_is_refused(finished, tmp_path, tiny, capsys):
    assert run("imitate", "pendulum", "--seeds", 1, "--out", finished, "--set", *tiny) == 2
    assert "different run (seeds: there [0, 1], here [0])" in capsys.readouterr().err
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("")
    assert imitate(tmp_path / "other", tiny) == 2
    assert "no run's folder" in capsys.readouterr().err


def test_a_setting_that_is_new_leaves_an_older_run_what_it_was(finished, tiny, capsys):
    path = finished / "config.json"
    content = json.loads(path.read_text())
    before = digest(content["settings"])
    del content["settings"]["config"]["actions"]  # as a version wrote it that did not know of it
    assert digest(content["settings"]) == before
    path.write_text(json.dumps(content))
    assert imitate(finished, tiny) == 0
    content["settings"]["config"]["actions"] = "clipped"
    assert digest(content["settings"]) != before
    path.write_text(json.dumps(content))
    assert imitate(finished, tiny) == 2
    assert "config.actions: there 'executed', here 'drawn'" in capsys.readouterr().err


def test_a_disk_that_fails_is_reported_and_nothing_is_lost(tmp_path, tiny, monkeypatch, capsys):
    from eairl_jax.experiments.pipeline.run_folder import RunFolder

    def full(*_arguments, **_more):
        raise OSError(28, "No space left on device", "metrics.csv")

    with monkeypatch.context() as patch:
        patch.setattr(RunFolder, "append_metrics", full)
        assert imitate(tmp_path / "run", tiny) == 2
    assert "No space left" in capsys.readouterr().err
    assert imitate(tmp_path / "run", tiny) == 0
    (tmp_path / "file").write_text("")
    assert imitate(tmp_path / "file" / "run", tiny) == 2
    assert "cannot write" in capsys.readouterr().err


def test_reproduce_trains_what_is_missing(tmp_path, tiny, monkeypatch, capsys):
    entries = [Entry(task, "bc") for task in ("pendulum", "point_maze_left", "ant")]
    monkeypatch.setattr(plan, "EXPERIMENTS", {"table2": entries})
    monkeypatch.setattr(plan, "short", lambda quick: tiny[:2] + tiny[-2:])
    arguments = ["reproduce", "table2", "--quick", "--out", tmp_path]  # of these tasks the ant is not a quick one
    assert run(*arguments) == 0
    printed = capsys.readouterr().out
    assert "table2: pendulum, 2 seeds" in printed
    rows = json.loads((tmp_path / "table2.json").read_text())["rows"]
    assert [(r["row"], r["task"], r["target"], r["seeds"]) for r in rows] == [
        ("bc", "point_maze_left", None, [20, 21]), ("bc", "pendulum", None, [20, 21]),
    ]  # fmt: skip
    assert rows[1]["settings"]["config"]["method"] == "bc"
    assert rows[0]["machine"]["versions"]["jax"]
    # Only the row that was lost is trained again.
    (tmp_path / "imitate-pendulum-bc" / "summary.json").unlink()
    monkeypatch.setattr("eairl_jax.Lanes.run", lambda *_: pytest.fail("trained again"))
    assert run(*arguments) == 0
    again = json.loads((tmp_path / "table2.json").read_text())["rows"]
    assert [r["returns"] for r in again] == [r["returns"] for r in rows]
    # Rows of other seeds or settings are not replaced.
    capsys.readouterr()
    with monkeypatch.context() as patch:
        patch.setattr(plan, "QUICK_SEEDS", 1)
        assert run(*arguments) == 2
        assert "holds bc of point_maze_left with seeds 20 to 21" in capsys.readouterr().err
    monkeypatch.setattr(plan, "short", lambda quick: (*tiny[:2], *tiny[-2:], "policy_lr=0.5"))
    assert run(*arguments) == 2
    assert "holds bc of point_maze_left with other settings" in capsys.readouterr().err


@pytest.mark.parametrize("task", envs.TASKS)
def test_every_method_has_a_recipe_for_every_task(task):
    for purpose in ("imitate", "reward"):
        jobs = prepare(task, names(), ("default",), range(1), None, purpose, ())
        assert [job.recipe.config.method for job in jobs] == list(names())


def test_every_entry_is_checked_before_anything_is_trained():
    for listed in plan.EXPERIMENTS.values():
        assert len({entry.identity for entry in listed}) == len(listed)
        seen = {}
        for entry in listed:
            key = dataclasses.replace(entry, rule="last", target=entry.target and "any")
            job = seen.setdefault(key, None) or plan.prepare(entry, 5, quick=False)
            seen[key] = job
            assert entry.row == "+".join(filter(None, (job.row, plan.retrain_variant(entry.retrain))))
            if entry.target:
                overrides = parse_overrides(entry.retrain)
                Rule.parse(entry.rule, job.recipe, recipe(entry.task, job.env, "retrain", overrides))


@pytest.mark.slow
def test_reproduce_draws_and_reports(tmp_path, tiny, monkeypatch, capsys):
    pair = ("point_maze_left", "point_maze_right")
    eairl = [Entry(pair[0], "eairl", "default", pair[1], rule) for rule in ("last", "policy", "random")]
    changed = Entry(pair[0], "eairl", "default", pair[1], settings=("lambda_i=0",))
    retrained = Entry(pair[0], "eairl", "default", pair[1], retrain=("entropy_weight=1",))
    monkeypatch.setattr(plan, "EXPERIMENTS", {"table1": eairl, "table2": [], "ablations": [changed, retrained]})
    monkeypatch.setattr(plan, "short", lambda quick: tiny[:2] + tiny[-2:])
    monkeypatch.setattr("eairl_jax.experiments.paper.reward_distance.TRANSITIONS", 16)
    assert run("reproduce", "all", "--quick", "--out", tmp_path) == 0
    rows = json.loads((tmp_path / "table1.json").read_text())["rows"]
    assert [(r["rule"], r["target"]) for r in rows] == [
        ("last", pair[1]), ("policy", pair[1]), ("random", pair[1]),
    ]  # fmt: skip
    last, policy, random = rows
    assert set(last["closeness"]) == {"source", "target"}
    assert len(last["closeness"]["target"]["epic"]) == 2
    # What the kept restarts were worth to the reward in their last iteration.
    ended = [r for r in rows_of(tmp_path / "transfer-point_maze_left-to-point_maze_right-eairl-sa-last")
             if r["iteration"] == "4"]  # fmt: skip
    kept = [max(float(r["policy_reward"]) for r in ended if r["seed"] == seed) for seed in ("20", "21")]
    np.testing.assert_allclose(last["closeness"]["target"]["worth, retrained"], kept, rtol=1e-5)
    # The policy was moved as it was, and the random reward is that of before learning.
    assert "curve" not in policy
    assert random["chosen_iterations"] == [0, 0]
    # The mazes differ by their barrier alone, which hardly anybody has reached after so little training.
    np.testing.assert_allclose(policy["returns"], last["imitation_returns"], rtol=0.2)
    assert (tmp_path / "figure2.png").stat().st_size > 10_000
    assert (tmp_path / "appendix-c-point_maze_left.png").stat().st_size > 10_000
    changed_row, retrained_row = json.loads((tmp_path / "ablations.json").read_text())["rows"]
    assert changed_row["row"] == "eairl-sa+lambda_i=0"
    assert [r["is_published"] for r in (last, changed_row, retrained_row)] == [True, False, False]
    # Retrained by other settings, on the reward that the table's row learned.
    assert retrained_row["row"] == "eairl-sa+retrain_entropy_weight=1"
    assert retrained_row["retrain_settings"]["retrain_hparams"]["entropy_weight"] == 1
    assert retrained_row["imitation_returns"] == last["imitation_returns"]
    assert retrained_row["returns"] != last["returns"]
    assert len(list(tmp_path.glob("learn-*"))) == 2
    page = tmp_path / "report.html"
    assert run("report", "--results", tmp_path, "--out", page) == 0
    text = page.read_text()
    assert "point_maze_left to point_maze_right" in text
    assert "EAIRL, lambda_i=0" in text
    assert not re.search(r'(src|href)="http', text)
    # Nothing is trained twice, and the second page is the first.
    monkeypatch.setattr("eairl_jax.Lanes.run", lambda *_: pytest.fail("trained again"))
    assert run("reproduce", "all", "--quick", "--out", tmp_path) == 0
    assert run("report", "--results", tmp_path, "--out", page) == 0
    assert page.read_text() == text


def test_the_cheapest_rows_come_first():
    ant, maze = (Entry(source, "eairl", target=target) for source, target in (plan.ANTS, plan.MAZES[0]))
    planned = {"table1": [ant, maze], "ablations": [maze], "table2": [Entry("ant", "bc"), Entry("pendulum", "bc")]}
    assert [(experiment, entry.task, entry.target) for experiment, entry in plan.cheapest_first(planned)] == [
        ("table1", "point_maze_left", "point_maze_right"), ("table2", "pendulum", None), ("table2", "ant", None),
        ("table1", "ant", "crippled_ant"), ("ablations", "point_maze_left", "point_maze_right"),
    ]  # fmt: skip


def test_a_report_of_nothing_is_refused(tmp_path, capsys):
    assert run("report", "--results", tmp_path) == 2
    assert "holds no results" in capsys.readouterr().err
    for content, hint in (({}, "holds no rows"), ({"rows": [{"row": "bc"}]}, "row 0 of")):
        (tmp_path / "table2.json").write_text(json.dumps(content))
        assert run("report", "--results", tmp_path) == 2
        assert hint in capsys.readouterr().err


def test_another_reward_at_the_same_place_is_another_run(tmp_path, monkeypatch):
    target = as_target("pendulum", envs.make("pendulum"), ())
    monkeypatch.setattr(transfer, "reuse", lambda folder, *_: folder.finish({"returns": [1.0]}))
    (job,) = prepare("pendulum", ("airl_s",), ("default",), range(1), None, "reward", ())
    reward = describe(job, untrained(job), [0])
    path = tmp_path / "run" / "reward"
    for _ in range(2):
        transfer.from_artefact(reward, path, target, tmp_path, "")
    other = LearnedReward(reward.description, reward.config, jax.tree.map(lambda leaf: leaf + 1, reward.params))
    with pytest.raises(InputError, match="different run"):
        transfer.from_artefact(other, path, target, tmp_path, "")


def test_an_experiment_without_the_task_is_refused(capsys):
    assert run("reproduce", "table1", "--task", "pendulum") == 2
    assert "--task pendulum: table1 has ant, point_maze_left, point_maze_right" in capsys.readouterr().err


@pytest.mark.slow
def test_every_method_moves_its_reward_to_the_crippled_ant(tmp_path, tiny):
    arguments = ["transfer", "ant", "crippled_ant", "--method", *METHODS, "--seeds", 1, "--restarts", 1]
    settings = ["--set", *tiny, "rollout_length=500", "--retrain-set", *rl_settings(tiny)]
    assert run(*arguments, "--rule", "last", "--out", tmp_path, *settings) == 0
    folders = list(tmp_path.glob("transfer-ant-to-crippled_ant-*"))
    assert len(folders) == len(METHODS)
    for folder in folders:
        assert np.isfinite(json.loads((folder / "summary.json").read_text())["returns"]).all()
        assert load_reward(folder / "reward").description["task"] == "ant"
