"""Where commands print: the edge at which everything that is shown becomes text for a terminal, once."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable
from typing import IO, Annotated, Any

import typer
from rich.console import Console, ConsoleOptions, HighlighterType, JustifyMethod, OverflowMethod, RenderableType
from rich.segment import Segment
from rich.style import Style
from rich.text import Text

from jobs.analysis.pages.escaping import printable


class TextConsole(Console):
    """A console that takes every string for plain text.

    Names come from experiment files, results and jobs of others: what looks like rich's markup (``[/red]``) is shown as
    it is, and a control character is spelled out instead of reaching the terminal.
    """

    def __init__(self, *, file: IO[str] | None = None, stderr: bool = False, width: int | None = None) -> None:
        super().__init__(
            file=file, stderr=stderr, width=width, soft_wrap=True, markup=False, emoji=False, highlight=False
        )

    def render_str(
        self,
        text: str,
        *,
        style: str | Style = "",
        justify: JustifyMethod | None = None,
        overflow: OverflowMethod | None = None,
        emoji: bool | None = None,
        markup: bool | None = None,
        highlight: bool | None = None,
        highlighter: HighlighterType | None = None,
    ) -> Text:
        """See `rich.console.Console`; before anything is measured, so that columns stay in line."""
        return super().render_str(
            printable(text), style=style, justify=justify, overflow=overflow, emoji=emoji, markup=markup,
            highlight=highlight, highlighter=highlighter,
        )  # fmt: skip

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """See `rich.console.Console`; what was no string, such as a bar's text, comes past here."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=printable(segment.text))


OUT = TextConsole(width=None if sys.stdout.isatty() else 10_000)
"""As wide as any table needs where the output goes to a file, a pipe or a job's log."""
ERR = TextConsole(stderr=True)


def print_note(line: str) -> None:
    """One line of what was not as it should be, and could be done without."""
    ERR.print(f"note: {line}", highlight=False, markup=False)


def print_error(line: str) -> None:
    """One line of what went wrong, as it is."""
    ERR.print(f"error: {line}", style="red")


AsJson = Annotated[bool, typer.Option("--json", help="Print JSON, for programs.")]
"""The option of every command that prints a table."""


def print_for_programs(content: Any) -> None:
    """Plain values as JSON, in ASCII whatever the encoding of where it goes; a number that is none is null."""
    typer.echo(json.dumps(_without_nan(content), indent=2, allow_nan=False))


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
