"""Which edits of a package's source count, and for which of its modules."""

from __future__ import annotations

from pathlib import Path

import pytest

from apel.numerics.sources import Sources, parse_module, read_sources

SOURCE = '''
"""Module."""
from pack import low
LIMIT = 3
"""What it is."""
class One:
    """Class."""
    value: int = 1
    """Attribute."""
    def method(self, x):
        """Method."""
        return x + LIMIT
'''
PACKAGE = {
    "__init__": "from pack.top import f",
    "low": "ONE = 1",
    "middle/__init__": "from .. import low\nfrom pack.middle.part import g",
    "middle/part": "from ..low import ONE\ndef g(): return ONE",
    "top": "import numpy\nfrom pack.middle import g\ndef f(): return g()",
    "apart": "def h():\n    import pack.top\n    return pack.top.f()",
}


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package whose modules import each other in all the ways there are."""
    for name, source in PACKAGE.items():
        path = tmp_path / "pack" / f"{name}.py"
        path.parent.mkdir(exist_ok=True, parents=True)
        path.write_text(source)
    return tmp_path / "pack"


def digest(sources: Sources, module: str) -> str:
    return sources.digest(sources.needed(module), "version")


@pytest.mark.parametrize(
    ("old", "new"),
    [("Module.", "Other."), ("What it is.", ""), ("    def", "    # why\n\n    def"), ('        """Method."""\n', "")],
)
def test_texts_and_positions_do_not_count(old: str, new: str) -> None:
    """Docstrings of every kind, comments and empty lines change no digest."""
    edited = SOURCE.replace(old, new)
    assert edited != SOURCE
    assert parse_module(edited.encode(), "pack.one") == parse_module(SOURCE.encode(), "pack.one")


@pytest.mark.parametrize(
    ("old", "new"), [("= 3", "= 3.0"), ("x + LIMIT", "LIMIT + x"), ("value: int = 1", "value: int = 2")]
)
def test_code_counts(old: str, new: str) -> None:
    """Any other edit changes the digest, be it of one letter."""
    edited = SOURCE.replace(old, new)
    assert parse_module(edited.encode(), "pack.one").digest != parse_module(SOURCE.encode(), "pack.one").digest


def test_what_a_module_needs(package: Path) -> None:
    """It needs what it imports, directly or not, by any form of import, wherever it stands; and nothing else."""
    sources = read_sources(package)
    assert sources.needed("pack.low") == ["pack.low"]
    assert sources.needed("pack.middle.part") == ["pack.low", "pack.middle.part"]
    assert sources.needed("pack.middle") == ["pack.low", "pack.middle", "pack.middle.part"]
    assert sources.needed("pack.top") == ["pack.low", "pack.middle", "pack.middle.part", "pack.top"]
    assert sources.needed("pack.apart") == [
        "pack.apart", "pack.low", "pack.middle", "pack.middle.part", "pack.top",
    ]  # fmt: skip


def test_edit_counts_for_those_who_need_it(package: Path) -> None:
    """An edit changes the digests of the modules that import its file, directly or not, and of no others."""
    before = read_sources(package)
    (package / "middle/part.py").write_text("from ..low import ONE\ndef g(): return -ONE")
    after = read_sources(package)
    changed = {name for name in before.modules if digest(before, name) != digest(after, name)}
    assert changed == {"pack", "pack.apart", "pack.middle", "pack.middle.part", "pack.top"}


def test_files_are_current_until_they_are_written(package: Path) -> None:
    """A file that was written, or is gone, is no longer what was read."""
    sources = read_sources(package)
    assert sources.is_current(["pack.low", "pack.top"])
    (package / "low.py").write_text("ONE = 1.0")
    assert not sources.is_current(["pack.low", "pack.top"])
    assert sources.is_current(["pack.top"])
    (package / "top.py").unlink()
    assert not sources.is_current(["pack.top"])


def test_memo_changes_nothing(package: Path, tmp_path: Path) -> None:
    """What is remembered is what would be found, also after an edit; a memo of nonsense is ignored."""
    memo = tmp_path / "folder" / "memo.json"
    read_sources(package, memo)
    assert read_sources(package, memo) == read_sources(package)
    (package / "low.py").write_text("ONE = 2")
    assert read_sources(package, memo) == read_sources(package)
    memo.write_text("[")
    assert read_sources(package, memo) == read_sources(package)


def test_file_that_is_no_python_disturbs_nobody(package: Path) -> None:
    """A file under construction has a digest of its bytes; those who do not import it can be loaded."""
    (package / "apart.py").write_text("def h(")
    assert read_sources(package).needed("pack.apart") == ["pack.apart"]
