"""What a fault of a storage is: whether it may pass, and what to tell people. Decisions, without any effect."""

from __future__ import annotations

import errno
import os
import re

_PASSING_ERRNOS = frozenset(
    {
        errno.EAGAIN, errno.EBUSY, errno.ECONNABORTED, errno.ECONNREFUSED, errno.ECONNRESET, errno.EHOSTDOWN,
        errno.EHOSTUNREACH, errno.EINTR, errno.ENETDOWN, errno.ENETRESET, errno.ENETUNREACH, errno.EPIPE,
        errno.ETIMEDOUT,
        # What NFS and FUSE mounts of object stores answer when their server does not. A disk that is dying answers the
        # same, and then a few more attempts cost seconds.
        errno.EIO,
        # An NFS server that has restarted: opening the file anew helps.
        errno.ESTALE,
    }
)  # fmt: skip
_PASSING_AWS_ERRORS = frozenset(
    {
        "INTERNAL_FAILURE", "NETWORK_CONNECTION", "REQUEST_TIMEOUT", "SERVICE_UNAVAILABLE", "SLOW_DOWN", "THROTTLING",
    }
)  # fmt: skip
_PASSING_HTTP_STATUS = frozenset({"429", "500", "502", "503", "504"})
_LASTING_CURL_CODES = frozenset({"60", "77"})
"""Certificates that are not trusted, or not there; pyarrow counts them as faults of the network."""
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
_FORBIDDEN = frozenset({errno.EACCES, errno.EPERM, errno.EROFS})
_FORBIDDEN_AWS_ERRORS = frozenset(
    {"ACCESS_DENIED", "INVALID_ACCESS_KEY_ID", "INVALID_CLIENT_TOKEN_ID", "SIGNATURE_DOES_NOT_MATCH"}
)


class StoreError(Exception):
    """Results that cannot be read or written. The message says where and why."""


class StorageError(OSError):
    """A storage that does not do what is asked of it. The message says where, what was found, and what to do.

    It has the message for its only argument, so that it survives pickling unchanged.
    """


class LinkError(StorageError):
    """A symbolic link where results have files and folders of their own: it may lead anywhere, and is not followed."""


class StorageAwayError(StorageError):
    """A storage that did not answer, however often it was asked: it may well do so later."""


def is_transient(error: OSError) -> bool:
    """Whether the same call may well succeed a little later.

    pyarrow reports what an object store answers as an `OSError` without a number, whose message names the error.

    >>> is_transient(OSError("AWS Error SLOW_DOWN during PutObject operation"))
    True
    >>> is_transient(OSError(errno.ENOSPC, "No space left on device"))
    False
    """
    if error.errno is not None:
        return error.errno in _PASSING_ERRNOS
    text = str(error)
    if _found(r"curlCode: (\d+)", text) in _LASTING_CURL_CODES:
        return False
    return _aws_error(text) in _PASSING_AWS_ERRORS or _found(r"HTTP status (\d+)", text) in _PASSING_HTTP_STATUS


def storage_message(place: str, doing: str, error: OSError) -> str:
    """For people: where, what was found while ``doing`` what, and what to do. ``place`` must be `redacted`."""
    found = os.strerror(error.errno) if error.errno is not None else re.sub(r" \(Request ID: \w*\)", "", str(error))
    advice = _advice(error)
    if doing == "writing":
        advice += "; finished work is stored, and the same command resumes from there"
    return f"{place}: found '{found}' while {doing}: {advice}"


def _advice(error: OSError) -> str:
    aws = _aws_error(str(error))
    if error.errno in _FULL:
        return "free space, or choose another --results"
    if error.errno in _FORBIDDEN or aws in _FORBIDDEN_AWS_ERRORS:
        return "see that this user has the right to, or choose another --results"
    if aws == "NO_SUCH_BUCKET":
        return "make the bucket, or choose another --results"
    if is_transient(error):
        return "see that the storage can be reached from here"
    return "see that the place can be used, or choose another --results"


def _aws_error(text: str) -> str:
    return _found(r"AWS Error (\w+)", text)


def _found(pattern: str, text: str) -> str:
    match = re.search(pattern, text)
    return match.group(1) if match else ""
