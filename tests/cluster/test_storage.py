"""Files are seen whole or not at all."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest

from cluster.storage import Folder


def test_write_and_read(tmp_path: Path) -> None:
    """What is written is read, in folders that are made as needed; a path and its URI are the same place."""
    folder = Folder(str(tmp_path / "a"))
    folder.write("b/c.bin", b"content")
    assert Folder(f"file://{tmp_path}/a").read("b/c.bin") == b"content"
    assert folder.names() == ["b/c.bin"]
    assert folder.names("b") == ["c.bin"]
    assert folder.names("nowhere") == []


def test_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    """A write that fails half-way leaves what was there, and nothing else."""
    folder = Folder(str(tmp_path))
    folder.write("file", b"old")

    def fail(path: str) -> None:
        Path(path).write_bytes(b"half")
        message = "the disk is full"
        raise OSError(message)

    with pytest.raises(OSError, match="the disk is full"):
        folder.write_with("file", fail)
    assert folder.names() == ["file"]
    assert folder.read("file") == b"old"


def test_delete(tmp_path: Path) -> None:
    """Deleting what is not there is no error."""
    folder = Folder(str(tmp_path))
    folder.write("a/file", b"1")
    folder.delete("a/file")
    folder.delete("a/file")
    folder.delete_folder("a")
    folder.delete_folder("a")
    assert not folder.exists("a")


def test_travels(tmp_path: Path) -> None:
    """A folder can be sent to another process."""
    folder = pickle.loads(pickle.dumps(Folder(str(tmp_path))))
    folder.write("x", b"y")
    assert (tmp_path / "x").read_bytes() == b"y"
