"""Plants one bug after another in a copy of the repository, and runs the tests that must fail: `make test-mutants`.

    python tests/mutants/run.py                     # all of them
    python tests/mutants/run.py --only ppo          # those whose names contain "ppo"
    python tests/mutants/run.py --shard 1/4         # the first quarter of them
    python tests/mutants/run.py --list

Before any bug is planted, the tests must pass without one. A bug that no test catches makes the exit code 1.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from bugs import BUGS, Bug

ROOT = Path(__file__).resolve().parents[2]
COPIED = ("eairl_jax", "envs", "experiments", "tests", "examples", "docs", "pyproject.toml", "README.md")
SECONDS = 600
"""The tests of a bug that take longer are ended: the bug made an endless loop, which counts as caught."""
ADDOPTS = "addopts=--import-mode=importlib"
"""Instead of those in pyproject.toml, which print the slowest tests."""
CAUGHT, SURVIVED, BROKEN = "caught", "SURVIVED", "BROKEN"


def stale(bug: Bug) -> str:
    """What is wrong with a bug that fits the present files no more; empty if it fits."""
    path = ROOT / bug.file
    if not path.is_file():
        return f"{bug.file} does not exist"
    found = path.read_text(encoding="utf-8").count(bug.right)
    if found != 1:
        return f"{bug.file} holds {found} times, not once: {bug.right!r}"
    missing = [test for test in bug.tests if not exists(test)]
    return f"no tests {', '.join(missing)}" if missing else ""


def exists(test: str) -> bool:
    """Whether there is a test, or a file of tests, as pytest names it below `tests/`."""
    file, _, name = test.partition("::")
    path = ROOT / "tests" / file
    return path.is_file() and f"def {name.partition('[')[0]}" in path.read_text(encoding="utf-8")


def refuse_stale(bugs: Sequence[Bug]) -> None:
    """Ends the program if a bug fits the present files no more, or two have one name."""
    faults = [f"{bug.name}: {fault}" for bug in bugs if (fault := stale(bug))]
    names = [bug.name for bug in bugs]
    faults += [f"{name}: two bugs of this name" for name in sorted({name for name in names if names.count(name) > 1})]
    if faults:
        sys.exit("\n".join(["Bugs to write anew in tests/mutants/bugs.py:", *faults]))


def copy_repository(copy: Path) -> None:
    """Copies what the tests read; the links of the package stay links."""
    ignored = shutil.ignore_patterns("__pycache__", ".venv", "runs", "build")
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, copy / name, symlinks=True, ignore=ignored)
        elif (ROOT / name).exists():
            shutil.copy(ROOT / name, copy / name)


def run_tests(copy: Path, tests: Sequence[str], limit: float = SECONDS) -> tuple[int, str]:
    """`(pytest's exit code, what pytest printed)`; the exit code is 1 if the tests took longer than `limit` seconds."""
    # No byte code: a file that was changed twice in one second would be taken from its old byte code.
    environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    options = ["-x", "-q", "-n0", "-m", "not slow", "-p", "no:cacheprovider", "-o", ADDOPTS, "--tb=line"]
    command = [sys.executable, "-m", "pytest", *options, *(f"tests/{test}" for test in tests)]
    try:
        done = subprocess.run(
            command, cwd=copy, env=environment, capture_output=True, text=True, timeout=limit, check=False
        )
    except subprocess.TimeoutExpired:
        return 1, f"longer than {limit} s"
    return done.returncode, done.stdout + done.stderr


def first_failure(output: str) -> str:
    """The name of the test that failed."""
    lines = [line for line in output.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return lines[0].split(" - ")[0].partition("tests/")[2] if lines else output.strip()[-200:]


def plant(copy: Path, bug: Bug) -> tuple[str, str]:
    """`(CAUGHT, SURVIVED or BROKEN, what failed)` of one bug; the copy is then as it was."""
    path = copy / bug.file
    text = path.read_text(encoding="utf-8")
    changed = text.replace(bug.right, bug.wrong)
    compile(changed, str(path), "exec")
    path.write_text(changed, encoding="utf-8")
    try:
        code, output = run_tests(copy, bug.tests)
    finally:
        path.write_text(text, encoding="utf-8")
    if code == 0:
        return SURVIVED, ", ".join(bug.tests)
    # Any other exit code than 1 says that no test ran: the file could not be imported, or a test has a new name.
    return (CAUGHT if code == 1 else BROKEN), first_failure(output)


def chosen(options: argparse.Namespace) -> list[Bug]:
    """The bugs that the options name."""
    index, count = (int(number) for number in options.shard.split("/"))
    if not 1 <= index <= count:
        sys.exit(f"--shard {options.shard}: expected i/n with i from 1 to n")
    named = [bug for bug in BUGS if not options.only or any(part in bug.name for part in options.only)]
    return named[index - 1 :: count]


def show(name: str, seconds: float, verdict: str, detail: str) -> None:
    """A line of the table, at once."""
    print(f"{name:40} {verdict:9} {seconds:6.1f} s  {detail}", flush=True)


def main() -> int:
    """The exit code: 0 if every bug was caught."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="append", metavar="NAME", help="bugs whose names contain this; repeatable")
    parser.add_argument("--shard", default="1/1", metavar="I/N", help="the I-th of N parts")
    parser.add_argument("--list", action="store_true", help="names and tests, without a run")
    parser.add_argument("--no-baseline", action="store_true", help="do not run the tests without a bug first")
    options = parser.parse_args()
    refuse_stale(BUGS)
    bugs = chosen(options)
    if options.list:
        for bug in bugs:
            print(f"{bug.name:40} {bug.file:45} {', '.join(bug.tests)}")
        return 0
    verdicts = []
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copy = Path(folder)
        copy_repository(copy)
        if not options.no_baseline:
            started = time.monotonic()
            code, output = run_tests(copy, sorted({test for bug in bugs for test in bug.tests}), len(bugs) * SECONDS)
            show("without a bug", time.monotonic() - started, "passed" if code == 0 else "FAILED", "")
            if code:
                print(output[-3000:])
                return 2
        for bug in bugs:
            started = time.monotonic()
            verdict, detail = plant(copy, bug)
            verdicts.append(verdict)
            show(bug.name, time.monotonic() - started, verdict, detail)
    counts = ", ".join(f"{verdicts.count(kind)} {kind}" for kind in (CAUGHT, SURVIVED, BROKEN))
    print(f"{len(bugs)} bugs: {counts}")
    return 0 if verdicts.count(CAUGHT) == len(bugs) else 1


if __name__ == "__main__":
    sys.exit(main())
