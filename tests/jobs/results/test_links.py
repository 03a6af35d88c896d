"""Links in results are not followed, whatever is done with them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from jobs.remote.packing import write_archive
from jobs.reproduction.claims.stored_results import found_stores
from jobs.results.storage import Folder
from jobs.results.storage_faults import LinkError
from jobs.results.store import StoreError
from tests.command_line import call

OPERATIONS: list[Callable[[Folder, str], object]] = [
    lambda folder, name: folder.read(name),
    lambda folder, name: folder.exists(name),
    lambda folder, name: folder.write(name, b"mine"),
    lambda folder, name: folder.delete(name),
]


@pytest.fixture
def places(tmp_path: Path) -> tuple[Path, Path]:
    """Results with three links in them, to a file, to a folder and to nothing; and the folder that they lead to."""
    outside, results = tmp_path / "outside", tmp_path / "results"
    outside.mkdir()
    (outside / "secret").write_text("secret")
    (results / "parts").mkdir(parents=True)
    (results / "parts" / "own").write_text("own")
    (results / "file").symlink_to(outside / "secret")
    (results / "figures").symlink_to(outside)
    (results / "nothing").symlink_to(outside / "new")
    return results, outside


@pytest.mark.parametrize("name", ["file", "figures", "figures/secret", "figures/deep/new", "nothing"])
@pytest.mark.parametrize("operation", OPERATIONS)
def test_links_are_refused(operation: Callable[[Folder, str], object], name: str, places: tuple[Path, Path]) -> None:
    """Nothing is read, written or deleted over a link, and the message names it."""
    results, outside = places
    with pytest.raises(LinkError, match=rf"results/{name.split('/')[0]}: found a symbolic link"):
        operation(Folder(str(results)), name)
    assert [path.name for path in outside.iterdir()] == ["secret"]
    assert (outside / "secret").read_text() == "secret"


def test_links_are_no_files(places: tuple[Path, Path], tmp_path: Path) -> None:
    """What is listed, and what is packed to be fetched, are files of the results alone."""
    results, _ = places
    assert Folder(str(results)).names() == ["parts/own"]
    (results / "round").symlink_to(results)
    write_archive(Folder(str(results)), tmp_path / "archive.tar")
    assert b"secret" not in (tmp_path / "archive.tar").read_bytes()


def test_root_may_be_a_link(places: tuple[Path, Path], tmp_path: Path) -> None:
    """Whoever names a folder may name a link to it."""
    (tmp_path / "link").symlink_to(places[0])
    assert Folder(str(tmp_path / "link")).read("parts/own") == b"own"


def test_claims_look_behind_no_link(places: tuple[Path, Path]) -> None:
    """Nor are results looked for behind one."""
    results, outside = places
    (outside / "runs.parquet").write_bytes(b"")
    (results / "runs.parquet").symlink_to(outside / "runs.parquet")
    with pytest.raises(StoreError, match="found no results"):
        found_stores([str(results)])


def test_command_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is bad input, told in one line."""
    (tmp_path / "runs.parquet").symlink_to("/etc/hostname")
    code, error = call(capsys, "show", str(tmp_path))
    assert (code, error.count("\n")) == (2, 1)
    assert "runs.parquet: found a symbolic link" in error
