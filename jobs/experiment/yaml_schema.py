"""Plain values and YAML scalars: what a text stands for in YAML 1.2's core schema, and values as a document.

The schema: https://yaml.org/spec/1.2.2/#103-core-schema. PyYAML reads YAML 1.1, where ``1e-3`` is a text, ``on`` is
true, ``012`` is ten and ``1:30`` is ninety.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Annotated, Any

import yaml
from pydantic import BeforeValidator

MAX_DEPTH = 50
"""Of lists and mappings in each other."""
_LEAST, _LARGEST = -(2**63), 2**63 - 1
_CONSTANTS: dict[str, Any] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((f"{sign}.{name}" for sign in ("", "+") for name in ("inf", "Inf", "INF")), math.inf),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), -math.inf),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), math.nan),
}
_INTEGER = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+", re.ASCII)
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?", re.ASCII)
_NOT_ZERO = re.compile(r"[-+]?[0.]*[1-9]")
_KINDS: dict[str, tuple[tuple[type, ...], str]] = {
    "null": ((type(None),), "null"),
    "bool": ((bool,), "true or false"),
    "int": ((int,), "a whole number"),
    "float": ((float, int), "a number"),
}
_INVISIBLE = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
_UNSTORABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]")


def visible(text: str) -> str:
    r"""The text with control characters, and what turns the direction of writing, as escapes; line ends stay.

    >>> visible("red: \x1b[31m")
    'red: \\x1b[31m'
    """
    return _INVISIBLE.sub(lambda found: found[0] if found[0] == "\n" else ascii(found[0])[1:-1], text)


def shown(value: Any, length: int = 80) -> str:
    """A value for a message: its ``repr``, cut where it is long."""
    text = visible(repr(value))
    return text if len(text) <= length else f"{text[: length - 1]}…"


def is_name(text: str) -> bool:
    """Whether a text may be shown as it is."""
    return not _INVISIBLE.search(text)


def plain_scalar(text: str) -> Any:
    """What a plain scalar stands for.

    Raises
    ------
    ValueError
        If it is a number that cannot be kept.

    >>> [plain_scalar(text) for text in ("1e-3", "012", "0o12", "on", "~", "-.inf", "1_000", "2001-02-30")]
    [0.001, 12, 10, 'on', None, -inf, '1_000', '2001-02-30']
    """
    if text in _CONSTANTS:
        return _CONSTANTS[text]
    if _INTEGER.fullmatch(text):
        return _integer(text)
    return _number(text) if _FLOAT.fullmatch(text) else text


def _integer(text: str) -> int:
    base = {"0o": 8, "0x": 16}.get(text[:2], 10)
    # Python refuses to read thousands of digits.
    value = int(text, base) if len(text) < 1000 else 2**64
    if not _LEAST <= value <= _LARGEST:
        message = f"found {_cut(text)}, expected a whole number of at most 64 bits"
        raise ValueError(message)
    return value


def _number(text: str) -> float:
    value = float(text)
    if math.isinf(value) or (value == 0.0 and _NOT_ZERO.match(text)):
        message = f"found {_cut(text)}, expected a number between 1e-323 and 1.7e+308 in size (or .inf)"
        raise ValueError(message)
    return value


def tagged_scalar(tag: str, text: str) -> Any:
    """What a scalar stands for that says of which kind it is, such as ``!!float 3``.

    Raises
    ------
    ValueError
        If there is no such kind, or the text is none of it.
    """
    kind = tag.removeprefix("tag:yaml.org,2002:")
    if kind in ("str", "!"):
        return text
    if kind == tag or kind not in _KINDS:
        message = f"found the tag {shown(f'!!{kind}' if kind != tag else tag)}, expected none, or one of " + ", ".join(
            f"!!{name}" for name in (*_KINDS, "str", "seq", "map")
        )
        raise ValueError(message)
    types, expected = _KINDS[kind]
    value = plain_scalar(text)
    if type(value) not in types:
        message = f"found {shown(text)} with the tag !!{kind}, expected {expected}"
        raise ValueError(message)
    return float(value) if kind == "float" else value


def plain_value(value: Any, depth: int = 0) -> Any:
    """A copy that is made of null, booleans, 64-bit integers, numbers, texts, lists, and mappings from texts.

    Raises
    ------
    ValueError
        If there is anything else in it, which could not be written to a file and read again.

    >>> plain_value({"a": (1, 2.5)})
    {'a': [1, 2.5]}
    """
    if depth > MAX_DEPTH:
        message = f"found more than {MAX_DEPTH} levels, expected fewer lists and mappings in each other"
        raise ValueError(message)
    match value:
        case None | bool():
            return value
        case int() if _LEAST <= value <= _LARGEST:
            return int(value)
        case float() if not math.isnan(value):
            return float(value)
        case str() if not _UNSTORABLE.search(value):
            return str(value)
        case list() | tuple():
            return [_inside(str(i), child, depth) for i, child in enumerate(value)]
        case dict():
            return {_key(name): _inside(name, child, depth) for name, child in value.items()}
    raise ValueError(_refusal(value))


def _inside(name: str, child: Any, depth: int) -> Any:
    try:
        return plain_value(child, depth + 1)
    except ValueError as error:
        message = f"{name}: {error}" if depth < 5 else str(error)
        raise ValueError(message) from None


def _key(name: Any) -> str:
    if not isinstance(name, str) or not is_name(name):
        message = f"found the key {shown(name)}, expected text without control characters"
        raise ValueError(message)
    return str(name)


def _refusal(value: Any) -> str:
    if isinstance(value, int):
        return f"found {_cut(hex(value))}, expected a whole number of at most 64 bits"
    if isinstance(value, float):
        return f"found {value!r}, expected a number"
    if isinstance(value, str):
        return f"found {shown(value)}, expected text without control characters"
    return f"found {shown(value)} ({type(value).__name__}), expected what a YAML file can hold"


def _cut(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:20]}… ({len(text)} characters)"


Plain = Annotated[Any, BeforeValidator(plain_value)]
"""A field that takes what `plain_value` takes, and keeps a copy."""


class _Dumper(yaml.SafeDumper):
    """Quotes each text that YAML 1.1 or 1.2 would take for something else, and knows no aliases."""

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002 - PyYAML's signature
        return True


_dump_resolver: Callable[..., None] = _Dumper.add_implicit_resolver
_dump_resolver("tag:yaml.org,2002:int", re.compile(f"^(?:{_INTEGER.pattern})$"), list("-+0123456789"))
_dump_resolver("tag:yaml.org,2002:float", re.compile(f"^(?:{_FLOAT.pattern})$"), list("-+.0123456789"))


def to_yaml(content: Any) -> str:
    """Plain values as a document that reads the same by YAML 1.1 and by YAML 1.2."""
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True)
