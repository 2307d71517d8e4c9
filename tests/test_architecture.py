"""Imports run in one direction, files hold no function that is too long, and tests stand where their module stands."""

import ast
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("eairl_jax", "envs", "experiments")
FILES = sorted(path.relative_to(ROOT) for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))
LIBRARY = [path for path in FILES if path.parts[0] == "eairl_jax"]
MAX_LINES, MAX_PARAMETERS = 75, 7

# The rooms of `experiments`, from the top floor down: a file imports from its own floor and from lower ones alone.
FLOORS = (
    ("cli",),
    ("commands",),
    ("paper",),
    ("pipeline",),
    ("display",),
    ("settings",),
    ("recipes", "options"),
)
# Modules that must not come into a process through a file that reads untrusted data.
UNSAFE = {"pickle", "cloudpickle", "dill", "joblib"}
# A user's own folders may bear these names, so no file imports them at top level.
FOREIGN = {"envs", "experiments", "tests"}


def imported(path):
    """The full names of everything that a file imports, wherever in the file."""
    names = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", "") in ("import_module", "__import__"):
            names |= {arg.value for arg in node.args if isinstance(arg, ast.Constant)}
    return names


def tree(path):
    """The syntax tree of a file."""
    return ast.parse((ROOT / path).read_text(encoding="utf-8"))


def functions(path):
    """Every function of a file, however deep."""
    return [node for node in ast.walk(tree(path)) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]


def floor(module):
    """The floor of `experiments` that a module stands on, 0 at the top; None of a module elsewhere."""
    parts = module.split(".")
    if parts[:2] != ["eairl_jax", "experiments"] or len(parts) < 3:
        return None
    return next((number for number, rooms in enumerate(FLOORS) if parts[2] in rooms), None)


def module_name(path):
    """`eairl_jax.envs.ant` of envs/ant.py."""
    parts = path.with_suffix("").parts
    return ".".join(parts if parts[0] == "eairl_jax" else ("eairl_jax", *parts))


def test_the_walk_finds_the_packages_and_their_imports():
    assert {path.parts[0] for path in FILES} == set(FOLDERS)
    assert {"flax.linen", "math", "eairl_jax.config.Config"} <= imported(Path("eairl_jax/nets.py"))
    assert floor("eairl_jax.experiments.pipeline.train") > floor("eairl_jax.experiments.commands.imitate")


@pytest.mark.parametrize("path", FILES, ids=str)
def test_library_tasks_and_experiments_import_in_one_direction(path):
    names = imported(path)
    assert not {name.split(".")[0] for name in names} & (UNSAFE | FOREIGN)
    ours = [name for name in names if name.split(".")[0] == "eairl_jax"]
    if path.parts[0] == "eairl_jax":
        assert not [name for name in ours if name.startswith(("eairl_jax.envs", "eairl_jax.experiments"))]
    if path.parts[0] == "envs":
        assert all(name.startswith("eairl_jax.envs") for name in ours)


@pytest.mark.parametrize("path", [path for path in FILES if path.parts[0] == "experiments"], ids=str)
def test_imports_inside_experiments_go_down(path):
    here = floor(module_name(path))
    for name in imported(path):
        there = floor(name)
        assert there is None or here is None or there >= here, f"{path} imports {name} from a higher floor"


@pytest.mark.parametrize("path", [path for path in FILES if path.parts[:2] == ("experiments", "commands")], ids=str)
def test_no_command_imports_another(path):
    commands = {p.stem for p in FILES if p.parts[:2] == path.parts[:2]} - {"__init__", "saturation", path.stem}
    parts = [name.split(".") for name in imported(path)]
    assert not [name for name in parts if name[:3] == ["eairl_jax", "experiments", "commands"] and name[3] in commands]


@pytest.mark.parametrize("folder", FOLDERS)
def test_there_is_no_circle_of_imports(folder):
    modules = {module_name(path): path for path in FILES if path.parts[0] == folder and path.name != "__init__.py"}
    names = {name: imported(path) for name, path in modules.items()}
    arrows = {
        name: {other for other in modules if any(x == other or x.startswith(f"{other}.") for x in names[name])}
        for name in modules
    }
    while leaves := {name for name, others in arrows.items() if not others & arrows.keys() - {name}}:
        arrows = {name: others for name, others in arrows.items() if name not in leaves}
    assert not arrows, f"these files import each other: {sorted(arrows)}"


@pytest.mark.parametrize("path", FILES, ids=str)
def test_functions_are_short_and_take_few_arguments(path):
    for function in functions(path):
        lines = function.end_lineno - function.lineno + 1
        assert lines <= MAX_LINES, f"{path}:{function.lineno}: {function.name} has {lines} lines"
        arguments = function.args
        names = [a.arg for a in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)]
        count = len([name for name in names if name not in ("self", "cls")])
        assert count <= MAX_PARAMETERS, f"{path}:{function.lineno}: {function.name} has {count} parameters"


@pytest.mark.parametrize("path", LIBRARY, ids=str)
def test_networks_are_made_in_one_file(path):
    linen = any(name.startswith("flax.linen") for name in imported(path))
    assert linen == (path.name == "nets.py")


@pytest.mark.parametrize("folder", FOLDERS)
def test_every_test_file_mirrors_a_module(folder):
    tests = [path.relative_to(ROOT / "tests") for path in (ROOT / "tests" / folder).rglob("test_*.py")]
    assert tests
    modules = {path.with_name(path.name.removeprefix("test_")) for path in tests}
    assert modules <= set(FILES)


def test_every_module_that_holds_logic_has_a_test_file():
    def has_logic(path):
        return any(isinstance(node, ast.If | ast.For | ast.While | ast.ListComp) for node in ast.walk(tree(path)))

    untested = [
        path
        for path in FILES
        if has_logic(path) and not (ROOT / "tests" / path.with_name(f"test_{path.name}")).exists()
    ]
    assert set(map(str, untested)) <= WITHOUT_A_TEST_FILE


# Files of data, and of shapes that the tests of their users cover: each with its reason.
WITHOUT_A_TEST_FILE: set[str] = set()


def test_every_planted_bug_fits_the_files_and_the_tests(monkeypatch):
    """A bug that no longer fits would be noticed by `make test-mutants` alone, which takes an hour."""
    monkeypatch.syspath_prepend(ROOT / "tests" / "mutants")
    planted = runpy.run_path(str(ROOT / "tests" / "mutants" / "run.py"), run_name="mutants")
    assert len(planted["BUGS"]) > 100
    planted["refuse_stale"](planted["BUGS"])
