"""What is read of the folders of runs. Of damaged ones: `test_runs`."""

import shutil
import subprocess
import sys
from pathlib import Path

from eairl_jax.experiments.pipeline import overview

GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "v1"


def test_jax_is_not_imported(tmp_path):
    shutil.copytree(GOLDEN / "finished", tmp_path / "run")
    program = (
        "import sys; from eairl_jax.experiments import cli\n"
        f"cli.main(['runs', {str(tmp_path)!r}])\n"
        "assert not {'jax', 'mujoco', 'brax', 'flax', 'orbax', 'matplotlib'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], check=True, capture_output=True)


def test_a_run_inside_of_a_run_is_its_own_matter(tmp_path):
    shutil.copytree(GOLDEN / "unfinished", tmp_path / "going on")
    shutil.copytree(GOLDEN / "finished", tmp_path / "going on" / "trials")
    shutil.copytree(GOLDEN / "finished", tmp_path / "sets" / "a run")
    assert [path.name for path in overview.find(tmp_path)] == ["going on", "a run"]
