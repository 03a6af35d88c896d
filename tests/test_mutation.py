"""The tool that breaks lines on purpose (`make mutation`): every mutant is one small change, and the seed draws it."""

from __future__ import annotations

import ast

import pytest

from tests.mutation.__main__ import drawn, watched_files
from tests.mutation.operators import mutants

SOURCE = '''
"""Not 1."""
from module import f
class A:
    limit: int = 3
    def g(self, x: "1 + 1", y=True):
        self.x[0] = min(x, y)
        if x < 2 and y:
            raise ValueError(1)
        f(x)
        x += 5
        return x - 1
'''


@pytest.mark.parametrize(
    ("kind", "line", "after"),
    [
        ("constant + 1", 5, "limit: int = 4"),
        ("constant", 6, "def g(self, x: '1 + 1', y=False):"),
        ("constant − 1", 7, "self.x[-1] = min(x, y)"),
        ("min ↔ max", 7, "self.x[0] = max(x, y)"),
        ("assignment removed", 7, "self.x[0] = self.x[0]"),
        ("condition negated", 8, "if not (x < 2 and y):"),
        ("comparison", 8, "if x <= 2 and y:"),
        ("and ↔ or", 8, "if x < 2 or y:"),
        ("call removed", 10, "None"),
        ("arithmetic", 11, "x -= 5"),
        ("assignment removed", 11, "x += 0"),
        ("arithmetic", 12, "return x + 1"),
    ],
)
def test_kinds(kind: str, line: int, after: str) -> None:
    """Each kind breaks its statement, at its line."""
    assert (kind, line, after) in {(one.kind, one.line, one.after) for one in mutants("a.py", SOURCE)}


def test_each_is_another_program() -> None:
    """No two are the same, none is the original; annotations, docstrings, imports and what is raised stay."""
    found = [one.source for one in mutants("a.py", SOURCE)]
    assert len(set(found)) == len(found)
    for source in found:
        assert source != ast.unparse(ast.parse(SOURCE))
        assert all(kept in source for kept in ('"""Not 1."""', "import f", "x: '1 + 1'", "raise ValueError(1)"))


def test_core_is_watched() -> None:
    """Every file that is broken has tests that should notice, and a seed draws the same mutants of several files."""
    files = watched_files()
    assert all(files.values())
    paths = ["apel/run/criterion.py", "cluster/retry.py"]
    assert set(paths) <= set(files)
    assert drawn(paths, 20, seed=1) == drawn(paths, 20, seed=1)
    assert {mutant.path for mutant in drawn(paths, 2, seed=1)} == set(paths)
    assert len(drawn(paths, 60, seed=1)) == 60
