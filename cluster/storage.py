"""Files under one root, local or remote: any ``pyarrow.fs`` URI. Every write is seen whole or not at all."""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable
from typing import Any

from pyarrow import fs


class Folder:
    """A folder at a path or URI (``results``, ``/data/results``, ``s3://bucket/results``)."""

    def __init__(self, root: str) -> None:
        self.root = root.rstrip("/") or "/"
        if "://" in root:
            self._filesystem, self._path = fs.FileSystem.from_uri(self.root)
        else:
            self._filesystem, self._path = fs.LocalFileSystem(), os.path.abspath(self.root)  # noqa: PTH100 - no I/O

    def __reduce__(self) -> tuple[type[Folder], tuple[str]]:
        return Folder, (self.root,)

    @property
    def filesystem(self) -> Any:
        """The pyarrow file system."""
        return self._filesystem

    def path(self, name: str = "") -> str:
        """Path within `filesystem`."""
        return f"{self._path}/{name}" if name else self._path

    def location(self, name: str = "") -> str:
        """For people: path or URI."""
        return f"{self.root}/{name}" if name else self.root

    def sub(self, name: str) -> Folder:
        """A folder within."""
        return Folder(f"{self.root}/{name}")

    def exists(self, name: str) -> bool:
        """Whether there is such a file or folder."""
        return bool(self._filesystem.get_file_info(self.path(name)).type != fs.FileType.NotFound)

    def names(self, folder: str = "") -> list[str]:
        """Names of all files below ``folder``, relative to it; none if it does not exist."""
        base = self.path(folder)
        infos = self._filesystem.get_file_info(fs.FileSelector(base, allow_not_found=True, recursive=True))
        return sorted(info.path[len(base) + 1 :] for info in infos if info.type == fs.FileType.File)

    def read(self, name: str) -> bytes:
        """The bytes of a file."""
        with self._filesystem.open_input_stream(self.path(name)) as stream:
            content: bytes = stream.read()
        return content

    def write(self, name: str, content: bytes) -> None:
        """Write a file under a temporary name, then move it into place."""
        self.write_with(name, lambda temporary: self._write(temporary, content))

    def write_with(self, name: str, write: Callable[[str], None]) -> None:
        """Let ``write(path)`` write a file under a temporary path, then move it into place."""
        target = self.path(name)
        parent, _, base = target.rpartition("/")
        self._filesystem.create_dir(parent, recursive=True)
        temporary = f"{parent}/.{base}.{uuid.uuid4().hex[:8]}.tmp"
        try:
            write(temporary)
            self._filesystem.move(temporary, target)
        except BaseException:
            self._delete_if_there(temporary)
            raise

    def delete(self, name: str) -> None:
        """Delete a file if it is there."""
        self._delete_if_there(self.path(name))

    def delete_folder(self, name: str) -> None:
        """Delete a folder with all it holds, if it is there."""
        if self.exists(name):
            self._filesystem.delete_dir(self.path(name))

    def _write(self, path: str, content: bytes) -> None:
        with self._filesystem.open_output_stream(path) as stream:
            stream.write(content)

    def _delete_if_there(self, path: str) -> None:
        if self._filesystem.get_file_info(path).type == fs.FileType.File:
            self._filesystem.delete_file(path)
