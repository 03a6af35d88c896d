"""Names and messages that others have chosen, written so that whoever shows them takes them for text."""

from __future__ import annotations

import re

_UNPRINTABLE = re.compile(
    "["
    "\x00-\x08\x0b-\x1f\x7f-\x9f"  # commands to a terminal; a tab and a new line are none
    "\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069"  # which show a text in another order
    "\u2028\u2029"  # line ends that only some programs know
    "\ud800-\udfff"  # halves of characters, which no file can hold
    "]"
)
_COLOUR = re.compile(r"(\x1b\[[0-9;]*m)")
_OPENS_TAG = re.compile(r"<(?=[A-Za-z/!?])")
_LINK = re.compile(r"\](?=[(\[:])")


def printable(text: str) -> str:
    r"""The text with every control character spelled out, as JSON would.

    >>> printable("\x1b]0;title\x07 and so on")
    '\\u001b]0;title\\u0007 and so on'
    """
    return _UNPRINTABLE.sub(lambda match: f"\\u{ord(match[0]):04x}", text)


def printable_log(text: str) -> str:
    r"""The same of what a program has printed: it may use colours, and may return to the beginning of a line.

    >>> printable_log("\x1b[31mred\x1b[0m\r\n\x1b[2J")
    '\x1b[31mred\x1b[0m\n\\u001b[2J'
    """
    pieces = _COLOUR.split(text.replace("\r\n", "\n").replace("\r", "\n"))
    return "".join(piece if position % 2 else printable(piece) for position, piece in enumerate(pieces))


def markdown_cell(text: str) -> str:
    r"""A cell of a Markdown table: one line, without tags and links.

    >>> markdown_cell("a|b <script> [x](y) < 3")
    'a\\|b &lt;script> [x\\](y) < 3'
    """
    text = printable(text.replace("\n", " ")).replace("|", "\\|")
    return _LINK.sub(r"\\]", _OPENS_TAG.sub("&lt;", text))
