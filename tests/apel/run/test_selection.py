from __future__ import annotations

import math

import pytest
from pydantic import ValidationError

from apel.building.registry import SELECTORS
from apel.run.selection import starts_epoch
from apel.selectors import SwUcb


def test_epochs_double() -> None:
    """Epoch β has 2^β episodes (Algorithm 6), so they begin at 2^β − 1."""
    assert [episode for episode in range(1100) if starts_epoch(episode)] == [2**epoch - 1 for epoch in range(11)]


@pytest.mark.parametrize("name", sorted(SELECTORS))
def test_unknown_options_are_refused(name: str) -> None:
    """A slip in an option's name is no option."""
    with pytest.raises((ValidationError, TypeError), match="dekay"):
        SELECTORS[name](dekay=0.1)


def test_options_are_numbers() -> None:
    """An option that has no upper bound is finite nevertheless."""
    assert SwUcb(window=10, exploration=1e300).exploration == 1e300
    for value in (math.inf, math.nan):
        with pytest.raises(ValidationError, match="finite"):
            SwUcb(window=10, exploration=value)
