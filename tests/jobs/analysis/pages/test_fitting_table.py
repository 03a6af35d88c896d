"""Tables on narrow terminals: whole columns go, in their order, and no number is cut."""

from __future__ import annotations

import io

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from rich.text import Text

from jobs.analysis.pages.fitting_table import FittingTable

TABLE = FittingTable(
    ["arm", "runs", "mean", "SD"],
    [["APEL", "100", "3,512", "1,234"], ["SSBAS", "100", Text("3,519", style="red"), "1,198"]],
    names=["arm"],
    first_to_go=["SD", "runs"],
    title="maze",
)


def shown(table: FittingTable, width: int) -> list[str]:
    """Lines without blanks at their ends."""
    text = io.StringIO()
    Console(file=text, width=width).print(table)
    return [line.rstrip() for line in text.getvalue().splitlines() if line.strip()]


@pytest.mark.parametrize(
    ("width", "first"),
    [(32, "arm runs mean SD"), (31, "arm runs mean"), (24, "arm runs mean"), (23, "arm mean"), (17, "arm mean")],
)
def test_columns_go_in_their_order(width: int, first: str) -> None:
    """By hand: 5 + 4 + 5 + 5 characters, 3 more for each column and 1 are 32; 24 without SD, 17 without runs."""
    title, headings, _, apel, ssbas, *rest = shown(TABLE, width)
    assert (title, headings.split()) == ("maze", first.split())
    assert apel.split()[:1] + ssbas.split()[:1] == ["APEL", "SSBAS"]
    left_out = [name for name in ("SD", "runs") if name not in headings]
    assert " ".join(rest) == (f"not shown at this width: {', '.join(left_out)}" if left_out else "")


@given(width=st.integers(30, 120), digits=st.lists(st.integers(1, 12), min_size=1, max_size=8))
def test_no_number_is_cut(width: int, digits: list[int]) -> None:
    """Whatever the width, a number that is shown is shown whole."""
    headings = ["arm", *(f"h{place}" for place in range(len(digits)))]
    row = ["a", *(str(9) * count for count in digits)]
    table = FittingTable(headings, [row], names=["arm"], first_to_go=headings[:1:-1])
    kept, left_out = table.columns(width)
    assert len(kept) + len(left_out) == len(headings)
    line = next(line for line in shown(table, width) if line.split()[0] == "a")
    assert line.split() == [row[place] for place in kept]
