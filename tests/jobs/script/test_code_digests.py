"""What a script's classes and functions rest on: all that can change what they do, and nothing else."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from jobs.script.code_digests import CodeReader, digests_of, is_importable
from jobs.script.local_modules import folder_of, imported_modules
from jobs.script.parts import described_experiment
from tests.user_code import Walker

SCRIPT = """
import functools
import types
from dataclasses import dataclass

import numpy as np

LENGTH, WEIGHTS = 8, np.arange(3.0)
BONUS = {"goal": 1.0}.get
MOVES = types.SimpleNamespace(allowed={"up", "down", "left", "right"}, names=[frozenset({"north", "south", "west"})])


def reward(cell):
    return -1.0 if cell in {"a", "b"} else WEIGHTS[0] + BONUS(cell, 0.0) * len(MOVES.allowed)


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
    exec(compile(text, "<ipython-input-1>", "exec", dont_inherit=True), held)
    return CodeReader().digest(held[name])


MATTERS = {
    "its own code": ("range(LENGTH)", "range(LENGTH - 1)"),
    "a constant": ("LENGTH, WEIGHTS = 8,", "LENGTH, WEIGHTS = 9,"),
    "an array": ("np.arange(3.0)", "np.arange(4.0)"),
    "a function that it calls": ("-1.0 if", "-2.0 if"),
    "a set of texts": ('{"a", "b"}', '{"a", "c"}'),
    "a method of a value": ('"goal": 1.0', '"goal": 2.0'),
    "a set within an object": ('"up", ', '"top", '),
    "a set within a list": ('"north", ', ""),
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


@pytest.mark.parametrize("kinds", ["", "of builtins"])
def test_in_another_process(kinds: str, tmp_path: Path) -> None:
    """A script's own process says the same as a notebook's, whatever the hashes of its texts."""
    script = tmp_path / "script.py"
    text = KINDS if kinds else SCRIPT
    script.write_text(f"{text}\nfrom jobs.script.code_digests import CodeReader\nprint(CodeReader().digest(make))\n")
    for seed in ("1", "2"):
        env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[3]), "PYTHONHASHSEED": seed}
        told = subprocess.run(
            [sys.executable, script], env=env, check=True, capture_output=True, text=True, timeout=300
        )
        assert told.stdout.strip() == read(text, "make")


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


@pytest.mark.parametrize("held", ["{f, reversed}", "frozenset([f, reversed])", "SimpleNamespace(all={f, reversed})"])
def test_sets_that_hold_what_names_them(held: str) -> None:
    """They have an end, and what else is in them counts."""
    text = f"from types import SimpleNamespace\n\n\ndef f():\n    return HELD\n\n\nHELD = {held}\n"
    assert read(text, "f") == read(text, "f") != read(text.replace("reversed", "sorted"), "f")


KINDS = """
import types
from collections import defaultdict
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import NamedTuple

import numpy as np


class Settings(NamedTuple):
    size: int = 3

    def pay(self):
        return -1.0


class Move(IntEnum):
    UP = 1

    def pay(self):
        return -2.0


class Colour(Enum):
    RED = 1

    def pay(self):
        return -3.0


class Table(dict):
    def __missing__(self, key):
        return -4.0


class Path(list):
    def pay(self):
        return -5.0


class Metres(float):
    def __repr__(self):
        return "m"

    def pay(self):
        return -6.0


class Grid(np.ndarray):
    def pay(self):
        return -7.0


@dataclass(frozen=True, slots=True)
class Rule:
    size: int
    name: str = "rule"

    def pay(self):
        return -8.0


Settings.usual = Settings(4)
Path.usual = Path([Move.UP, Settings.usual])
Path.usual.within = Path.usual
SETTINGS, MOVE, COLOUR, TABLE, PATH = Settings(), Move.UP, Colour.RED, Table(a=1), Path([1, 2])
METRES, GRID, RULE, LATER = Metres(9.5), np.zeros(3).view(Grid), Rule(5), defaultdict(lambda: 1.0)
HELD = types.SimpleNamespace(rule=Rule(6), kinds=[Settings, Move, lambda: Rule])
PATH.colour = "red"


def make():
    return SETTINGS, MOVE, COLOUR, TABLE, PATH, METRES, GRID, RULE, LATER, HELD
"""
OF_KINDS = {
    **{f"a method, {number}": (f"return -{number}.0", f"return {number}.0") for number in range(1, 9)},
    "a factory": ("lambda: 1.0", "lambda: 2.0"),
    "a value beneath another text": ("Metres(9.5)", "Metres(8.5)"),
    "a slot": ("Rule(5)", "Rule(7)"),
    "a slot within": ("Rule(6)", "Rule(7)"),
    "a field": ("size: int = 3", "size: int = 2"),
    "a member": ("UP = 1", "UP = 2"),
    "an attribute of an item": ("Settings(4)", "Settings(5)"),
    "an attribute of a list": ('"red"', '"blue"'),
}


@pytest.mark.parametrize("what", OF_KINDS)
def test_classes_that_derive_from_builtins(what: str) -> None:
    """Of their values the class counts, too, and what they hold beside their items."""
    old, new = OF_KINDS[what]
    assert old in KINDS
    assert read(KINDS, "make") == read(KINDS, "make") != read(KINDS.replace(old, new), "make")


@pytest.mark.parametrize("made", ["Settings()", "types.SimpleNamespace(kind=Settings)"])
def test_values_of_a_module_of_the_users(made: str, maze: Path) -> None:
    """Their class counts as its file does, whatever it derives from, and whatever it is held by."""
    maze.write_text("from typing import NamedTuple\n\n\nclass Settings(NamedTuple):\n    size: int = 3\n")
    held: dict[str, Any] = {"__name__": "__main__"}
    text = f"import types\nfrom own_maze import Settings\nHELD = {made}\ndef make():\n    return HELD\n"
    try:
        exec(text, held)
        assert digests_of({"make": held["make"]})[1] == {"own_maze"}
    finally:
        sys.modules.pop("own_maze", None)


def test_packages_that_are_installed_count_by_name() -> None:
    """Their versions stand in the manifest."""
    reader = CodeReader()
    reader.digest(lambda: np.linalg.norm(sys.maxsize))
    assert reader.modules == {__name__}


LAZY = {
    "from": "from own_maze import Maze\n    return Maze()",
    "import": "import own_maze\n    return own_maze.Maze()",
    "in an inner function": "def inner():\n        from own_maze import Maze\n        return Maze\n    return inner()",
    "by its name": "import importlib\n    return importlib.import_module('own_maze').Maze()",
}


@pytest.fixture
def maze(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A user's module beside the script, that nothing has imported yet."""
    module = tmp_path / "own_maze.py"
    module.write_text("class Maze: ...\n")
    monkeypatch.syspath_prepend(tmp_path)
    yield module
    assert "own_maze" not in sys.modules


def identity(text: str, environment: Any = None) -> str:
    """Of an experiment whose environment is what a script calls ``make``, or an id that it registers."""
    held: dict[str, Any] = {"__name__": "__main__"}
    exec(compile(text, "<ipython-input-1>", "exec"), held)
    fields = {"name": "script", "runs": 2, "episodes": 3}
    learners: dict[str, Any] = {"Q": "q_learning"}
    made_by = environment or held["make"]
    return described_experiment(fields, made_by, learners, "apel", "return", alone=True)[0].identity


@pytest.mark.parametrize("how", LAZY)
def test_modules_that_code_imports_when_it_is_run(how: str, maze: Path) -> None:
    """They count as those at the top of the script do; nothing is imported for that, and no installed one counts."""
    text = f"def make():\n    import json, numpy.linalg\n    {LAZY[how]}\n"
    before = identity(text)
    assert identity(text) == before
    maze.write_text("class Maze:\n    goal = 7\n")
    assert identity(text) != before
    held: dict[str, Any] = {"__name__": "__main__"}
    exec(text, held)
    modules = digests_of({"make": held["make"]})[1]
    assert modules - {"own_maze.Maze"} == {"own_maze"}
    assert {folder_of(module) for module in modules} == {maze.parent}


def test_package_that_code_imports_when_it_is_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a package the files that are imported count, and what they import."""
    (tmp_path / "own_package").mkdir()
    for name in ("__init__", "mazes", "walls", "other"):
        (tmp_path / "own_package" / f"{name}.py").write_text("")
    (tmp_path / "own_package" / "mazes.py").write_text("from . import walls\n")
    monkeypatch.syspath_prepend(tmp_path)
    text = "def make():\n    from own_package import mazes\n    return mazes.Maze()\n"
    before = identity(text)
    (tmp_path / "own_package" / "other.py").write_text("WALLS = 3\n")
    assert identity(text) == before
    (tmp_path / "own_package" / "walls.py").write_text("WALLS = 3\n")
    assert identity(text) != before


def test_imports_of_long_code() -> None:
    """Where code has more than 255 constants, instructions have parts, and imports are read all the same."""
    many = "".join(f"    x = {number}.5\n" for number in range(300))
    code = compile(f"def f():\n{many}    from ..a import b, c\n    import d.e\n", "<cell>", "exec")
    assert list(imported_modules(code, "top.inner")) == ["top.a", "top.a.b", "top.a.c", "d.e"]


REGISTERED = """
import functools
import gymnasium

class Mine(gymnasium.Env):
    goal = 1

def make():
    return gymnasium.make("Mine-v3")

gymnasium.register("Mine-v3", entry_point=ENTRY, kwargs={"size": 5}, max_episode_steps=30)
"""


@pytest.mark.parametrize("entry", ["Mine", "functools.partial(Mine)", "lambda: Mine()", "'own_maze:Maze'"])
@pytest.mark.parametrize("environment", ["Mine-v3", "Mine", None])
def test_registered_environments(entry: str, environment: str | None, maze: Path) -> None:
    """What the script has registered counts, with its options, where its id is given or stands in the code."""
    text = REGISTERED.replace("ENTRY", entry)
    try:
        before = identity(text, environment)
        for old, new in (('"size": 5', '"size": 6'), ("steps=30", "steps=40")):
            del gymnasium.registry["Mine-v3"]
            assert identity(text.replace(old, new), environment) != before
        del gymnasium.registry["Mine-v3"]
        assert identity(text, environment) == before
        del gymnasium.registry["Mine-v3"]
        maze.write_text("class Maze:\n    goal = 7\n")
        assert identity(text.replace("goal = 1", "goal = 2"), environment) != before
    finally:
        gymnasium.registry.pop("Mine-v3", None)


def test_registered_environments_of_packages() -> None:
    """Their versions stand in the manifest."""
    text = "import gymnasium\n\n\ndef make():\n    return gymnasium.make('CartPole-v1')\n"
    held: dict[str, Any] = {"__name__": "__main__"}
    exec(text, held)
    digests, modules = digests_of({"make": held["make"]})
    assert set(digests) == {"make"}
    assert modules == set()
    assert identity("", "CartPole-v1") == "837b37f4a710"


def test_digest_of_a_script_is_as_it_was() -> None:
    """What is told of code with constants and sets of texts is what was told of them at commit 4044456."""
    text = (
        "SET, LIST = {'a', 'b'}, [1.5, {'k': (2, None)}]\n\n\ndef make(x=len):\n    return x(SET) in {1, 2} or LIST\n"
    )
    if sys.version_info[:2] == (3, 11):
        assert read(text, "make") == "13fb725675c5d1c4"
