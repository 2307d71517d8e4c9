"""The command line: bad input is one clear message, and help is fast."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

import eairl_jax
from eairl_jax.experiments import cli
from eairl_jax.experiments.options import COMMANDS, Imitate
from eairl_jax.experiments.pipeline.places import make_env, shipped_demonstrations
from eairl_jax.methods import method_names

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("command", ["imitate", "transfer", "bench"])
def test_the_help_names_every_method(command, capsys, run):
    assert run(command, "--help") == 0
    text = " ".join(re.sub("[│╭╮╰╯─]", " ", capsys.readouterr().out).split())
    assert re.search(r"One or more of (.*?) \(to imitate\),", text)[1].split(", ") == list(method_names())
    assert "or FILE.py:NAME for a method of yours" in text


REFUSED = {
    "unknown task": (["imitate", "pendulm"], "did you mean pendulum"),
    "unknown method": (["imitate", "pendulum", "--method", "eairll"], "did you mean eairl"),
    "unknown setting": (["imitate", "pendulum", "--set", "lamda_i=1"], "did you mean lambda_i"),
    "no value": (["imitate", "pendulum", "--set", "lambda_i"], "expected name=value"),
    "wrong type": (["imitate", "pendulum", "--set", "num_envs=many"], "expected something like num_envs="),
    "indivisible batch": (["imitate", "pendulum", "--set", "ppo_minibatches=7"], "divisor"),
    "negative rate": (["imitate", "pendulum", "--set", "policy_lr=-1"], "policy_lr"),
    "snapshots": (["imitate", "pendulum", "--set", "iterations=1009"], "snapshot_every=1"),
    "nothing tuned": (["imitate", "pendulum", "--tuned"], "half_cheetah"),
    "a temperature of its own": (["imitate", "pendulum", "--set", "temperature=1"], "temperature: not a setting of"),
    "no seeds": (["imitate", "pendulum", "--seeds", "0"], "at least 1"),
    "sizes": (["transfer", "pendulum", "point_maze_left"], "same sizes"),
    "unknown rule": (["transfer", "point_maze_left", "point_maze_right", "--rule", "best"], "source_retrain"),
    "unkept iteration": (["transfer", "point_maze_left", "point_maze_right", "--rule", "iteration=7"], "no snapshot"),
    "no reward": (["transfer", "point_maze_left", "point_maze_right", "--reward", "nowhere"], "reward.json"),
    "learning beside a learned reward": (
        ["transfer", "point_maze_left", "point_maze_right", "--reward", "nowhere", "--seeds", "2", "--rule", "last"],
        "--seeds, --rule: these options say how a reward is learned",
    ),
    "no expert": (["demos", "pendulum", "--expert", "nowhere"], "eairl expert pendulum"),
    "nothing to transfer": (["transfer", "point_maze_left", "point_maze_right", "--method", "bc"], "learns no reward"),
    "another method's setting": (["imitate", "pendulum", "--method", "gail", "--set", "lambda_i=1"], "leave it out"),
    "cut trajectories": (["imitate", "pendulum", "--method", "gan_gcl", "--set", "rollout_length=150"], "multiple"),
    "no trust region": (["imitate", "pendulum", "--optimizer", "trpo", "--set", "kl_limit=0"], "kl_limit"),
    "PPO's setting": (["imitate", "pendulum", "--optimizer", "trpo", "--set", "clip_eps=0.1"], "clip_eps"),
    "TRPO's setting": (["imitate", "pendulum", "--set", "kl_limit=0.1"], "not a setting of eairl with ppo"),
    "sweep of an impossible integer": (["sweep", "pendulum", "--set", "num_envs=5,0"], "num_envs"),
    "sweep of nothing": (["sweep", "pendulum", "--set", "lambda_i=1"], "give a list of values"),
    "a bad point": (["sweep", "pendulum", "--set", "gradient_penalty=0,-1"], "gradient_penalty = -1:"),
    "sweep of no setting": (["sweep", "pendulum", "--set", "lamda_i=0,1"], "did you mean lambda_i"),
    "penalties": (["imitate", "pendulum", "--set", "penalties=gradient"], "gradient_penalty="),
    "clipped cloning": (["imitate", "pendulum", "--method", "bc", "--set", "clip_eps=0.1"], "clip_eps"),
    "a seed that is another": (["imitate", "pendulum", "--first-seed", str(2**32 - 4)], "each from 0 to 4294967295"),
    "a huge seed": (["imitate", "pendulum", "--first-seed", "9" * 40], "each from 0 to 4294967295"),
    "too many seeds": (["expert", "pendulum", "--seeds", "9" * 40], "expected 1 to 100000 seeds"),
    "many episodes": (["evaluate", "nowhere", "--episodes", "9" * 40], "--episodes = a whole number of 133 bits"),
    "no set": (["imitate", "pendulum", "--set"], "--set has no value: give one or more, or leave --set out"),
    "a set of nothing": (["imitate", "pendulum", "--set", ""], "--set has no value"),
    "no method": (["imitate", "pendulum", "--method", "--seeds", "2"], "--method has no value"),
    "a setting twice": (["imitate", "pendulum", "--set", "beta=1", "--set", "beta=2"], "beta 2 times (beta=1, beta=2)"),
    "a method twice": (["imitate", "pendulum", "--method", "gail", "--method", "gail"], "--method has gail 2 times"),
    "an option twice": (["imitate", "pendulum", "--seeds", "2", "--seeds=3"], "--seeds is given twice"),
    "the second of two options": (
        ["imitate", "pendulum", "--set", "beta=1", "--set", "lamda=1"],
        "did you mean lambda",
    ),
    "no experts": (["expert", "pendulum", "--seeds", "0"], "at least 1"),
    "bench of bc": (["bench", "pendulum", "--method", "bc"], "not adversarial"),
    "evaluation of nothing": (["evaluate", "nowhere"], "no run's folder"),
    "view of nothing": (["view", "nowhere"], "no run's folder"),
    "brackets": (["evaluate", "[/x]"], "[/x] is no run's folder"),
    "snapshots of nothing": (["imitate", "pendulum", "--set", "snapshot_every=0"], "snapshot_every = 0"),
    "one episode": (["evaluate", "nowhere", "--episodes", "1"], "at least 2"),
    "std that ends at nothing": (["imitate", "pendulum", "--set", "std_final_fraction=0"], "std_final_fraction = 0:"),
    "actions that a reward does not know": (
        ["transfer", "point_maze_left", "point_maze_right", "--retrain-set", "actions=clipped"],
        "with --set actions=",
    ),
    "no quick row": (["reproduce", "table1", "--quick", "--task", "pendulum"], "no quick experiment"),
    "unknown environment of brax": (["imitate", "brax:hoper"], "did you mean brax:hopper"),
    "unknown argument": (["expert", "brax:hopper?backen=mjx"], "did you mean backend"),
    "no argument": (["expert", "pendulum?"], "expected name=value"),
    "no file": (["expert", "my_tasks.py:make_env"], "no file my_tasks.py in"),
    "no module": (["transfer", "pendulum", "nobodys_tasks:make_env"], "no module nobodys_tasks is installed"),
    "no environment": (["expert", "json:JSONDecoder"], "json.JSONDecoder has no function reset, step"),
    "Gymnasium": (["expert", "gymnasium:make?id=Pendulum-v1"], "which computes outside of JAX"),
    "discrete actions": (["expert", "gymnasium:make?id=CartPole-v1"], "continuous actions only"),
    "brax's wrappers": (["expert", "brax.envs:create?env_name=fast"], "use brax.envs.get_environment(...)"),
    "a reset without steps": (["expert", "brax.envs:create?env_name=fast&batch_size=3"], "AutoResetWrapper around"),
    "no demonstrations": (["imitate", "brax:fast"], "eairl demos brax:fast"),
    "missing demonstrations": (["imitate", "pendulum", "--demos", "nowhere.npz"], "does not exist"),
}


@pytest.mark.parametrize("arguments, hint", REFUSED.values(), ids=REFUSED)
def test_bad_input_is_one_clear_message(arguments, hint, tmp_path, monkeypatch, capsys, run):
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


def damaged(folder, change):
    """A copy of the shipped pendulum demonstrations with one thing wrong."""
    with np.load(shipped_demonstrations("pendulum")) as archive:
        arrays = change(dict(archive))
    path = folder / "damaged.npz"
    np.savez(path, **arrays)
    return path


@pytest.mark.parametrize("change, hint", DAMAGES.values(), ids=DAMAGES)
def test_damaged_demonstrations_are_refused(change, hint, tmp_path, capsys, run):
    assert run("imitate", "pendulum", "--demos", damaged(tmp_path, change), "--out", tmp_path / "run") == 2
    assert hint in capsys.readouterr().err


def test_help_imports_no_jax():
    """Help answers in half a second; importing jax alone takes longer."""
    program = (
        "import sys, contextlib\n"
        "from eairl_jax.experiments import cli\n"
        "with contextlib.suppress(SystemExit):\n"
        "    cli.main(['--help'])\n"
        "print(sorted({'jax', 'mujoco', 'brax', 'flax'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
    for command in COMMANDS:
        assert command in done.stdout


def test_the_version_is_said(run, capsys):
    assert run("--version") == 0
    assert capsys.readouterr().out == f"eairl_jax {eairl_jax.__version__}\n"


# Modules that the command imports, and folders that a user may well have.
DECOYS = ("tyro", "rich", "jax", "numpy", "mujoco", "brax", "filelock", "matplotlib", "experiments", "envs", "tests")
PLAIN = {"PYTHONIOENCODING": "ascii", "LANG": "C", "COLUMNS": "30", "NPROC": "4"}


MODULE = ["-m", "eairl_jax.experiments.cli"]
OPTIMISED = ["-P", "-OO", "-c", "from eairl_jax.experiments import cli; cli.main()"]


@pytest.mark.parametrize("options", [MODULE, OPTIMISED], ids=["module", "optimised"])
def test_a_process_runs_nothing_of_the_current_folder_and_prints_on_any_terminal(options, tmp_path):
    """Thirty columns of ASCII, without docstrings and assertions, without a home."""
    for name in DECOYS:
        (tmp_path / f"{name}.py").write_text(f"open({name!r}, 'w')")
    environ = {name: value for name, value in os.environ.items() if name not in ("HOME", "XLA_FLAGS")}
    environ |= PLAIN | {"HOME": "", "XDG_CACHE_HOME": "", "PYTHONPATH": str(Path(eairl_jax.__file__).parents[1])}
    done = subprocess.run(
        [sys.executable, *options, "tasks"], cwd=tmp_path, env=environ, capture_output=True, text=True, check=True
    )
    assert {path.suffix for path in tmp_path.iterdir()} == {".py"}
    lines = done.stdout.splitlines()
    assert {"pendulum", "  obs: 3", "  action limit: +-2"} <= set(lines)
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(os.name != "posix", reason="pipes end otherwise there")
@pytest.mark.parametrize("arguments", [["imitate", "--help"], ["settings"], ["runs", "."], ["--version"]])
def test_a_reader_that_is_gone_ends_a_command_without_a_traceback(arguments, tmp_path):
    read, write = os.pipe()
    os.close(read)
    program = f"from eairl_jax.experiments import cli; cli.main({arguments})"
    environment = {name: value for name, value in os.environ.items() if name not in ("NPROC", "JAX_NUM_CPU_DEVICES")}
    with os.fdopen(write, "wb") as gone:
        done = subprocess.run(
            [sys.executable, "-c", program],
            cwd=tmp_path,
            env=environment,
            stdout=gone,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.stderr == ""
    assert done.returncode == 1


def test_help_is_whole_on_any_terminal(tmp_path):
    program = "from eairl_jax.experiments import cli; cli.main(['--help'])"
    for optimised in ([], ["-OO"]):
        done = subprocess.run(
            [sys.executable, *optimised, "-c", program],
            env=os.environ | PLAIN,
            capture_output=True,
            text=True,
            check=True,
        )
        assert all(command in done.stdout for command in COMMANDS)


ODD = "run [red] :x: $a$ <b> 'n' \u00e4.v1"


def test_a_path_may_have_any_name(finished, tmp_path, run, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = finished.rename(tmp_path / ODD)
    assert run("evaluate", folder, "--episodes", 2, "--json", f"{ODD}.json") == 0
    assert (tmp_path / f"{ODD}.json").exists()
    assert run("evaluate", f"{ODD}2") == 2
    assert f"{ODD}2 is no run's folder" in capsys.readouterr().err


def test_settings_explain_themselves(run, capsys):
    assert run("settings", "point_maze_left") == 0
    printed = capsys.readouterr().out
    for word in ("lambda_i", "ppo_epochs", "snapshot_every", "reward separable", "normalize_obs=none"):
        assert word in printed
    assert run("settings", "point_maze") == 2
    assert "did you mean" in capsys.readouterr().err


def users_file(folder):
    """`my_tasks.py` of docs/your-task.md, in a folder."""
    page = (ROOT / "docs" / "your-task.md").read_text(encoding="utf-8")
    source = re.search(r'```py title="my_tasks.py"\n(.*?)^```$', page, re.DOTALL | re.MULTILINE)[1]
    (folder / "my_tasks.py").write_text(source)


def test_the_environment_of_the_page_is_short(tmp_path):
    users_file(tmp_path)
    assert len((tmp_path / "my_tasks.py").read_text().splitlines()) <= 45


def test_a_users_environment_goes_through_all_commands(tmp_path, monkeypatch, capsys, run, tiny, rl_settings):
    monkeypatch.chdir(tmp_path)
    make_env.cache_clear()
    users_file(tmp_path)
    task, heavier, short = "my_tasks.py:make_env", "my_tasks.py:make_env?gravity=20", "episode_length=20"
    gail = [setting for setting in tiny if not setting.startswith("empowerment")]
    learning = ["--set", *gail, short]
    assert run("settings", task) == 0
    assert run("imitate", task, *learning) == 2
    assert "eairl demos my_tasks.py:make_env" in capsys.readouterr().err
    assert run("expert", task, "--seeds", 1, "--set", *rl_settings, short) == 0
    assert f"{task} has no recipe: it is trained with defaults" in capsys.readouterr().out
    assert run("demos", task, "--episodes", 3) == 0
    assert run("imitate", task, "--method", "gail", "--seeds", 1, *learning) == 0
    assert f"demonstrations of {task}: demos/my_tasks-make_env.npz" in capsys.readouterr().out
    assert run("sweep", task, "--method", "gail", "--seeds", 1, "--set", *gail, "gamma=0.9,0.99") == 0
    transfer = ["transfer", task, heavier, "--method", "airl_s", "--seeds", 1, "--rule", "last", *learning]
    assert run(*transfer, "--retrain-set", *rl_settings, short) == 0
    printed = capsys.readouterr().out
    assert f"no expert of {heavier} is known, so no score is normalised" in printed
    (moved,) = (tmp_path / "runs").glob("transfer-my_tasks-make_env-to-my_tasks-make_env-gravity-20-*")
    summary = json.loads((moved / "summary.json").read_text(), parse_constant=pytest.fail)
    assert (summary["expert"], summary["normalized"], summary["target"]) == (None, None, heavier)
    assert np.isfinite([summary["random"], *summary["returns"], *summary["ceiling"]]).all()
    (imitated,) = (tmp_path / "runs").glob("imitate-my_tasks-make_env-gail-sa-*")
    for folder in (imitated, moved):
        assert run("evaluate", folder, "--episodes", 2) == 0
        assert run("view", folder) == 0
        assert (folder / "view" / "episode.html").exists()
    assert run("evaluate", moved, "--engine", "c") == 2
    assert "the C engine needs a task that derives from" in capsys.readouterr().err
    assert run("diagnose", moved) == 2
    assert "has no expert to compare with" in capsys.readouterr().err
    assert run("bench", task, "--method", "gail", "--iterations", 1, "--set", *gail) == 0
    (tmp_path / "my_tasks.py").unlink()
    make_env.cache_clear()  # as in another process
    assert run("evaluate", moved) == 2
    assert "no file my_tasks.py in" in capsys.readouterr().err


def test_double_precision_is_refused_in_one_line(run, capsys):
    jax.config.update("jax_enable_x64", True)
    try:
        assert run("imitate", "pendulum") == 2
    finally:
        jax.config.update("jax_enable_x64", False)
    assert "eairl_jax computes in float32 alone" in capsys.readouterr().err


def test_what_processes_must_have_been_given_alike_is_named_option_by_option():
    options = Imitate(
        "pendulum", ("gail", "bc"), coordinator="host:1", processes=2, process=1, set=("gamma=0.9", "beta=2")
    )
    shared = cli._shared(options)
    assert shared["command"] == "imitate"
    assert shared["--method"] == "gail bc"
    assert (shared["--set gamma"], shared["--set beta"]) == ("0.9", "2")
    assert shared["--processes"] == "2"
    assert not {"--coordinator", "--process", "--set"} & shared.keys()


def test_an_impossible_place_among_processes_is_refused_before_jax_is_set_up(run, tmp_path, capsys):
    assert run("expert", "pendulum", "--process", 1, "--out", tmp_path / "run") == 2
    assert "--coordinator and --processes missing" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
