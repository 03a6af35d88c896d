"""What the site's reader of docstrings (griffe) is told besides: lines of a doctest are a block of code."""

from __future__ import annotations

import re
from typing import Any

import griffe

_DOCTEST = re.compile(r"^>>> .*\n?(?:(?:>>>|\.\.\.).*\n?|(?!\n|>>>).+\n?)*", re.MULTILINE)


def fenced(text: str) -> str:
    """A docstring, its doctests between fences."""
    return _DOCTEST.sub(lambda found: f"```pycon\n{found[0].rstrip()}\n```\n", text)


class DoctestFences(griffe.Extension):
    """Puts them between fences."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Before the docstring is parsed."""
        if obj.docstring and ">>>" in obj.docstring.value:
            obj.docstring.value = fenced(obj.docstring.value)
