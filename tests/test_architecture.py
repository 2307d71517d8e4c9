"""One direction of imports, and files that fit in a head."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("eairl_jax", "envs", "experiments")
FILES = sorted(path.relative_to(ROOT) for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
LIBRARY = [path for path in FILES if path.parts[0] == "eairl_jax"]
# What a file of each folder may import of this project, by the beginning of its full name.
ALLOWED = {
    "eairl_jax": lambda name: not name.startswith(("eairl_jax.envs", "eairl_jax.experiments")),
    "envs": lambda name: name.startswith("eairl_jax.envs"),
    "experiments": lambda name: True,
}


def imported(path):
    """The full names of all that a file imports, wherever in the file."""
    names = set()
    for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", "") in ("import_module", "__import__"):
            names |= {arg.value for arg in node.args if isinstance(arg, ast.Constant)}
    return names


def test_the_walk_finds_the_packages_and_their_imports():
    assert {path.parts[0] for path in FILES} >= {"eairl_jax", "envs"}
    assert {"flax.linen", "math", "eairl_jax.config.Config"} <= imported(Path("eairl_jax/nets.py"))


@pytest.mark.parametrize("path", FILES, ids=str)
def test_imports_go_in_one_direction_and_never_to_pickle(path):
    names = imported(path)
    assert not {name.split(".")[0] for name in names} & {
        "pickle",
        "cloudpickle",
        "dill",
        "joblib",
        "tests",
        "envs",
        "experiments",
    }
    assert all(ALLOWED[path.parts[0]](name) for name in names if name.startswith("eairl_jax"))


@pytest.mark.parametrize("path", LIBRARY, ids=str)
def test_networks_are_made_in_one_file(path):
    linen = any(name.startswith("flax.linen") for name in imported(path))
    assert linen == (path.name == "nets.py")


@pytest.mark.parametrize("path", LIBRARY, ids=str)
def test_no_file_of_the_library_is_longer_than_200_lines(path):
    assert len((ROOT / path).read_text(encoding="utf-8").splitlines()) <= 200


@pytest.mark.parametrize("package", ["eairl_jax", "envs"])
def test_every_test_file_mirrors_a_file(package):
    names = {path.name.removeprefix("test_") for path in (ROOT / "tests" / package).glob("test_*.py")}
    assert names
    assert names <= {path.name for path in (ROOT / package).glob("*.py")}
