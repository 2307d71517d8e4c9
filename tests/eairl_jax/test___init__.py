"""The public names: imported at their first use, and never hidden by a module of the same name."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import eairl_jax

FOLDER = Path(eairl_jax.__file__).parent


def test_importing_the_package_and_what_its_help_needs_imports_no_jax():
    program = "import sys, eairl_jax; from eairl_jax import Config, InputError, xla; assert 'jax' not in sys.modules"
    subprocess.run([sys.executable, "-c", program], check=True, cwd=FOLDER.parent)


def test_every_public_name_is_what_the_stub_says():
    names = {}
    for node in ast.parse((FOLDER / "__init__.pyi").read_text()).body:
        assert isinstance(node, ast.ImportFrom)
        names |= {alias.asname: f"eairl_jax.{node.module}" if node.module else None for alias in node.names}
    assert set(eairl_jax.__all__) == set(dir(eairl_jax)) == set(names)
    for name, module in names.items():
        value = getattr(eairl_jax, name)
        assert value is (getattr(sys.modules[module], name) if module else sys.modules[f"eairl_jax.{name}"])


def test_no_module_has_the_name_of_a_public_function_or_class():
    modules = {path.stem for path in FOLDER.glob("*.py")}
    assert {name for name in eairl_jax.__all__ if name in modules} == {"demonstrations", "demonstration_files"}


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="make_irk"):
        eairl_jax.make_irk  # noqa: B018
