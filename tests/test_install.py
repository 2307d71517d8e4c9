"""The wheel, as a user has it: its contents, and its use beside a user's packages named `envs` and `experiments`."""

import importlib.util
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import jax
import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def release():
    spec = importlib.util.spec_from_file_location("release", ROOT / "tools" / "release.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def wheel(release, tmp_path_factory):
    (path,) = release.build(tmp_path_factory.mktemp("dist"), "--wheel")
    return zipfile.ZipFile(path)


@pytest.fixture(scope="module")
def run(release, wheel, tmp_path_factory):
    """Runs Python on the unpacked wheel inside a user's project; jax as in the other tests."""
    site, project = tmp_path_factory.mktemp("site"), release.project(tmp_path_factory.mktemp("project") / "p")
    wheel.extractall(site)
    settings = {
        "JAX_NUM_CPU_DEVICES": "2",
        "JAX_DISABLE_MOST_OPTIMIZATIONS": "true",
        "JAX_COMPILATION_CACHE_DIR": jax.config.jax_compilation_cache_dir,
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
    }

    def python(*arguments):
        path = os.pathsep.join([".", str(site)])
        environment = os.environ | settings | {"PYTHONPATH": path}
        done = subprocess.run(
            [sys.executable, *arguments], cwd=project, env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    python.site = site
    return python


def test_the_wheel_holds_what_it_needs_and_nothing_else(release, wheel):
    assert release.faults(wheel.namelist()) == []


def test_faults_of_a_wheel_are_seen(release, wheel):
    names = wheel.namelist()
    assert release.faults([name for name in names if not name.endswith("page.html")])
    assert release.faults([name for name in names if not name.endswith("envs/ant.py")])
    assert release.faults([*names, "envs/__init__.py"])
    assert release.faults([*names, "eairl_jax/tests/test_ant.py"])


def test_the_command_works_beside_a_users_packages_of_the_same_names(run):
    assert "point_maze_left" in run("-m", "eairl_jax.experiments.cli", "tasks")


def test_the_readmes_program_works_there(run):
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (program,) = re.findall(r"```python\n(.*?)```", readme, flags=re.DOTALL)
    shorter, count = re.subn(r"iterations, keys = \d+,", "iterations, keys = 2,", program)
    assert count == 1
    assert len(program.splitlines()) <= 20
    lines = run("-c", f"{shorter}\nimport eairl_jax; print(eairl_jax.__file__, metrics['true_return'].shape)")
    assert "true return in the right maze" in lines
    assert f"{run.site}/eairl_jax/__init__.py (2, 2)" in lines
