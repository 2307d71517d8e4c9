"""The pages of the repository: code runs, command lines parse, links and code names lead somewhere."""

import importlib
import inspect
import re
import shlex
import sys
from pathlib import Path

import pytest
import tyro

from eairl_jax.experiments.options import COMMANDS

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*(ROOT / "docs").glob("*.md"), *ROOT.glob("*.md")])
FENCE = re.compile(r"^( *)```(\w*)([^\n]*)\n(.*?)^\1```$", re.DOTALL | re.MULTILINE)
# Pages that are made when the site is built.
GENERATED = ("reference/commands.md", "reference/settings.md", "reference/examples.md")
# Their code is run elsewhere (test_readme.py, test_contributing.py), or configures jax, which pytest has done.
NOT_RUN = ("README.md", "CONTRIBUTING.md", "performance.md")


def blocks(page: Path, language: str) -> list[tuple[str, str]]:
    """`(title, code)` of the fenced blocks of a language; the title is the file that the block is a part of."""
    found = []
    for indent, name, info, code in FENCE.findall(page.read_text(encoding="utf-8")):
        title = re.search(r'title="([^"]+)"', info)
        if name == language:
            found.append((title[1] if title else "", re.sub(rf"^{indent}", "", code, flags=re.MULTILINE)))
    return found


def command_lines() -> list[str]:
    """Every line of a shell block that calls `eairl`, its comment dropped."""
    lines = [line for page in PAGES for _, code in blocks(page, "sh") for line in code.splitlines()]
    return sorted({line.partition(" # ")[0].strip() for line in lines if line.startswith("eairl ")})


def prose(page: Path) -> str:
    """The page without its fenced blocks."""
    return FENCE.sub("", page.read_text(encoding="utf-8"))


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub and the site make them."""
    titles = re.findall(r"^#+ (.+)$", prose(page), flags=re.MULTILINE)
    return {re.sub(r"\s", "-", re.sub(r"[^\w\s-]", "", title).strip().lower()) for title in titles}


@pytest.mark.usefixtures("no_trace")
@pytest.mark.parametrize("page", [page for page in PAGES if page.name not in NOT_RUN], ids=lambda page: page.name)
def test_code_is_a_part_of_an_example_or_runs(page):
    names: dict = {}
    for title, code in blocks(page, "python"):
        if title:
            assert code in (ROOT / title).read_text(encoding="utf-8"), f"{page.name} quotes {title}, which has changed"
        else:
            exec(compile(code, page.name, "exec"), names)


@pytest.mark.parametrize("line", command_lines())
def test_a_command_line_parses(line):
    options = tyro.extras.subcommand_cli_from_dict(COMMANDS, prog="eairl", args=shlex.split(line)[1:])
    assert type(options) in COMMANDS.values()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    for link in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if link.startswith(("http://", "https://")):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if path in GENERATED:
            continue
        assert target.exists(), f"{page.name}: {link}"
        assert target.is_relative_to(ROOT)
        assert not anchor or anchor in anchors(target), f"{page.name}: {link}"


def resolved(name: str):
    """What a full name of code stands for."""
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        try:
            member = importlib.import_module(".".join(parts[:length]))
        except ModuleNotFoundError:
            continue
        for part in parts[length:]:
            member = getattr(member, part)
        return member
    raise AssertionError(name)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_code_names_exist(page):
    for name in set(re.findall(r"`(eairl_jax(?:\.\w+)+)`", prose(page))):
        assert resolved(name) is not None, f"{page.name}: {name}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_named_files_exist(page):
    for name in set(re.findall(r"`((?:eairl_jax|envs|experiments|tests|docs|examples)/[\w./-]+)`", prose(page))):
        if "NAME" not in name:
            assert (ROOT / name).exists(), f"{page.name}: {name}"


def steps(mark: str) -> list[str]:
    """The functions of a table of how-it-works.md, in its order."""
    text = (ROOT / "docs" / "how-it-works.md").read_text(encoding="utf-8")
    return re.findall(
        r"`(eairl_jax\.[\w.]+)` \|$", re.search(rf"<!-- {mark} -->(.*?)<!-- end -->", text, re.DOTALL)[1], re.MULTILINE
    )


def test_the_steps_of_an_iteration_stand_in_the_order_of_the_code():
    code = inspect.getsource(resolved("eairl_jax.irl.make_irl"))
    names = [".".join(name.split(".")[-2:]) for name in steps("step")]
    assert len(names) >= 10
    names[names.index("policy_optimizers.make_optimizer")] = "optimizer.update"
    positions = [code.index(f"{name}(") for name in names]
    assert positions == sorted(positions)


def test_the_steps_of_a_transfer_are_functions_of_at_most_eight_files():
    functions = [resolved(name) for name in steps("transfer-steps")]
    assert len(functions) >= 10
    assert all(map(inspect.isfunction, functions))
    assert len({sys.modules[function.__module__].__file__ for function in functions}) <= 8


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_bytes()) <= 8192
