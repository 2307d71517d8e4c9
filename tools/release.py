"""Builds the wheel and the sdist in dist/, and checks them: `make release`, or `python tools/release.py`.

1. Build, without a network: setuptools is that of this environment.
2. `twine check --strict`: the registry would accept and show them.
3. Contents: code, data, viewer and type marker are there; tests and caches are not.
4. The wheel in a fresh virtual environment, used in a project that has its own `envs/` and `experiments/`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
NEEDED = (
    "eairl_jax/__init__.py",
    "eairl_jax/py.typed",
    "eairl_jax/envs/registry.py",
    "eairl_jax/envs/physics/contact_solver.py",
    "eairl_jax/experiments/cli.py",
    "eairl_jax/experiments/commands/tasks.py",
    "eairl_jax/experiments/data/point_maze_left.npz",
    "eairl_jax/experiments/data/point_maze_left.json",
    "eairl_jax/experiments/display/viewer/page.html",
    "eairl_jax/experiments/display/viewer/three.module.min.js",
    "eairl_jax/experiments/display/viewer/three.LICENSE.txt",
)
# Everything that is not in Git and would end in a copy of the working tree.
IGNORED = shutil.ignore_patterns(
    ".git", ".venv", "runs", "demos", "build", "dist", "*.egg-info", "__pycache__", ".*_cache"
)


def build(out: Path, *kinds: str) -> list[Path]:
    """Builds `--wheel`, `--sdist` or both into `out`, from a copy: the working tree gets no build folder."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        shutil.copytree(ROOT, copy, symlinks=True, ignore=IGNORED)
        code = (
            "import sys; from setuptools import build_meta as b; out, *kinds = sys.argv[1:]\n"
            "for kind in kinds: (b.build_wheel if kind == '--wheel' else b.build_sdist)(out)"
        )
        out.mkdir(parents=True, exist_ok=True)
        kinds = kinds or ("--wheel", "--sdist")
        subprocess.run([sys.executable, "-c", code, str(out), *kinds], cwd=copy, check=True, stdout=subprocess.DEVNULL)
    return sorted(path for path in out.iterdir() if path.suffix in (".whl", ".gz"))


def faults(names: list[str]) -> list[str]:
    """What is wrong with the file names in a wheel: needed files that are missing, files that do not belong there."""
    inside = set(names)
    missing = [f"missing: {name}" for name in NEEDED if name not in inside]
    metadata = {name for name in inside if name.split("/")[0].endswith(".dist-info")}
    strangers = sorted(name for name in inside - metadata if not name.startswith("eairl_jax/"))
    tests = sorted(name for name in inside if "/test" in name or "__pycache__" in name)
    twice = sorted({name for name in names if names.count(name) > 1})
    sources = {
        path.relative_to(ROOT).as_posix() for room in ("envs", "experiments") for path in (ROOT / room).rglob("*.py")
    }
    sources = {f"eairl_jax/{name}" for name in sources}
    sources |= {path.relative_to(ROOT).as_posix() for path in (ROOT / "eairl_jax").glob("*.py*")}
    unpacked = sorted(f"missing: {name}" for name in sources - inside)
    return [
        *missing,
        *unpacked,
        *(f"does not belong: {name}" for name in (*strangers, *tests)),
        *(f"twice: {name}" for name in twice),
    ]


def project(folder: Path) -> Path:
    """A user's project with packages of its own named `envs` and `experiments`."""
    for name in ("envs", "experiments"):
        (folder / name).mkdir(parents=True)
        (folder / name / "__init__.py").write_text("raise ImportError('this is the package of the user')\n")
    return folder


def check_install(wheel: Path, folder: Path) -> None:
    """Installs the wheel into a fresh environment and lists the tasks, with and without `PYTHONPATH=.`."""
    plain = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    binaries = folder / "venv" / "bin"
    subprocess.run([sys.executable, "-m", "venv", str(folder / "venv")], env=plain, check=True)
    install = [str(binaries / "python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    name = "constraints.txt" if sys.version_info < (3, 12) else "constraints-3.12.txt"
    constraints = ["--constraint", str(ROOT / name)]
    subprocess.run([*install, *constraints, str(wheel)], env=plain, check=True)
    where = project(folder / "project")
    for extra in ({}, {"PYTHONPATH": "."}):
        command = [str(binaries / "eairl"), "tasks"]
        shown = subprocess.run(command, cwd=where, env=plain | extra, check=True, stdout=subprocess.PIPE, text=True)
        if "point_maze_left" not in shown.stdout:
            sys.exit(f"`eairl tasks` printed no tasks in {where}: {shown.stdout}")


def main() -> None:
    """Builds and checks; the first fault ends the program."""
    dist = ROOT / "dist"
    shutil.rmtree(dist, ignore_errors=True)
    print("== building")
    archives = build(dist)
    (wheel,) = dist.glob("*.whl")
    (sdist,) = dist.glob("*.tar.gz")
    print("== twine check")
    subprocess.run([sys.executable, "-m", "twine", "check", "--strict", *map(str, archives)], check=True)
    wrong = faults(zipfile.ZipFile(wheel).namelist())
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    wrong += [f"sdist, missing: {name}" for name in ("pyproject.toml", "README.md", "LICENSE") if name not in names]
    if wrong:
        sys.exit("\n".join(wrong))
    print("== installing the wheel into a fresh environment")
    with tempfile.TemporaryDirectory() as folder:
        check_install(wheel, Path(folder))
    print(f"== {wheel.name} and {sdist.name} in dist/ are ready")


if __name__ == "__main__":
    main()
