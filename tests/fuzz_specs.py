"""Mutated experiment files: whatever stands in one, the answer is an experiment or a `SpecError`, soon and cheaply.

``python -m tests.fuzz_specs --mutations 20000 --seed 0`` tries many; tests/jobs/experiment/test_fuzz.py tries some.
"""

from __future__ import annotations

import argparse
import copy
import gc
import random
import resource
import signal
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from jobs.experiment.plan import Plan
from jobs.experiment.spec import validate
from jobs.experiment.validation import check
from jobs.experiment.yaml_schema import to_yaml
from jobs.experiment.yaml_source import SpecError, parse

SECONDS, MEGABYTES = 2.0, 1024
_HANG_SECONDS = 120
VALUES: tuple[Any, ...] = (
    None, True, False, 0, 1, -1, 2, 3, 7, 1000, 10**6, 10**8, 10**9, 2**31, 2**63 - 1, -(2**63),
    0.0, -0.5, 0.001, 0.5, 1.0, 1.5, 1e3, 1e8, 1e300, 1e-300, float("inf"),
    "", "x", "x" * 300, "$dropped", "$none", "all", "a.b", "Q_full", "APEL", "1", "01", "1e-3", "on", "~", "2001-02-30",
    "seed", "episodes", "cuda:0", "os:getcwd", "nowhere:Thing", "é", "\U0001f600",
    [], {}, [[]], [1], ["x"], [None], [10**7], [1, 10**6], [{"x": 1}], list(range(300)),
    {"x": 1}, {"type": "apel"}, {"every": 1}, {"Q_full": 10**9}, {str(i): i for i in range(300)},
    {"factor": 1, "info": "optimal_length"},
)  # fmt: skip
SNIPPETS = (
    "!!binary ", "!!set ", "!!timestamp ", "!!float ", "!!int ", "!!python/object:os.system ", "! ", "!<> ",
    "&a ", "*a ", "&a [*a]", "<<: ", "? ", "- ", ": ", "# ", "%YAML 9.9\n", "---\n", "...\n", "\t", "\r", "\x85",
    "\u2028",
    "\x1b[31m", "\x00", "\x07", '"\\x1b[31m"', '"\\ud800"', "\u202e", "\ufeff", "{", "[", "]", "}", "'", '"', "|", ">",
    "1e400", "0x_", "0o8", "1_000", "1:30", "012", ".nan", "-.inf", "9" * 5000, "[" * 80, "2001-99-99", "1e-3",
    "null", "yes",
)  # fmt: skip


@cache
def shipped_texts() -> dict[str, str]:
    """Name → text of every file that comes along, galleries too."""
    folder = Path(str(resources.files("jobs") / "experiments"))
    return {path.stem: path.read_text(encoding="utf-8") for path in sorted(folder.rglob("*.yaml"))}


def mutated(text: str, seed: int) -> str:
    """The text after one to four mutations of its values, or of its characters; the same for the same seed."""
    random_one = random.Random(seed)
    if random_one.random() < 0.7:
        content = copy.deepcopy(parse(text, "shipped").content)
        for _ in range(random_one.randint(1, 4)):
            _change_value(content, random_one)
        text = to_yaml(content)
    if random_one.random() < 0.4:
        for _ in range(random_one.randint(1, 3)):
            text = _change_text(text, random_one)
    return text


def _change_value(content: Any, random_one: random.Random) -> None:
    places: list[tuple[Any, Any]] = []
    _collect(content, places)
    if not places:
        return
    node, key = random_one.choice(places)
    other, other_key = random_one.choice(places)
    match random_one.randrange(8):
        case 0 | 1 | 2 | 3:
            node[key] = copy.deepcopy(random_one.choice(VALUES))
        case 4:
            del node[key]
        case 5:
            node[key] = copy.deepcopy(other[other_key])
        case 6 if isinstance(node, dict):
            node[random_one.choice(("", "x", "label", "seed", f"{key}s", str(other_key), "on"))] = node.pop(key)
        case 6 | 7:
            if isinstance(node, list):
                node *= random_one.choice((2, 50))
            else:
                node[random_one.choice((str(other_key), "x", "sweep"))] = copy.deepcopy(random_one.choice(VALUES))


def _collect(node: Any, places: list[tuple[Any, Any]]) -> None:
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, child in items:
        places.append((node, key))
        if len(places) < 5000:
            _collect(child, places)


def _change_text(text: str, random_one: random.Random) -> str:
    start = random_one.randrange(len(text) + 1)
    end = min(start + random_one.randint(0, 12), len(text))
    lines = text.splitlines(keepends=True)
    line = random_one.randrange(len(lines)) if lines else 0
    match random_one.randrange(5):
        case 0:
            return text[:start] + text[end:]
        case 1:
            return text[:start] + random_one.choice(SNIPPETS) + text[end:]
        case 2:
            return "".join([*lines[:line], *lines[line : line + 1] * 2, *lines[line + 1 :]])
        case 3:
            # Where a value begins: a tag, an anchor or an alias is of use there.
            colon = text.find(": ", start)
            return text if colon < 0 else text[: colon + 2] + random_one.choice(SNIPPETS) + text[colon + 2 :]
    return "".join([*lines[:line], *lines[line + 1 :]])


@dataclass(frozen=True)
class Verdict:
    """What a file gave: valid, refused, or a fault with its story; CPU seconds; the process's peak memory so far."""

    kind: str
    story: str
    seconds: float
    megabytes: float


def judge(text: str) -> Verdict:
    """Validate a file as ``apel validate`` does; one that is valid is also written and read again."""
    began = time.process_time()
    kind, story = "valid", ""
    try:
        experiment = validate(parse(text, "mutated.yaml"))
        check(Plan.of(experiment))
    except SpecError as error:
        kind, story = "refused", str(error)
    except Exception:  # noqa: BLE001 - any of them is what is looked for
        kind, story = "fault", traceback.format_exc()
    seconds = time.process_time() - began
    if kind == "valid":
        again = validate(parse(experiment.to_yaml(), "again.yaml"))
        if (again.identity, again.model_dump()) != (experiment.identity, experiment.model_dump()):
            kind, story = "fault", "written and read again it is another experiment"
    megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return Verdict(kind, story, seconds, megabytes)


def warm_up() -> None:
    """Import and compile what files that come along need, which is no part of the time of one of them."""
    for text in shipped_texts().values():
        judge(text)


def _alarm(*_: Any) -> None:
    message = f"no answer within {_HANG_SECONDS} s"
    raise TimeoutError(message)


def main() -> int:
    """Try many, and say what came of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mutations", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    signal.signal(signal.SIGALRM, _alarm)
    warm_up()
    names = list(shipped_texts())
    say: Callable[[str], Any] = sys.stdout.write
    kinds: Counter[str] = Counter()
    slowest, faults = (0.0, -1), 0
    for number in range(arguments.seed, arguments.seed + arguments.mutations):
        name = names[number % len(names)]
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        signal.alarm(_HANG_SECONDS)
        verdict = judge(mutated(shipped_texts()[name], number))
        signal.alarm(0)
        kinds[verdict.kind] += 1
        slowest = max(slowest, (verdict.seconds, number))
        is_large = verdict.megabytes > max(MEGABYTES, before + 1)
        if verdict.kind == "fault" or verdict.seconds > SECONDS or is_large:
            faults += 1
            say(f"{number} ({name}): {verdict.seconds:.2f} s, {verdict.megabytes:.0f} MB, {verdict.kind}\n")
            say(f"{verdict.story}\n")
            sys.stdout.flush()
        if number % 500 == 0:
            gc.collect()
            sys.stderr.write(f"{number}: {dict(kinds)}, slowest {slowest[0]:.2f} s\n")
    say(f"{arguments.mutations} mutations: {dict(kinds)}; {faults} faults; slowest {slowest[0]:.2f} s ({slowest[1]}); ")
    say(f"peak {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB\n")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
