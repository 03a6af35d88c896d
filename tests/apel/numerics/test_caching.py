"""Compiled functions: where they are kept, found again while their source is the same, and never when it is not."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import apel
from tests.snippets import Snippets, snippets

CALLEE = '''
"""Callee."""
from apel.numerics.compiled import njit
SCALE = 2
@njit
def scaled(x):
    """Scaled."""
    return x * SCALE
'''
CALLER = '''
"""Caller."""
from apel.numerics.compiled import KernelFunction, njit
from apel.callee import scaled
from numba import int64
@njit
def shifted(x):
    """Shifted."""
    return scaled(x) + 1
def _by_address(x):
    """Shifted, too."""
    return scaled(x) + 1
by_address = KernelFunction(_by_address, int64(int64))
'''
USE = """
from apel.caller import by_address, shifted
from apel.callee import scaled
report(shifted=shifted(5), by_address=by_address(5), misses=sum(shifted.stats.cache_misses.values()),
       hits=sum(shifted.stats.cache_hits.values()), pointer_hits=by_address._pointer.cache_hits,
       path=shifted.stats.cache_path)
"""
PREAMBLE = "import json\ndef report(**found): print(json.dumps(found))\n"


@dataclass
class Copy:
    """A package ``apel`` of nothing but the real `apel.numerics`, and two modules with kernels."""

    folder: Path
    processes: Snippets

    def edit(self, name: str, old: str, new: str) -> None:
        """Replace text in a module."""
        path = self.folder / "apel" / f"{name}.py"
        source = path.read_text()
        assert old in source
        path.write_text(source.replace(old, new))

    def run(self, code: str = USE, **environment: str) -> dict[str, Any]:
        """What a new process reports."""
        kept = {key: value for key, value in os.environ.items() if key not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
        variables = kept | {"HOME": str(self.folder / "home")} | environment
        done = self.processes.play(PREAMBLE + code, variables, self.folder, [str(self.folder)])
        assert done.returncode == 0, done.stderr
        reported: dict[str, Any] = json.loads(done.stdout)
        return reported


@pytest.fixture(scope="module")
def processes() -> Iterator[Snippets]:
    """Processes that have numba, and nothing of this project."""
    with snippets("numpy", "numba") as started:
        yield started


@pytest.fixture
def copy(tmp_path: Path, processes: Snippets) -> Copy:
    package = tmp_path / "apel"
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(Path(apel.__file__).parent / "numerics", package / "numerics", ignore=ignored)
    (package / "__init__.py").touch()
    (package / "callee.py").write_text(CALLEE)
    (package / "caller.py").write_text(CALLER)
    return Copy(tmp_path, processes)


def test_cache_lies_in_the_package_and_is_found(copy: Copy) -> None:
    """A second process compiles nothing; the files lie in the package, in a folder of the module and its source."""
    first, second = copy.run(), copy.run()
    assert (first["shifted"], first["by_address"], first["misses"], first["pointer_hits"]) == (11, 11, 1, 0)
    assert (second["shifted"], second["by_address"], second["misses"], second["hits"]) == (11, 11, 0, 1)
    assert second["pointer_hits"] == 1
    path = Path(second["path"])
    assert path.parent == copy.folder / "apel" / "__pycache__" / "numba"
    assert path.name.startswith("apel.caller-")


def test_texts_compile_nothing(copy: Copy) -> None:
    """Edits of docstrings and comments, also such that move functions to other lines, leave all that is compiled."""
    copy.run()
    copy.edit("callee", '"""Scaled."""', '"""Scaled by SCALE,\n    as it is."""')
    copy.edit("caller", "@njit", "# Why it is there.\n\n@njit")
    copy.edit("caller", '"""Shifted, too."""', "")
    found = copy.run()
    assert (found["shifted"], found["by_address"], found["misses"], found["hits"], found["pointer_hits"]) == (
        11, 11, 0, 1, 1,
    )  # fmt: skip


def test_other_modules_compile_nothing(copy: Copy) -> None:
    """An edit of code that a kernel's module does not import leaves what is compiled."""
    copy.run()
    copy.edit("numerics/seeding", "generator.randint", "0 + generator.randint")
    found = copy.run()
    assert (found["misses"], found["hits"]) == (0, 1)


@pytest.mark.parametrize(
    ("old", "new", "expected"), [("x * SCALE", "x * SCALE * 3", 31), ("SCALE = 2", "SCALE = 4", 21)]
)
def test_edit_of_a_callee_is_seen(copy: Copy, old: str, new: str, expected: int) -> None:
    """A function is compiled anew when one that it calls changes in another module, or a constant of that; and back."""
    copy.run()
    copy.edit("callee", old, new)
    changed = copy.run()
    assert (changed["shifted"], changed["by_address"], changed["misses"]) == (expected, expected, 1)
    copy.edit("callee", new, old)
    back = copy.run()
    assert (back["shifted"], back["by_address"], back["misses"]) == (11, 11, 0)


def test_edit_under_a_running_process_spoils_nothing(copy: Copy) -> None:
    """What a process loaded before an edit is neither saved for the edited source nor taken from its cache."""
    late = """
import apel.caller
from pathlib import Path
path = Path(apel.caller.__file__).with_name("callee.py")
path.write_text(path.read_text().replace("SCALE = 2", "SCALE = 40"))
"""
    assert copy.run(late + USE)["shifted"] == 11
    found = copy.run()
    assert (found["shifted"], found["by_address"], found["misses"]) == (201, 201, 1)
    copy.edit("callee", "SCALE = 40", "SCALE = 2")
    found = copy.run(late + USE)
    assert (found["shifted"], found["misses"]) == (11, 1)


def test_functions_of_one_name(copy: Copy) -> None:
    """Two functions of one name and byte code that differ in a constant, or in what they call, are told apart."""
    twice = """
from apel.numerics.compiled import njit
@njit
def f(x): return x + {first}
first = f
@njit
def f(x): return x + {second}
"""
    (copy.folder / "apel" / "twice.py").write_text(twice.format(first=1, second=2))
    use = "from apel.twice import f, first\nreport(found=[first(0), f(0)])"
    assert [copy.run(use)["found"], copy.run(use)["found"]] == [[1, 2], [1, 2]]


@pytest.mark.parametrize("named", ["", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR"])
def test_package_that_cannot_be_written_to(copy: Copy, named: str) -> None:
    """Its kernels are kept in the user's cache folder, or where the user said; and found again.

    A file stands where the folder would be, which stops even those who may write everywhere.
    """
    (copy.folder / "apel" / "__pycache__").touch()
    environment = {named: str(copy.folder / "named")} if named else {}
    first, second = copy.run(**environment), copy.run(**environment)
    assert (first["misses"], second["misses"], second["pointer_hits"]) == (1, 0, 1)
    root = {
        "": copy.folder / "home" / ".cache" / "apel" / "numba",
        "XDG_CACHE_HOME": copy.folder / "named" / "apel" / "numba",
        "NUMBA_CACHE_DIR": copy.folder / "named" / "apel",
    }
    assert Path(second["path"]).parent == root[named]


def test_folder_of_the_user_comes_first(copy: Copy) -> None:
    """NUMBA_CACHE_DIR is heeded where the package could be written to, too; no stale code is found there either."""
    named = {"NUMBA_CACHE_DIR": str(copy.folder / "named")}
    assert Path(copy.run(**named)["path"]).parent == copy.folder / "named" / "apel"
    copy.edit("callee", "SCALE = 2", "SCALE = 4")
    assert copy.run(**named)["shifted"] == 21


def test_locators_of_the_user_find_nothing_stale(copy: Copy) -> None:
    """Where numba has been told to use other locators, an edit of a callee is seen as well."""
    named = {"NUMBA_CACHE_LOCATOR_CLASSES": "InTreeCacheLocator"}
    assert copy.run(**named)["shifted"] == 11
    copy.edit("callee", "SCALE = 2", "SCALE = 4")
    assert copy.run(**named)["shifted"] == 21


def test_nowhere_to_write(copy: Copy) -> None:
    """Without any folder to write to, functions are compiled in every process, and work."""
    (copy.folder / "apel" / "__pycache__").touch()
    (copy.folder / "home").touch()
    use = "from apel.caller import shifted\nreport(shifted=shifted(5), path=str(shifted.stats.cache_path))"
    assert copy.run(use) == {"shifted": 11, "path": "None"}


def test_functions_of_users(copy: Copy) -> None:
    """A user's function is compiled anew when its own file changes, or anything of the package that it calls."""
    mine = copy.folder / "mine.py"
    source = """
from apel.caller import shifted
from apel.numerics.compiled import njit
@njit
def f(x): return shifted(x) + 100
"""
    use = "from mine import f\nreport(found=f(5), misses=sum(f.stats.cache_misses.values()))"
    mine.write_text(source)
    assert copy.run(use) == {"found": 111, "misses": 1}
    assert copy.run(use) == {"found": 111, "misses": 0}
    copy.edit("callee", "SCALE = 2", "SCALE = 4")
    assert copy.run(use) == {"found": 121, "misses": 1}
    mine.write_text(source.replace("100", "200"))
    assert copy.run(use) == {"found": 221, "misses": 1}


def test_marks(copy: Copy) -> None:
    """What is marked as compiled stays so through edits of texts, and no longer once code has changed."""
    use = "from apel.numerics.compiled import *\nreport(found=is_compiled('one'), other=is_compiled('other'))"
    mark = "from apel.numerics.compiled import *\nmark_compiled('one')\n"
    assert copy.run(use) == {"found": False, "other": False}
    copy.run(mark + use)
    assert copy.run(use) == {"found": True, "other": False}
    copy.edit("callee", '"""Callee."""', "# Nothing.")
    assert copy.run(use)["found"] is True
    copy.edit("callee", "x * SCALE", "SCALE * x")
    assert copy.run(use)["found"] is False


@pytest.mark.parametrize("statement", ["", "import apel"])
def test_functions_of_the_host(tmp_path: Path, statement: str) -> None:
    """A function of somebody else's is cached by numba where it would be without apel, whose settings are untouched."""
    (tmp_path / "host.py").write_text("import numba\n@numba.njit(cache=True)\ndef f(x): return x + 1\n")
    code = f"""
import numba
from numba.core.caching import CacheImpl
before = dict(vars(numba.config)), list(CacheImpl._locator_classes)
{statement}
assert before == (dict(vars(numba.config)), list(CacheImpl._locator_classes))
import host
host.f(1)
print(host.f.stats.cache_path)
"""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr) == (str(tmp_path / "__pycache__"), "")
