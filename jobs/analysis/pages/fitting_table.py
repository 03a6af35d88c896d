"""A table for terminals of any width: what does not fit is left out by whole columns, and said to be."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Table
from rich.text import Text


class FittingTable:
    """Rows of text of which no number is ever cut: half of one would be another one.

    Parameters
    ----------
    headings:
        Of the columns, the first of which are names.
    rows:
        A text for each column.
    names:
        Headings of the columns that are aligned to the left.
    first_to_go:
        Headings of the columns that may be left out, in that order, where the terminal is too narrow.
    title:
        Above it.
    padding:
        Spaces between columns.
    """

    def __init__(
        self,
        headings: Sequence[str],
        rows: Sequence[Sequence[str | Text]],
        *,
        names: Sequence[str],
        first_to_go: Sequence[str] = (),
        title: str | None = None,
        padding: int = 2,
    ) -> None:
        self.headings, self.rows, self.names = list(headings), [list(row) for row in rows], set(names)
        self.first_to_go, self.title, self.padding = first_to_go, title, padding

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """The columns that fit, and which do not."""
        kept, left_out = self.columns(options.max_width)
        table = Table(title=self.title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, self.padding, 0, 0))
        for place in kept:
            heading = self.headings[place]
            table.add_column(heading, justify="left" if heading in self.names else "right", no_wrap=True)
        for row in self.rows:
            table.add_row(*(row[place] for place in kept))
        yield table
        if left_out:
            yield Text(f"not shown at this width: {', '.join(left_out)}", style="dim")

    def columns(self, width: int) -> tuple[list[int], list[str]]:
        """Places of the columns that fit, and the headings of those that do not."""
        # A character stands before each column, and one after the last.
        needed = [1 + self.padding + max(map(_length, column)) for column in self._by_column()]
        kept, left_out = list(range(len(self.headings))), list[str]()
        for heading in self.first_to_go:
            if sum(needed[place] for place in kept) + 1 <= width:
                break
            if heading in self.headings:
                kept.remove(self.headings.index(heading))
                left_out.append(heading)
        return kept, left_out

    def _by_column(self) -> list[list[str | Text]]:
        return [[heading, *(row[place] for row in self.rows)] for place, heading in enumerate(self.headings)]


def _length(text: str | Text) -> int:
    return text.cell_len if isinstance(text, Text) else cell_len(text)
