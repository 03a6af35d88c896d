"""What a script's classes and functions rest on: all that can change what they do, and nothing else."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jobs.script.code_digests import CodeReader, digests_of, folder_of, is_importable
from tests.user_code import Walker

SCRIPT = """
import functools
from dataclasses import dataclass

import numpy as np

LENGTH, WEIGHTS = 8, np.arange(3.0)


def reward(cell):
    return -1.0 if cell in {"a", "b"} else WEIGHTS[0]


class Base:
    def close(self):
        pass


class Walk(Base):
    colour = "red"

    def __init__(self, wind=0.2):
        self.wind = wind

    def step(self, action):
        "One step."
        return [reward(cell) for cell in range(LENGTH)]

    @property
    def half(self):
        return lambda: self.wind / 2

    @staticmethod
    def name():
        return "walk"


@dataclass(frozen=True)
class Rule:
    epsilon: float = 0.1


def make():
    return functools.partial(Walk, wind=0.1)()
"""


def read(text: str, name: str = "Walk") -> str:
    """The digest of something that a script holds, as if it were typed into a notebook."""
    held: dict[str, Any] = {"__name__": "__main__"}
    exec(compile(text, "<ipython-input-1>", "exec"), held)
    return CodeReader().digest(held[name])


MATTERS = {
    "its own code": ("range(LENGTH)", "range(LENGTH - 1)"),
    "a constant": ("LENGTH, WEIGHTS = 8,", "LENGTH, WEIGHTS = 9,"),
    "an array": ("np.arange(3.0)", "np.arange(4.0)"),
    "a function that it calls": ("-1.0 if", "-2.0 if"),
    "a set of texts": ('{"a", "b"}', '{"a", "c"}'),
    "its base": ("        pass", "        return 1"),
    "a default": ("wind=0.2):", "wind=0.3):"),
    "an attribute": ('"red"', '"blue"'),
    "a property": ("self.wind / 2", "self.wind / 3"),
    "a static method": ('"walk"', '"run"'),
}
DOES_NOT_MATTER = {
    "a comment": ("    colour", "    # what it looks like\n    colour"),
    "a docstring": ('"One step."', '"One step, and no more."'),
    "a position": ("\nLENGTH", "\n\n\nprint()\nLENGTH"),
    "what it does not name": ("epsilon: float = 0.1", "epsilon: float = 0.2"),
}


@pytest.mark.parametrize("what", MATTERS)
def test_matters(what: str) -> None:
    """Whatever can change a row changes the digest, also that of a function that only names the class."""
    old, new = MATTERS[what]
    assert old in SCRIPT
    for name in ("Walk", "make"):
        assert read(SCRIPT.replace(old, new), name) != read(SCRIPT, name)


@pytest.mark.parametrize("what", DOES_NOT_MATTER)
def test_does_not_matter(what: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The rest of a script may change."""
    old, new = DOES_NOT_MATTER[what]
    assert old in SCRIPT
    for name in ("Walk", "make"):
        assert read(SCRIPT.replace(old, new), name) == read(SCRIPT, name)


def test_dataclass_defaults() -> None:
    """They are no constants of its code."""
    assert read(SCRIPT.replace("float = 0.1", "float = 0.2"), "Rule") != read(SCRIPT, "Rule")


def test_in_another_process(tmp_path: Path) -> None:
    """A script's own process says the same as a notebook's, whatever the hashes of its texts."""
    script = tmp_path / "script.py"
    script.write_text(f"{SCRIPT}\nfrom jobs.script.code_digests import CodeReader\nprint(CodeReader().digest(make))\n")
    env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[3]), "PYTHONHASHSEED": "1"}
    told = subprocess.run([sys.executable, script], env=env, check=True, capture_output=True, text=True, timeout=300)
    assert told.stdout.strip() == read(SCRIPT, "make")


def made(share: float) -> Any:
    """A class that closes over something."""

    class Closed(Walker):
        def act(self, observation: Any) -> tuple[int, Any]:
            return int(share), np.zeros(2)

    return Closed


def test_of_a_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a module's import path stands for needs no digest but its files'; what a function of it has made does."""
    parts = {"tests.user_code:Walker": Walker, "one": made(0.1), "two": made(0.2)}
    digests, modules = digests_of(parts)
    assert set(digests) == {"one", "two"}
    assert digests["one"] != digests["two"]
    assert modules == {"tests.user_code", __name__}
    assert folder_of(__name__) == Path(__file__).parents[3]
    assert is_importable(Walker)
    assert not is_importable(functools.partial(Walker))


def test_recursion() -> None:
    """What names itself is read once."""
    text = "def even(n):\n    return n == 0 or odd(n - 1)\n\n\ndef odd(n):\n    return n != 0 and even(n - 1)\n"
    assert read(text, "even") == read(text, "even") != read(text.replace("n != 0", "n > 0"), "even")


def test_packages_that_are_installed_count_by_name() -> None:
    """Their versions stand in the manifest."""
    reader = CodeReader()
    reader.digest(lambda: np.linalg.norm(sys.maxsize))
    assert reader.modules == {__name__}
