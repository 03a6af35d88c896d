"""How many slips in the pure core the tests notice.

Breaks one line at a time in a copy of the tree, runs the tests that should notice, without Ray and mostly without
compiling, and prints every mutant with what became of it. Which mutants are drawn depends on the seed alone. One that
survives is either a missing test or changes nothing that matters: a person has to look.

    python -m tests.mutation --number 100 --seed 1 --only apel/run cluster/retry.py
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.mutation.operators import Mutant, mutants

ROOT = Path(__file__).parents[2]
COPIED = ("apel", "cluster", "jobs", "tests", "pyproject.toml")
WATCHED = {
    "apel/run/*.py": ("tests/apel/run",),
    "apel/run/user_code.py": ("tests/apel/run", "tests/jobs/test_user_faults.py"),
    "apel/selectors/**/*.py": ("tests/apel/selectors",),
    "cluster/retry.py": ("tests/cluster/test_retry.py",),
    "cluster/pool*.py": ("tests/cluster/test_pool*.py",),
    "cluster/pool*/**/*.py": ("tests/cluster/test_pool*.py", "tests/cluster/pool*"),
    "jobs/experiment/plan.py": ("tests/jobs/experiment/test_plan.py",),
}
"""The files to break, and the tests that should notice."""
COMPILED = ("tests/apel/selectors",)
"""Tests that would take minutes as plain Python: what a mutant concerns is compiled, the rest is found in a cache."""
_SLACK, _LEAST_SECONDS = 4.0, 60.0


@dataclass(frozen=True)
class Watch:
    """Some tests as they are without any mutant.

    Attributes
    ----------
    files:
        Where they are.
    skipped:
        Options of pytest that leave out those that fail, since nothing is compiled.
    seconds:
        How long the others take.
    """

    files: tuple[str, ...]
    skipped: tuple[str, ...]
    seconds: float


def watched_files() -> dict[str, tuple[str, ...]]:
    """The files to break, each with its tests."""
    found = {}
    for pattern, tests in WATCHED.items():
        places = tuple(str(path.relative_to(ROOT)) for test in tests for path in sorted(ROOT.glob(test)))
        for path in sorted(ROOT.glob(pattern)):
            found[str(path.relative_to(ROOT))] = places
    return found


def drawn(paths: Sequence[str], number: int, seed: int) -> list[Mutant]:
    """So many mutants of these files; file by file, so that a long file does not crowd out the others."""
    generator = random.Random(seed)
    piles = {path: mutants(path, (ROOT / path).read_text()) for path in paths}
    for pile in piles.values():
        generator.shuffle(pile)
    chosen: list[Mutant] = []
    while len(chosen) < number and any(piles.values()):
        for path in paths:
            if piles[path] and len(chosen) < number:
                chosen.append(piles[path].pop())
    return sorted(chosen, key=lambda mutant: (mutant.path, mutant.line))


def run_tests(
    tree: Path, files: tuple[str, ...], options: Sequence[str] = (), limit_seconds: float | None = None
) -> tuple[int, str]:
    """The exit status of pytest and what it printed; 124 where it took too long."""
    # Without files of byte code, which could be those of an earlier mutant.
    settings = {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    if files != COMPILED:
        settings["NUMBA_DISABLE_JIT"] = "1"
    # Plain numbers of NumPy warn where 64 bits overflow, which random streams do on purpose.
    fixed = ["-q", "-m", "not ray", "-p", "no:cacheprovider", "-W", "ignore::RuntimeWarning"]
    command = [sys.executable, "-m", "pytest", *fixed, *options, *files]
    try:
        done = subprocess.run(
            command, cwd=tree, env=os.environ | settings, capture_output=True, text=True, check=False,
            timeout=limit_seconds,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return 124, ""
    return done.returncode, done.stdout + done.stderr


def watch(tree: Path, files: tuple[str, ...]) -> Watch:
    """See how the tests fare without any mutant."""
    status, printed = run_tests(tree, files)
    failing = tuple(re.findall(r"^(?:FAILED|ERROR) (\S+::[^\n]*?)(?: - .*)?$", printed, flags=re.MULTILINE))
    skipped = tuple(argument for name in failing for argument in ("--deselect", name))
    began = time.monotonic()
    status, printed = run_tests(tree, files, skipped)
    if status != 0:
        message = f"{files}: found failing tests, expected that all pass without a mutant\n{printed}"
        raise SystemExit(message)
    return Watch(files, skipped, time.monotonic() - began)


def fate(tree: Path, mutant: Mutant, by: Watch) -> str:
    """What becomes of a mutant: caught, survived, or caught by never ending."""
    path = tree / mutant.path
    original = path.read_text()
    path.write_text(mutant.source)
    limit = max(_SLACK * by.seconds, _LEAST_SECONDS)
    try:
        status, printed = run_tests(tree, by.files, ["-x", *by.skipped], limit)
    finally:
        path.write_text(original)
    if status in (3, 5):  # it is the tests that are at fault
        message = f"{mutant.path}:{mutant.line}: pytest ended with {status}\n{printed}"
        raise SystemExit(message)
    return {0: "SURVIVED", 124: "caught (time)"}.get(status, "caught")


def say(line: str) -> None:
    """Write a line at once: a whole run takes an hour."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def copied(tree: Path) -> None:
    """Copy what the tests need, without byte code."""
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy2(ROOT / name, tree / name)


def main() -> None:
    """Draw, break, test, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--number", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="*", default=[""], help="beginnings of paths")
    arguments = parser.parse_args()
    files = {path: tests for path, tests in watched_files().items() if path.startswith(tuple(arguments.only))}
    chosen = drawn(list(files), arguments.number, arguments.seed)
    fates: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder)
        copied(tree)
        watches: dict[tuple[str, ...], Watch] = {}
        for mutant in chosen:
            tests = files[mutant.path]
            if tests not in watches:
                watches[tests] = watch(tree, tests)
                say(f"{' '.join(tests)}: {watches[tests].seconds:.0f} s, without {watches[tests].skipped[1::2]}")
            fates.append(fate(tree, mutant, watches[tests]))
            say(f"{fates[-1]:14}{mutant.path}:{mutant.line}  {mutant.kind}: {mutant.before}  →  {mutant.after}")
    survived = fates.count("SURVIVED")
    say(f"{len(fates)} mutants, {len(fates) - survived} caught, {survived} survived")


if __name__ == "__main__":
    main()
