"""The pages that are made from docstrings."""

import importlib.util
from pathlib import Path

import pytest

from eairl_jax import Config, HParams
from eairl_jax.experiments.options import COMMANDS

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def generate():
    spec = importlib.util.spec_from_file_location("generate", ROOT / "docs" / "generate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_sections_of_a_docstring_become_lists(generate):
    text = generate.markdown_of(
        "One line.\n\nArgs:\n  a, b: two\n    numbers.\n  c: x < y, `d < e`.\n\nReturns:\n  A sum."
    )
    assert text == "One line.\n\n**Args**\n\n- `a, b`: two numbers.\n- `c`: x &lt; y, `d < e`.\n\n**Returns**\n\nA sum."


@pytest.mark.parametrize("record", [Config, HParams])
def test_every_setting_is_documented_and_listed(generate, record):
    documented = generate.field_docstrings(record)
    undocumented = [name for name, text in documented.items() if not text]
    assert not undocumented
    page = generate.settings_page()
    assert all(f"| `{name}` |" in page for name in documented)


def test_every_command_is_listed_with_its_options(generate):
    page = generate.commands_page()
    assert all(f"## `eairl {command}`" in page for command in COMMANDS)
    assert "| `--set NAME=VALUE` |" in page
    assert "eairl transfer SOURCE TARGET [OPTIONS]" in page


def test_public_names_are_in_the_reference(generate):
    text, anchors = generate.room_page(*generate.ROOMS["library"])
    assert {"eairl_jax.irl.make_irl", "eairl_jax.lanes.Lanes", "eairl_jax.lanes.Lanes.run"} <= set(anchors)
    assert all(f"{{#{anchor}}}" in text for anchor in anchors.values())
    assert "eairl_jax.envs" not in anchors


def test_code_blocks_are_left_as_they_are(generate):
    text = "a `eairl_jax.x`\n\n```sh\n$1 `eairl_jax.x` $2\n```\n"
    changed = generate.outside_code(text, lambda part: generate.with_links(part, {"eairl_jax.x": "p.md#x"}))
    assert changed == "a [`eairl_jax.x`](p.md#x)\n\n```sh\n$1 `eairl_jax.x` $2\n```\n"


def test_links_lead_to_their_place_in_the_site(generate):
    text = "[a](../CONTRIBUTING.md) [b](../examples/learn_a_reward.py) ![c](../experiments/results/c.png)"
    assert generate.with_links(text, {}) == (
        "[a](contributing.md) [b](reference/examples.md#learn_a_reward) ![c](images/c.png)"
    )


def test_a_figure_is_never_broken(generate):
    text = generate.with_whole_figures("| -4.85 ± 0.03 (1.00) | -4.85 (1.00) | 20 episodes (all) |")
    assert text.count("\N{NO-BREAK SPACE}") == 4
    assert "20 episodes (all)" in text


def test_a_long_signature_has_a_line_for_each_parameter(generate):
    def load(
        path_of_the_file: str, task_of_the_demonstrations: str, obs_size: int = 0, action_size: int = 0
    ) -> dict: ...

    assert generate.signature("load", load).splitlines()[0] == "load("
    assert generate.signature("load", load).splitlines()[-1] == ") -> dict"
    assert generate.signature("f", lambda x: x) == "f(x)"
