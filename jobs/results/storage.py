"""Files under one root, local or remote: any ``pyarrow.fs`` URI. Every write is seen whole or not at all."""

from __future__ import annotations

import os
import re
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

from pyarrow import fs

from cluster.errors import ClusterError
from cluster.reachability import within
from cluster.retry import RetryPolicy
from jobs.results.links import all_below, first_link
from jobs.results.places import check_place, joined, redacted, without_end_slash, without_secrets
from jobs.results.storage_faults import LinkError, StorageAwayError, StorageError, is_transient, storage_message

_RETRY = RetryPolicy(max_attempts=4)
# pyarrow's own default is to try for over a minute and a half where an endpoint accepts connections and says nothing,
# and then there would be the attempts of `Folder` on top.
_S3_LIMITS = {"connect_timeout": 3.0, "request_timeout": 10.0}
_S3_ATTEMPTS = 2
_FIRST_ANSWER_SECONDS = 14.0

_TEMPORARY = re.compile(r"(?:.*/)?\.[^/]+\.[0-9a-f]{8}\.tmp")
_T = TypeVar("_T")


def reached(root: str) -> Folder:
    """The folder at a path or URI; of a store that does not answer it is said soon, though work on it is patient.

    Raises
    ------
    StorageAwayError
        If it does not answer within a quarter of a minute. See `Folder` for the others.
    """
    found: list[Folder] = []

    def look() -> None:
        found.append(Folder(root))
        if "://" in root:
            found[0].exists("")

    try:
        within(_FIRST_ANSWER_SECONDS, look, f"{redacted(root)}: found a store that does not answer")
    except ClusterError as error:
        message = f"{error}: see that it can be reached from here"
        raise StorageAwayError(message) from None
    return found[0]


class Folder:
    """A folder at a path or URI (``results``, ``/data/results``, ``s3://bucket/results?region=eu-west-1``).

    Faults that may pass are tried again, a bounded number of times; `sleep` waits for so many seconds in between.

    Raises
    ------
    ValueError
        If there is no file system for such a URI.
    LinkError
        Not here, but in every other operation, if it concerns what is, or lies behind, a symbolic link below the root.
    StorageError
        If one cannot be reached. Every other operation raises it likewise, but for `read` of a file that is not there.
    """

    def __init__(self, root: str, retry: RetryPolicy = _RETRY, sleep: Callable[[float], None] = time.sleep) -> None:
        self._root = without_end_slash(root)
        self._retry = retry
        self._sleep = sleep
        check_place(root)
        if "://" in root:
            self._filesystem, self._path = self._retried("", "opening", lambda: _from_uri(self._root))
        else:
            self._filesystem, self._path = fs.LocalFileSystem(), os.path.abspath(self._root)  # noqa: PTH100 - no I/O

    def __reduce__(self) -> tuple[type[Folder], tuple[Any, ...]]:
        # A relative path would be another place in a process that works in another folder.
        root = self._root if "://" in self._root else self._path
        return Folder, (root, self._retry, self._sleep)

    def __repr__(self) -> str:
        return f"Folder({self.location()!r})"

    @property
    def filesystem(self) -> Any:
        """The pyarrow file system."""
        return self._filesystem

    def path(self, name: str = "") -> str:
        """Path within `filesystem`."""
        return f"{self._path.rstrip('/')}/{name}" if name else self._path

    def location(self, name: str = "") -> str:
        """For people: path or URI, without credentials."""
        return redacted(joined(self._root, name))

    def sub(self, name: str) -> Folder:
        """A folder within."""
        return Folder(joined(self._root, name), self._retry, self._sleep)

    def is_link(self, name: str) -> bool:
        """Whether a name is a symbolic link, or leads over one."""
        return bool(first_link(self._filesystem, self._path, name))

    def exists(self, name: str) -> bool:
        """Whether there is such a file or folder."""
        return self._type(name) != fs.FileType.NotFound

    def written(self, name: str = "") -> float | None:
        """When a file was written, in seconds since 1970 (0 where that is not known); None where it is no file."""
        info = self._retried(name, "looking", lambda: self._filesystem.get_file_info(self.path(name)))
        if info.type != fs.FileType.File:
            return None
        return info.mtime.timestamp() if info.mtime else 0.0

    def names(self, folder: str = "") -> list[str]:
        """Names of all files below ``folder``, relative to it; none if it does not exist. Links are none.

        What is being written at the moment, or was when its process died, is no file yet.
        """
        return [name for name in self._all_names(folder) if not _TEMPORARY.fullmatch(name)]

    def folder_names(self) -> list[str]:
        """Names of all folders below this one, relative to it."""
        return self._names_of("", fs.FileType.Directory)

    def top_folder_names(self) -> list[str]:
        """Names of the folders in this one, without what is in them."""
        selector = fs.FileSelector(self.path(), allow_not_found=True)
        infos = self._retried("", "listing", lambda: self._filesystem.get_file_info(selector))
        names = [info.base_name for info in infos if info.type == fs.FileType.Directory]
        return sorted(name for name in names if not self.is_link(name))

    def temporary_names(self) -> list[str]:
        """What `names` leaves out."""
        return [name for name in self._all_names("") if _TEMPORARY.fullmatch(name)]

    def read(self, name: str) -> bytes:
        """The bytes of a file.

        Raises
        ------
        FileNotFoundError
            If it is not there.
        """
        content: bytes = self.read_with(name, lambda file: file.read())
        return content

    def read_with(self, name: str, read: Callable[[Any], _T]) -> _T:
        """What ``read(file)`` makes of a file that is open for reading at any place; see `read`."""

        def attempt() -> _T:
            with self._filesystem.open_input_file(self.path(name)) as file:
                return read(file)

        return self._retried(name, "reading", attempt)

    def write(self, name: str, content: bytes) -> None:
        """Write a file under a temporary name, then move it into place."""
        self.write_with(name, lambda temporary: self._put(temporary, content))

    def write_with(self, name: str, write: Callable[[str], None]) -> None:
        """Let ``write(path)`` write a file under a temporary path, then move it into place.

        It is called again after a fault that may pass.
        """
        self._retried(name, "writing", lambda: self._write_once(self.path(name), write))

    def delete(self, name: str) -> None:
        """Delete a file if it is there."""
        self._retried(name, "deleting", lambda: self._delete_if_there(self.path(name)))

    def move(self, name: str, target: str) -> None:
        """Move a file to another name, where it takes the place of whatever is there."""
        self._retried(name, "moving", lambda: self._move_once(self.path(name), self.path(target)))

    def delete_folder(self, name: str) -> None:
        """Delete a folder with all it holds, if it is there."""
        if self.exists(name):
            self._retried(name, "deleting", lambda: self._filesystem.delete_dir(self.path(name)))

    def _type(self, name: str) -> Any:
        return self._retried(name, "looking", lambda: self._filesystem.get_file_info(self.path(name)).type)

    def _all_names(self, folder: str) -> list[str]:
        return self._names_of(folder, fs.FileType.File)

    def _names_of(self, folder: str, kind: Any) -> list[str]:
        base = self.path(folder)
        infos = self._retried(folder, "listing", lambda: all_below(self._filesystem, base))
        return sorted(info.path[len(base) :].lstrip("/") for info in infos if info.type == kind)

    def _write_once(self, target: str, write: Callable[[str], None]) -> None:
        parent, _, base = target.rpartition("/")
        # S3 has no folders: a marker for each would cost requests, and pyarrow would look after the bucket each time.
        if self._filesystem.type_name != "s3":
            self._filesystem.create_dir(parent, recursive=True)
        temporary = f"{parent}/.{base}.{uuid.uuid4().hex[:8]}.tmp"
        try:
            write(temporary)
            # An object store completes an upload whose stream an exception has closed: only the move says it is whole.
            self._filesystem.move(temporary, target)
        except BaseException:
            with suppress(OSError):  # the first error is the one to tell, and `names` leaves this file out
                self._delete_if_there(temporary)
            raise

    def _move_once(self, path: str, target: str) -> None:
        if self._filesystem.type_name != "s3":
            self._filesystem.create_dir(target.rpartition("/")[0], recursive=True)
        self._filesystem.move(path, target)

    def _put(self, path: str, content: bytes) -> None:
        with self._filesystem.open_output_stream(path) as stream:
            stream.write(content)

    def _delete_if_there(self, path: str) -> None:
        if self._filesystem.get_file_info(path).type == fs.FileType.File:
            self._filesystem.delete_file(path)

    def _retried(self, name: str, doing: str, operation: Callable[[], _T]) -> _T:
        if name and (link := first_link(self._filesystem, self._path, name)):
            message = f"{self.location(link)}: found a symbolic link, expected none in results: links are not followed"
            raise LinkError(message)
        num_faults = 0
        while True:
            try:
                return operation()
            except StorageError:
                raise  # of another file, read while this one is written: it was tried again there
            except FileNotFoundError as error:
                if doing == "reading":
                    raise
                raise self._error(name, doing, error) from None
            except OSError as error:
                num_faults += 1
                delay = self._retry.delay_seconds(num_faults) if is_transient(error) else None
                if delay is None:
                    raise self._error(name, doing, error) from None  # pyarrow's own message may quote the URI
                self._sleep(delay)

    def _error(self, name: str, doing: str, error: OSError) -> StorageError:
        kind = StorageAwayError if is_transient(error) else StorageError
        return kind(without_secrets(storage_message(self.location(name), doing, error), self._root))


def _from_uri(uri: str) -> tuple[Any, str]:
    try:
        filesystem, path = fs.FileSystem.from_uri(uri)
    except (ValueError, ImportError) as error:
        raise ValueError(without_secrets(str(error), uri)) from None
    if filesystem.type_name == "s3":
        # A URI cannot say this, and the file system's own account of itself is what it is pickled by.
        options = filesystem.__reduce__()[1][0]
        retry = fs.AwsStandardS3RetryStrategy(max_attempts=_S3_ATTEMPTS)
        filesystem = fs.S3FileSystem(**{**options, **_S3_LIMITS, "retry_strategy": retry})
    return filesystem, path
