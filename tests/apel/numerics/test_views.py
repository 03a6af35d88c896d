from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from apel.numerics.compiled import njit
from apel.numerics.views import REST, Layout, Row, named_numbers


class Blocks(NamedTuple):
    weight: Row
    limits: Row
    count: Row
    memory: Row


class Options(NamedTuple):
    rate: float
    scale: float


LAYOUT = Layout(Blocks, limits=2, memory=REST)
view, options = LAYOUT.view, named_numbers(Options)


def _write(row: Row, num_learners: int, numbers: Row) -> tuple[int, int, int, int]:
    blocks, given = view(row, num_learners), options(numbers)
    blocks.weight[:] = 1.0
    blocks.limits[1] = given.scale
    blocks.count[-1] += given.rate
    blocks.memory[:] = 4.0
    return blocks.weight.size, blocks.limits.size, blocks.count.size, blocks.memory.size


@pytest.mark.parametrize("write", [_write, njit(_write)], ids=["plain", "compiled"])
@pytest.mark.parametrize("num_learners", [1, 3])
def test_blocks_are_the_row_in_order(write: Any, num_learners: int) -> None:
    """Blocks follow one another as declared, do not overlap, and what is written into them stands in the row."""
    row = np.zeros(2 * num_learners + 2 + 3)
    assert write(row, num_learners, np.array([0.5, 9.0])) == (num_learners, 2, num_learners, 3)
    count = [0.0] * (num_learners - 1) + [0.5]
    assert row.tolist() == [1.0] * num_learners + [0.0, 9.0] + count + [4.0] * 3


def test_view_of_many_rows() -> None:
    """In plain code the blocks of a table are those of all its rows."""
    table = np.arange(20.0).reshape(2, 10)
    assert view(table, 3).count.tolist() == [[5.0, 6.0, 7.0], [15.0, 16.0, 17.0]]
    assert view(table, 3).memory.tolist() == [[8.0, 9.0], [18.0, 19.0]]


def test_new_row() -> None:
    """A block is given one value for all of it, or its values; without any it is 0."""
    row = LAYOUT.row(2, weight=0.5, limits=[-1.0, 1.0], memory=np.array([7.0, 8.0]))
    assert row.tolist() == [0.5, 0.5, -1.0, 1.0, 0.0, 0.0, 7.0, 8.0]
    assert LAYOUT.size(2) == 6
    assert LAYOUT.row(2).shape == (6,)


def test_names_that_there_are_not() -> None:
    """A size or a value for a block that was not declared is a mistake."""
    with pytest.raises(ValueError, match=r"found sizes of \['limit'\]"):
        Layout(Blocks, limit=2)
    with pytest.raises(TypeError, match=r"found values of \['wait'\]"):
        LAYOUT.row(2, wait=1.0)
