"""Files under one root, local or remote: any ``pyarrow.fs`` URI. Every write is seen whole or not at all."""

from __future__ import annotations

import os
import re
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar
from urllib.parse import quote, unquote

from pyarrow import fs

from cluster.retry import RetryPolicy
from cluster.storage_faults import StorageAwayError, StorageError, is_transient, storage_message

_RETRY = RetryPolicy(max_attempts=4)
# pyarrow's own default is to try for over a minute and a half where an endpoint accepts connections and says nothing,
# and then there would be the attempts of `Folder` on top.
_S3_LIMITS = {"connect_timeout": 3.0, "request_timeout": 10.0}
_S3_ATTEMPTS = 2

_TEMPORARY = re.compile(r"(?:.*/)?\.[^/]+\.[0-9a-f]{8}\.tmp")
_USER_INFO = re.compile(r"^([a-z][\w+.-]*://)([^/?#]*:[^/?#]*)@", re.IGNORECASE)
# A secret key with an unescaped slash makes no valid URI, and must not be shown for that. An authority with a colon is
# a host with its port only in hdfs://.
_BROKEN_USER_INFO = re.compile(r"^((?!hdfs:|viewfs:)[a-z][\w+.-]*://)([^/?#@]+:.*)@", re.IGNORECASE)
_SECRET_PARAMETER = re.compile(r"([?&][^=&]*(?:key|password|secret|signature|token)[^=&]*=)([^&]+)", re.IGNORECASE)
_LONG_PASSWORD = 6

_T = TypeVar("_T")


def redacted(uri: str) -> str:
    """A path or URI as people may see it, without credentials.

    >>> redacted("s3://KEY:SECRET@bucket/results?region=eu-west-1")
    's3://***@bucket/results?region=eu-west-1'
    """
    pattern = _USER_INFO if _USER_INFO.match(uri) else _BROKEN_USER_INFO
    return _SECRET_PARAMETER.sub(r"\1***", pattern.sub(r"\1***@", uri)) if "://" in uri else uri


def has_credentials(uri: str) -> bool:
    """Whether a path or URI holds a secret: user and password, or a query parameter that names one."""
    return redacted(uri) != uri


def joined(root: str, name: str) -> str:
    """The path or URI of ``name`` below ``root``; the query of a URI stays at its end.

    >>> joined("s3://bucket/results?region=eu-west-1", "arm=A/x y")
    's3://bucket/results/arm=A/x%20y?region=eu-west-1'
    """
    if "://" not in root:
        return f"{root.rstrip('/')}/{name}" if name else root
    base, mark, query = root.partition("?")
    return f"{base.rstrip('/')}/{quote(name, safe='/=:,@+')}{mark}{query}" if name else root


class Folder:
    """A folder at a path or URI (``results``, ``/data/results``, ``s3://bucket/results?region=eu-west-1``).

    Faults that may pass are tried again, a bounded number of times; `sleep` waits for so many seconds in between.

    Raises
    ------
    ValueError
        If there is no file system for such a URI.
    StorageError
        If one cannot be reached. Every other operation raises it likewise, but for `read` of a file that is not there.
    """

    def __init__(self, root: str, retry: RetryPolicy = _RETRY, sleep: Callable[[float], None] = time.sleep) -> None:
        self._root = _without_end_slash(root)
        self._retry = retry
        self._sleep = sleep
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

    def exists(self, name: str) -> bool:
        """Whether there is such a file or folder."""
        return self._type(name) != fs.FileType.NotFound

    def names(self, folder: str = "") -> list[str]:
        """Names of all files below ``folder``, relative to it; none if it does not exist.

        What is being written at the moment, or was when its process died, is no file yet.
        """
        return [name for name in self._all_names(folder) if not _TEMPORARY.fullmatch(name)]

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

    def delete_folder(self, name: str) -> None:
        """Delete a folder with all it holds, if it is there."""
        if self.exists(name):
            self._retried(name, "deleting", lambda: self._filesystem.delete_dir(self.path(name)))

    def _type(self, name: str) -> Any:
        return self._retried(name, "looking", lambda: self._filesystem.get_file_info(self.path(name)).type)

    def _all_names(self, folder: str) -> list[str]:
        base = self.path(folder)
        selector = fs.FileSelector(base, allow_not_found=True, recursive=True)
        infos = self._retried(folder, "listing", lambda: self._filesystem.get_file_info(selector))
        return sorted(info.path[len(base) :].lstrip("/") for info in infos if info.type == fs.FileType.File)

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

    def _put(self, path: str, content: bytes) -> None:
        with self._filesystem.open_output_stream(path) as stream:
            stream.write(content)

    def _delete_if_there(self, path: str) -> None:
        if self._filesystem.get_file_info(path).type == fs.FileType.File:
            self._filesystem.delete_file(path)

    def _retried(self, name: str, doing: str, operation: Callable[[], _T]) -> _T:
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
        return kind(_without_secrets(storage_message(self.location(name), doing, error), self._root))


def _from_uri(uri: str) -> tuple[Any, str]:
    try:
        filesystem, path = fs.FileSystem.from_uri(uri)
    except (ValueError, ImportError) as error:
        raise ValueError(_without_secrets(str(error), uri)) from None
    if filesystem.type_name == "s3":
        # A URI cannot say this, and the file system's own account of itself is what it is pickled by.
        options = filesystem.__reduce__()[1][0]
        retry = fs.AwsStandardS3RetryStrategy(max_attempts=_S3_ATTEMPTS)
        filesystem = fs.S3FileSystem(**{**options, **_S3_LIMITS, "retry_strategy": retry})
    return filesystem, path


def _without_end_slash(root: str) -> str:
    base, mark, query = root.partition("?") if "://" in root else (root, "", "")
    # The root of all files, / or file:///, is nothing but slashes at its end.
    stripped = base.rstrip("/")
    return f"{base if stripped.endswith(':') else stripped or '/'}{mark}{query}"


def _without_secrets(text: str, uri: str) -> str:
    """A message that may quote ``uri``, or a part of it, as people may see it."""
    text = text.replace(uri, redacted(uri))
    for pattern in (_USER_INFO, _BROKEN_USER_INFO):
        for match in pattern.finditer(uri):
            _, _, password = match.group(2).partition(":")
            # A password of a few letters may be a part of any word.
            long = [secret for secret in (password, unquote(password)) if len(secret) >= _LONG_PASSWORD]
            for secret in (match.group(2), *long):
                text = text.replace(secret, "***")
    return text
