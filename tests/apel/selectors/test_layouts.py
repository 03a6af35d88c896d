"""How the rows of the shipped selectors are cut, and that compiled and plain code see the same."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
import pytest

from apel.building.registry import SELECTORS
from apel.numerics.compiled import KernelFunction
from apel.numerics.streams import stream_of_seed
from apel.run.selection import COMMON
from apel.selectors.windows import WINDOW
from tests.apel.selectors.test_contract import every, make


@pytest.mark.parametrize("name", [name for name in SELECTORS if name not in {"epsilon_greedy", "fixed", "uniform"}])
@pytest.mark.parametrize("num_learners", [1, 2, 5])
def test_layout_covers_the_row(name: str, num_learners: int) -> None:
    """The blocks of a state are the whole row, each number once, and open with the common ones."""
    selector: Any = SELECTORS[name]()
    row = selector.initial_state(num_learners, 40)
    numbers = np.arange(float(row.size))
    blocks = selector.layout.view(numbers, num_learners)
    assert np.concatenate(blocks).tolist() == numbers.tolist()
    assert blocks._fields[:3] == COMMON.names
    if "window" in blocks._fields:
        inside = WINDOW.view(blocks.window, num_learners)
        assert np.concatenate(inside).tolist() == blocks.window.tolist()


def plain(function: KernelFunction) -> Any:
    """The function as it was written, to be run by Python."""
    return function._function


@every
@pytest.mark.parametrize("num_learners", [1, 3])
def test_compiled_is_plain(case: tuple[str, dict[str, object]], num_learners: int) -> None:
    """Run by Python, both functions make the same draws and leave the same bits as their compiled forms."""
    selector: Any = make(case)
    states = [selector.initial_state(num_learners, 300) for _ in range(2)]
    streams = [stream_of_seed(3) for _ in range(2)]
    select, observe, parameters = plain(selector.select), plain(selector.observe), selector.parameters()
    draw = random.Random(5)
    with np.errstate(all="ignore"):
        for _ in range(300):
            selected = selector.select(parameters, num_learners, states[0], streams[0])
            assert select(parameters, num_learners, states[1], streams[1]) == selected
            performance = draw.gauss(selected, 1.0)
            selector.observe(parameters, num_learners, states[0], selected, performance)
            observe(parameters, num_learners, states[1], selected, performance)
            assert states[0].tobytes() == states[1].tobytes()
    assert streams[0].tolist() == streams[1].tolist()
