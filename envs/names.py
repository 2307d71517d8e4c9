"""How tasks are named, and the names of files that belong to a task.

    pendulum                      a task of this package
    brax:hopper                   an environment that is registered in brax
    playground:CheetahRun         an environment of MuJoCo Playground
    my_tasks.py:make_env          a function in a file of the user, which returns an environment
    package.module:make_env       a function in an installed package

Arguments follow a `?`: `brax:ant?backend=mjx&terminate_when_unhealthy=false`.
"""

from __future__ import annotations

import ast
import hashlib
import re
import warnings
from typing import Any, NamedTuple

OWN, BRAX, PLAYGROUND, FILE, MODULE = "own", "brax", "playground", "file", "module"
WORDS = {"true": True, "false": False, "null": None}
# Names whose file name needs no digest, because no other name has the same.
PLAIN = re.compile(rf"(({BRAX}|{PLAYGROUND}):\w+|(?!({BRAX}|{PLAYGROUND})\.)\w+\.py:\w+)", re.ASCII)
LONGEST = 48  # characters of a file name, without its digest


class TaskError(ValueError):
    """Raised for a task that cannot be built or stepped as asked. The message says what was expected."""


class TaskName(NamedTuple):
    """A name, taken apart.

    Attributes:
      origin: `OWN`, `BRAX`, `PLAYGROUND`, `FILE` or `MODULE`.
      place: for `FILE` the path, for `MODULE` the module, else "".
      name: of the task, or of the function that makes it.
      arguments: what follows the `?`, values as Python objects.
    """

    origin: str
    place: str
    name: str
    arguments: dict[str, Any]


def parse(text: str) -> TaskName:
    """Takes a name apart. Whether such a task exists is not asked.

    Raises:
      TaskError: for a text that follows no form of the module's docstring.
    """
    base, mark, query = str(text).partition("?")
    arguments = _arguments(str(text), query) if mark else {}
    prefix, colon, rest = base.partition(":")
    if not colon:
        if base.endswith(".py"):
            raise TaskError(f"{text}: name the function that makes the environment, e.g. {base}:make_env")
        return TaskName(OWN, "", base, arguments)
    if prefix in (BRAX, PLAYGROUND):
        return TaskName(prefix, "", rest, arguments)
    place, _, function = base.rpartition(":")
    if not place or not function.isidentifier():
        raise TaskError(
            f"{text!r} names no task: expected FILE.py:FUNCTION or MODULE:FUNCTION, e.g. my_tasks.py:make_env"
        )
    return TaskName(FILE if place.endswith(".py") else MODULE, place, function, arguments)


def _arguments(text: str, query: str) -> dict[str, Any]:
    """The arguments `name=value&name=value` after the `?`."""
    arguments = {}
    for part in query.split("&"):
        name, equals, value = part.partition("=")
        if not equals or not re.fullmatch(r"[^\W\d]\w*(\.\w+)*", name):
            raise TaskError(f"{text!r}: expected name=value after ? and &, e.g. brax:ant?backend=mjx, not {part!r}")
        if name in arguments:
            raise TaskError(f"{text!r}: {name} is given twice")
        arguments[name] = value_of(value)
    return arguments


def value_of(text: str) -> Any:
    """The value of an argument: `true`, `false`, `null` and Python's literals are read, anything else is text."""
    if text in WORDS:
        return WORDS[text]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python warns of odd numbers, which are text here
            return ast.literal_eval(text)
    except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
        return text


def file_name(text: str) -> str:
    """A name of a file or folder for a task; different tasks have different ones.

    Names of this package's tasks stay as they are. `brax:hopper` becomes `brax-hopper`, `my_tasks.py:make_env` becomes
    `my_tasks-make_env`. A name with arguments or folders ends with a digest of the whole name.
    """
    if re.fullmatch(r"\w+", text, re.ASCII):
        return text
    words = re.sub(r"[^A-Za-z0-9_.]+", "-", text.replace(".py:", "-").replace(":", "-")).strip("-.")
    if PLAIN.fullmatch(text):
        return words
    return f"{words[:LONGEST]}-{hashlib.sha256(text.encode(errors='surrogatepass')).hexdigest()[:6]}"
