"""Writes the pages of the documentation site to build/docs: `python docs/generate.py`.

Pages of docs/ are copied, with links to other files of the repository led to their place in the site, code names
linked to the reference and mathematics turned into MathML, which needs no script. The pages of reference/ are made of
docstrings.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import pkgutil
import re
import shutil
import textwrap
import typing
from pathlib import Path
from types import ModuleType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "build" / "docs"
# Where a file of the repository is in the site, seen from a page of docs/.
PLACES = {
    "../CONTRIBUTING.md": "contributing.md",
    "../CHANGELOG.md": "changelog.md",
    "../README.md": "index.md",
    "../experiments/results/discussion.md": "discussion.md",
}
PICTURES = "../experiments/results/"
ROOMS = {
    "library": ("Library", "eairl_jax", "The algorithms. Nothing here knows a task."),
    "tasks": (
        "Tasks",
        "eairl_jax.envs",
        "Tasks as MJX models behind brax's interface. Nothing here knows an algorithm.",
    ),
    "experiments": ("Experiments", "eairl_jax.experiments", "What the commands run: recipes, stages, tables, figures."),
}
SECTIONS = ("Args", "Attributes", "Returns", "Raises")


# Docstrings to Markdown ----------------------------------------------------------------------------------------------


def escaped(text: str) -> str:
    """Text in which `<` begins no HTML tag; inline code and code blocks stay as they are."""
    parts = re.split(r"(```.*?```|`[^`\n]*`)", text, flags=re.DOTALL)
    return "".join(part if index % 2 else part.replace("<", "&lt;") for index, part in enumerate(parts))


def markdown_of(docstring: str) -> str:
    """A Google-style docstring as Markdown: its sections (`SECTIONS`) become headed lists."""
    lines, blocks, current, section = inspect.cleandoc(docstring).splitlines(), [], [], None
    for line in [*lines, "End:"]:
        title = line.removesuffix(":")
        if line == "End:" or (line.endswith(":") and title in SECTIONS):
            text = "\n".join(current)
            blocks.append(escaped(text) if section is None else section_of(section, text))
            current, section = [], title
        else:
            current.append(line)
    return "\n\n".join(block.strip("\n") for block in blocks if block.strip())


def section_of(title: str, text: str) -> str:
    """One section of a docstring: each `name: meaning` an item of a list."""
    entries = re.split(r"\n(?=\S)", textwrap.dedent(text).strip())
    items = []
    for entry in entries:
        name, colon, meaning = entry.partition(":")
        has_name = colon and title != "Returns" and re.fullmatch(r"[\w*, ]+", name)
        flat = " ".join((meaning if has_name else entry).split())
        items.append(f"- `{name}`: {escaped(flat)}" if has_name else escaped(flat))
    return f"**{title}**\n\n" + "\n".join(items)


def field_docstrings(record: type) -> dict[str, str]:
    """The string under each field of a dataclass, or its line in the class's `Attributes`."""
    (node,) = ast.parse(textwrap.dedent(inspect.getsource(record))).body
    assert isinstance(node, ast.ClassDef)
    documented = {}
    for field, after in zip(node.body, [*node.body[1:], None], strict=True):
        text = after.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else None
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
            documented[field.target.id] = " ".join(inspect.cleandoc(str(text.value)).split()) if text else ""
    attributes = inspect.cleandoc(record.__doc__ or "").partition("Attributes:\n")[2]
    for entry in re.split(r"\n(?=\S)", textwrap.dedent(attributes).strip()):
        names, _, meaning = entry.partition(":")
        for name in filter(None, (name.strip() for name in names.split(","))):
            documented[name] = " ".join(meaning.split())
    return documented


def table(titles: list[str], lines: list[list[str]]) -> str:
    """A Markdown table; `|` inside a cell is escaped."""
    rows = [titles, ["---"] * len(titles), *([cell.replace("|", r"\|") for cell in line] for line in lines)]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


# Pages of the reference ----------------------------------------------------------------------------------------------


def modules_of(package: str) -> list[ModuleType]:
    """A package and its modules, without those of the other rooms, in the order of their names."""
    others = {name for _, name, _ in ROOMS.values()} - {package}
    root, found = importlib.import_module(package), []
    for info in pkgutil.walk_packages(root.__path__, f"{package}."):
        if not any(f"{info.name}.".startswith(f"{other}.") for other in others if other.startswith(package)):
            found.append(importlib.import_module(info.name))
    return [root, *found]


def public(module: ModuleType) -> dict[str, Any]:
    """The documented functions and classes that a module defines, in the order of their definition."""
    members = {
        name: member
        for name, member in vars(module).items()
        if not name.startswith("_")
        and (inspect.isfunction(member) or inspect.isclass(member))
        and member.__module__ == module.__name__
        and member.__doc__
    }
    lines = inspect.getsource(module).splitlines()
    position = {
        name: next((i for i, line in enumerate(lines) if re.match(rf"(class|def) {name}\b", line)), -1)
        for name in members
    }
    return dict(sorted(members.items(), key=lambda item: position[item[0]]))


def signature(name: str, member: Any) -> str:
    """`name(parameters) -> result` as it is written in the source, a long one with a line for each parameter."""
    try:
        whole = inspect.signature(member)
    except (TypeError, ValueError):
        return name
    if inspect.isclass(member):
        name, whole = f"class {name}", whole.replace(return_annotation=inspect.Signature.empty)
    line = f"{name}{whole}"
    if len(line) > 90 and whole.parameters:
        end = str(whole.replace(parameters=[])).removeprefix("()")
        line = "\n".join([f"{name}(", *(f"    {parameter}," for parameter in whole.parameters.values()), f"){end}"])
    line = re.sub(r"ForwardRef\(([^()]*)\)", r"\1", line.replace("'", ""))
    return re.sub(r"<[^<>]*object at[^<>]*>", "...", line)


def member_page(full_name: str, member: Any) -> str:
    """A function or class with its anchor, signature, docstring and documented methods."""
    name = full_name.rpartition(".")[2]
    parts = [
        f"### `{name}` {{#{full_name}}}",
        f"```python\n{signature(name, member)}\n```",
        markdown_of(member.__doc__),
    ]
    if inspect.isclass(member):
        for method, function in vars(member).items():
            function = function.fget if isinstance(function, property) else getattr(function, "__func__", function)
            is_public = not method.startswith("_") or method == "__call__"
            if (
                is_public
                and inspect.isfunction(function)
                and function.__doc__
                and function.__module__ == member.__module__
            ):
                parts.append(f"#### `{name}.{method}` {{#{full_name}.{method}}}")
                parts.append(f"```python\n{signature(method, function)}\n```\n\n{markdown_of(function.__doc__)}")
    return "\n\n".join(parts)


def room_page(title: str, package: str, summary: str) -> tuple[str, dict[str, str]]:
    """The page of a room; and the names that it documents, each with its anchor."""
    parts, anchors = [f"# {title}", summary, "Made from the docstrings."], {}
    for module in modules_of(package):
        if not module.__doc__:
            continue
        members = public(module)
        if not members and module.__name__ != package:
            continue
        parts += [f"## `{module.__name__}` {{#{module.__name__}}}", markdown_of(module.__doc__)]
        anchors[module.__name__] = module.__name__
        for name, member in members.items():
            full_name = f"{module.__name__}.{name}"
            parts.append(member_page(full_name, member))
            anchors[full_name] = full_name
            if inspect.isclass(member):
                anchors |= {
                    f"{full_name}.{method}": f"{full_name}.{method}"
                    for method in re.findall(rf"{{#{re.escape(full_name)}\.(\w+)}}", parts[-1])
                }
    return "\n\n".join(parts) + "\n", anchors


def public_names(names: dict[str, str]) -> str:
    """A table of the names that `import eairl_jax` gives, with the first sentence of their docstrings."""
    library, lines = importlib.import_module("eairl_jax"), []
    for name in library.__all__:
        anchor = names.get(f"eairl_jax.{name}", "").partition("#")[2]
        if anchor:
            summary = inspect.cleandoc(getattr(library, name).__doc__).split("\n\n")[0]
            lines.append([f"[`{name}`](#{anchor})", escaped(" ".join(summary.split()))])
    return table(["Name", ""], lines)


def commands_page() -> str:
    """Every command with its arguments, from the records that the command line is made of."""
    from eairl_jax.experiments.options import COMMANDS

    parts = ["# Commands", "`eairl COMMAND --help` prints the same in a terminal. Made from the options' docstrings."]
    for command, record in COMMANDS.items():
        arguments = [argument(record, field) for field in dataclasses.fields(record)]
        positional = [name for name, _, _, is_positional in arguments if is_positional]
        usage = " ".join(["eairl", command, *positional, *(["[OPTIONS]"] if len(arguments) > len(positional) else [])])
        parts += [f"## `eairl {command}` {{#{command}}}", f"```text\n{usage}\n```", markdown_of(record.__doc__)]
        if arguments:
            lines = [[f"`{name}`", escaped(meaning), default] for name, meaning, default, _ in arguments]
            parts.append(table(["Argument", "Meaning", "Default"], lines))
    return "\n\n".join(parts) + "\n"


def argument(record: type, field: dataclasses.Field) -> tuple[str, str, str, bool]:
    """`(as it is typed, meaning, default, whether it is positional)` of a field of an options record."""
    hint = typing.get_type_hints(record, include_extras=True)[field.name]
    extras = getattr(hint, "__metadata__", ())
    read = {
        name: next((value for extra in extras if (value := getattr(extra, name, None))), None)
        for name in ("help", "metavar", "name")
    }
    plain = hint.__origin__ if extras else hint
    choices = typing.get_args(plain) if typing.get_origin(plain) is typing.Literal else ()
    positional = any("ositional" in repr(extra) for extra in extras)
    value = read["metavar"] or (
        "{" + ",".join(choices) + "}" if choices else "" if field.type in ("bool", "Tuned") else "N"
    )
    option = f"--{(read['name'] or field.name).replace('_', '-')}"
    typed = str(read["metavar"] or value) if positional else f"{option} {value}".strip()
    has_default = not any(field.default is none for none in (dataclasses.MISSING, None, (), False))
    default = " ".join(field.default) if isinstance(field.default, tuple) else str(field.default)
    return (
        typed,
        read["help"] or field_docstrings(record)[field.name],
        f"`{default}`" if has_default else "",
        positional,
    )


def settings_page() -> str:
    """Every field of `Config` and `HParams`: default, allowed values, meaning."""
    from eairl_jax import Config, HParams
    from eairl_jax.config import CHOICES

    parts = [
        "# Settings",
        "`--set NAME=VALUE` changes any setting, and `eairl settings TASK` prints the values of a task's recipes. "
        "In Python, names and counts are fields of `Config`, floats are fields of `HParams`. Made from the "
        "docstrings.",
    ]
    for record, summary in ((Config, "Names, sizes and counts"), (HParams, "Floats: any of them can be swept")):
        documented, lines = field_docstrings(record), []
        for field in dataclasses.fields(record):
            default = ",".join(map(str, field.default)) if isinstance(field.default, tuple) else field.default
            values = " ".join(f"`{value}`" for value in CHOICES.get(field.name, ()))
            lines.append(
                [
                    f"`{field.name}`",
                    f"`{default}`" if default != "" else "none",
                    escaped(documented[field.name]) + (f" One of {values}." if values else ""),
                ]
            )
        parts += [f"## {record.__name__}", f"{summary}.", table(["Setting", "Default", "Meaning"], lines)]
    return "\n\n".join(parts) + "\n"


def examples_page() -> str:
    """The files of examples/ as they are."""
    parts = ["# Examples", "Each file of `examples/` runs as it stands: `python examples/NAME.py`."]
    for path in sorted((ROOT / "examples").glob("*.py"), key=lambda path: path.stem != "learn_a_reward"):
        code = path.read_text(encoding="utf-8")
        title = path.stem.replace("_", " ").capitalize()
        parts.append(f'## {title} {{#{path.stem}}}\n\n```python title="examples/{path.name}"\n{code}```')
    return "\n\n".join(parts) + "\n"


# Pages of docs/ ------------------------------------------------------------------------------------------------------


def outside_code(text: str, change: typing.Callable[[str], str]) -> str:
    """The text with `change` made to all of it but fenced code blocks."""
    parts = re.split(r"(^```.*?^```$)", text, flags=re.DOTALL | re.MULTILINE)
    return "".join(part if index % 2 else change(part) for index, part in enumerate(parts))


def with_mathml(text: str) -> str:
    """The text with `$$...$$` and `$...$` as MathML, which browsers draw without a script."""
    from latex2mathml.converter import convert

    text = re.sub(r"\$\$(.+?)\$\$", lambda m: convert(" ".join(m[1].split()), display="block"), text, flags=re.DOTALL)
    parts = re.split(r"(`[^`\n]*`)", text)
    # Markdown takes a line that begins with <math> for a block; <span> keeps it in the line.
    inline = (
        re.sub(r"(?<![\\$\w])\$([^$\n]+?)\$(?![\w$])", lambda m: f"<span>{convert(m[1])}</span>", part)
        for part in parts[::2]
    )
    return "".join(part for pair in zip(inline, [*parts[1::2], ""], strict=True) for part in pair)


def with_whole_figures(text: str) -> str:
    """The text with unbreakable spaces inside figures: `-4.85 ± 0.03 (1.00)`."""
    return re.sub(r"(?<=\d) (?=± \d|\(-?\d\.\d\d\))|(?<=\d ±) (?=\d)", "\N{NO-BREAK SPACE}", text)


def with_links(text: str, names: dict[str, str]) -> str:
    """The text with links to files led to their places, and full code names linked to the reference."""
    for path, place in PLACES.items():
        text = text.replace(f"({path}", f"({place}")
    text = text.replace(f"({PICTURES}", "(images/")
    text = re.sub(r"\(\.\./examples/(\w+)\.py\)", r"(reference/examples.md#\1)", text)
    return re.sub(
        r"(?<!\[)`(eairl_jax(?:\.\w+)+)`", lambda m: f"[`{m[1]}`]({names[m[1]]})" if m[1] in names else m[0], text
    )


def root_page(path: Path) -> str:
    """A page of the repository's root, its links as they are seen from docs/."""
    return path.read_text(encoding="utf-8").replace("(docs/", "(").replace("(examples/", "(../examples/")


def write(out: Path = OUT) -> None:
    """Writes every page and picture of the site to `out`, anew."""
    shutil.rmtree(out, ignore_errors=True)
    (out / "reference").mkdir(parents=True)
    (out / "images").mkdir()
    names: dict[str, str] = {}
    for room, (title, package, summary) in ROOMS.items():
        text, anchors = room_page(title, package, summary)
        (out / "reference" / f"{room}.md").write_text(text, encoding="utf-8")
        names |= {name: f"reference/{room}.md#{anchor}" for name, anchor in anchors.items()}
    library = importlib.import_module("eairl_jax")
    for name in library.__all__:
        member = getattr(library, name)
        if f"{getattr(member, '__module__', '')}.{name}" in names:
            names[f"eairl_jax.{name}"] = names[f"{member.__module__}.{name}"]
    path = out / "reference" / "library.md"
    top, rest = path.read_text(encoding="utf-8").split("\n\n## ", 1)
    path.write_text(f"{top}\n\n## Public names\n\n{public_names(names)}\n\n## {rest}", encoding="utf-8")
    pages = {"commands": commands_page, "settings": settings_page, "examples": examples_page}
    for name, page in pages.items():
        (out / "reference" / f"{name}.md").write_text(page(), encoding="utf-8")
    texts = {path.name: path.read_text(encoding="utf-8") for path in (ROOT / "docs").glob("*.md")}
    texts |= {f"{name.lower()}.md": root_page(ROOT / f"{name}.md") for name in ("CONTRIBUTING", "CHANGELOG")}
    discussion = (ROOT / "experiments" / "results" / "discussion.md").read_text(encoding="utf-8")
    texts["discussion.md"] = f"# Discussion\n\n{discussion}"
    for name, text in texts.items():
        site = outside_code(text, lambda part: with_links(with_whole_figures(with_mathml(part)), names))
        (out / name).write_text(site, encoding="utf-8")
    for picture in (*(ROOT / "docs").glob("*.*"), *(ROOT / "experiments" / "results").glob("*.png")):
        if picture.suffix in (".png", ".css"):
            shutil.copy(picture, out if picture.parent.name == "docs" else out / "images")


if __name__ == "__main__":
    write()
    print(f"wrote {OUT}")
