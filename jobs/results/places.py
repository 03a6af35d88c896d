"""Where results lie, as a path or URI: joining, checking, and what people may see of it."""

from __future__ import annotations

import re
from urllib.parse import quote, unquote

_USER_INFO = re.compile(r"^([a-z][\w+.-]*://)([^/?#]*:[^/?#]*)@", re.IGNORECASE)
# A secret key with an unescaped slash makes no valid URI, and must not be shown for that. An authority with a colon is
# a host with its port only in hdfs://.
_BROKEN_USER_INFO = re.compile(r"^((?!hdfs:|viewfs:)[a-z][\w+.-]*://)([^/?#@]+:.*)@", re.IGNORECASE)
_SECRET_PARAMETER = re.compile(r"([?&][^=&]*(?:key|password|secret|signature|token)[^=&]*=)([^&]+)", re.IGNORECASE)
_LONG_PASSWORD = 6


def redacted(uri: str) -> str:
    """A path or URI as people may see it, without credentials.

    >>> redacted("s3://KEY:SECRET@bucket/results?region=eu-west-1")
    's3://***@bucket/results?region=eu-west-1'
    """
    pattern = _USER_INFO if _USER_INFO.match(uri) else _BROKEN_USER_INFO
    return _SECRET_PARAMETER.sub(r"\1***", pattern.sub(r"\1***@", uri)) if "://" in uri else uri


def check_place(root: str) -> None:
    """Refuse what is no place for results: nothing at all, or a URI that names none.

    Raises
    ------
    ValueError
        The message says what was found.

    >>> check_place("s3://bucket/results?region=eu-west-1")
    >>> check_place("s3:///results")
    Traceback (most recent call last):
    ...
    ValueError: found 's3:///results', which names no bucket, expected a folder, or a URI such as s3://bucket/results
    """
    if not root.strip() or "\0" in root:
        fault = ""
    elif re.match(r"[A-Za-z][\w+.-]*:/(?!/)", root):
        fault = ", with one slash after the colon"
    elif re.match(r"(?!file:)[A-Za-z][\w+.-]*:///*(?:[?#].*)?$", root) or re.match(
        r"(?:s3|gs|gcs)://(?:[^/?#]*@)?[/?#]", root
    ):
        fault = ", which names no bucket"
    else:
        return
    message = f"found {redacted(root)!r}{fault}, expected a folder, or a URI such as s3://bucket/results"
    raise ValueError(message)


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


def without_end_slash(root: str) -> str:
    """A path or URI without the slashes at its end."""
    base, mark, query = root.partition("?") if "://" in root else (root, "", "")
    # The root of all files, / or file:///, is nothing but slashes at its end.
    stripped = base.rstrip("/")
    return f"{base if stripped.endswith(':') else stripped or '/'}{mark}{query}"


def without_secrets(text: str, uri: str) -> str:
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
