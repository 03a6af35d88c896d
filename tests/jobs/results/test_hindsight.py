"""The oracle: of each run, the best of several arms."""

from __future__ import annotations

from typing import Any

import pyarrow as pa
from hypothesis import given, settings
from hypothesis import strategies as st

from jobs.results.hindsight import with_hindsight

Row = tuple[str, str, int, int | None, bool | None, float | None]
"""Arm, sweep, run index, train time, censored, steady state."""
COLUMNS = ("arm", "sweep", "run_index", "train_time", "censored", "steady_state")
TYPES = (pa.string(), pa.string(), pa.int64(), pa.int64(), pa.bool_(), pa.float64())


def table_of(rows: list[Row]) -> pa.Table:
    columns = zip(*rows, strict=True) if rows else [()] * 6
    return pa.table({n: pa.array(list(c), t) for n, c, t in zip(COLUMNS, columns, TYPES, strict=True)})


def chosen(rows: list[Row], *sources: str) -> list[tuple[Any, ...]]:
    """Sweep, run and chosen arm of the oracle's rows, in their order."""
    found = with_hindsight(table_of(rows), {"Best": sources}).to_pylist()
    assert [tuple(row[name] for name in COLUMNS) for row in found[: len(rows)]] == rows
    assert all(row["chosen"] is None for row in found[: len(rows)])
    assert all(row["arm"] == "Best" for row in found[len(rows) :])
    return [(row["sweep"], row["run_index"], row["chosen"]) for row in found[len(rows) :]]


def test_shortest_train_time_wins() -> None:
    """Whatever the steady state."""
    rows: list[Row] = [("A", "", 0, 70, False, 9.0), ("B", "", 0, 60, False, -9.0), ("C", "", 0, 1, False, 99.0)]
    assert chosen(rows, "A", "B") == [("", 0, "B")]


def test_censored_runs_come_last() -> None:
    """One that met its criterion in its very last episode beats one that never did, though both have played as many."""
    rows: list[Row] = [("A", "", 0, 100, True, 9.0), ("B", "", 0, 100, False, -9.0)]
    assert chosen(rows, "A", "B") == [("", 0, "B")]


def test_ties_go_to_the_higher_steady_state_then_to_the_first_arm() -> None:
    """Two censored runs are told apart by what they came to; equal ones by the order in which the arms are listed."""
    rows: list[Row] = [
        ("A", "", 0, 100, True, -2.0),
        ("A", "", 1, 100, True, -2.0),
        ("A", "", 2, 40, False, None),
        ("B", "", 0, 100, True, -1.0),
        ("B", "", 1, 100, True, -2.0),
        ("B", "", 2, 40, False, None),
    ]
    assert chosen(rows, "A", "B") == [("", 0, "B"), ("", 1, "A"), ("", 2, "A")]
    assert chosen(rows, "B", "A") == [("", 0, "B"), ("", 1, "B"), ("", 2, "B")]


def test_without_a_criterion_the_steady_state_decides() -> None:
    """No train times at all."""
    rows: list[Row] = [("A", "", 0, None, None, -2.0), ("B", "", 0, None, None, -1.0)]
    assert chosen(rows, "A", "B") == [("", 0, "B")]


def test_without_either_the_end_of_the_run_decides() -> None:
    """The return of its last tenth, which is not looked at where something else is known."""
    rows: list[Row] = [("A", "", 0, None, None, None), ("B", "", 0, None, None, None)]
    late = pa.array([1.0, 100.0])
    found = with_hindsight(table_of(rows).append_column("last_tenth_return", late), {"Best": ["A", "B"]})
    assert found.to_pylist()[-1]["chosen"] == "B"
    tied: list[Row] = [("A", "", 0, 5, False, None), ("B", "", 0, 5, False, None)]
    found = with_hindsight(table_of(tied).append_column("last_tenth_return", late), {"Best": ["A", "B"]})
    assert found.to_pylist()[-1]["chosen"] == "A"


def test_incomplete_runs_are_left_out() -> None:
    """A run that one of the arms has not finished has no best arm yet."""
    rows: list[Row] = [("A", "", 0, 5, False, None), ("A", "", 1, 5, False, None), ("B", "", 1, 4, False, None)]
    assert chosen(rows, "A", "B") == [("", 1, "B")]
    assert chosen(rows[:1], "A", "B") == []
    assert chosen(rows, "B", "C") == []
    assert chosen([], "A", "B") == []


def test_rows_stand_in_the_order_of_sweep_points_and_runs() -> None:
    """As those of every other arm, whoever was chosen."""
    rows: list[Row] = [
        ("A", "n=9", 0, 5, False, None),
        ("A", "n=9", 1, 5, False, None),
        ("A", "n=10", 0, 5, False, None),
        ("B", "n=9", 0, 4, False, None),
        ("B", "n=9", 1, 6, False, None),
        ("B", "n=10", 0, 6, False, None),
    ]
    assert chosen(rows, "A", "B") == [("n=9", 0, "B"), ("n=9", 1, "A"), ("n=10", 0, "A")]


def test_without_hindsight_the_table_is_untouched() -> None:
    """No column is added where no oracle is asked for."""
    table = table_of([("A", "", 0, 5, False, None)])
    assert with_hindsight(table, {}) is table


@settings(max_examples=40)
@given(
    st.dictionaries(
        st.tuples(st.sampled_from("ABC"), st.integers(0, 3)),
        st.tuples(st.integers(1, 4), st.booleans(), st.none() | st.integers(-2, 2).map(float)),
        max_size=12,
    )
)
def test_oracle_is_the_minimum(times: dict[tuple[str, int], tuple[int, bool, float | None]]) -> None:
    """For every run that A and B have finished, the first minimum of (censored, train time, minus steady state)."""
    rows: list[Row] = [(arm, "", run, *values) for (arm, run), values in sorted(times.items())]
    expected = []
    for run in range(4):
        if ("A", run) in times and ("B", run) in times:
            keys = {arm: times[arm, run] for arm in "BA"}
            best = min(keys, key=lambda arm: (keys[arm][1], keys[arm][0], -(keys[arm][2] or 0.0)))
            expected.append(("", run, best))
    assert chosen(rows, "B", "A") == expected
