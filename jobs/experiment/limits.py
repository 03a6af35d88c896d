"""How large an experiment may be. Beyond these sizes planning alone would take minutes or the memory of a machine.

The largest experiment that comes along has 69 arms × sweep points, 100 runs of each and 5 · 10⁶ episodes at most.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from apel.numerics.whole_numbers import whole
from jobs.experiment.axes import may_touch

MAX_RUNS = 100_000
MAX_EPISODES = 10_000_000
"""Of a run: selectors with windows, and the criterion, remember as many."""
MAX_STEPS = 10**15
MAX_LEARNERS = 1_000
"""Of an arm, and of an experiment."""
MAX_SWEEP_POINTS = 1_000
MAX_ARM_POINTS = 10_000
MAX_PLANNED_RUNS = 1_000_000
MAX_SWEPT_VALUES = 500_000
"""Values of the file × sweep points: each point is an experiment of its own."""


_Whole = BeforeValidator(whole)
Runs = Annotated[int, Field(ge=1, le=MAX_RUNS, strict=True), _Whole]
Episodes = Annotated[int, Field(ge=1, le=MAX_EPISODES, strict=True), _Whole]
Steps = Annotated[int, Field(ge=1, le=MAX_STEPS, strict=True), _Whole]
Copies = Annotated[int, Field(ge=1, le=MAX_LEARNERS, strict=True), _Whole]
Seed = Annotated[int, Field(ge=0, lt=2**63, strict=True), _Whole]


def check_sizes(arms: Iterable[str], runs: int, sweep: Mapping[str, Any], size: int) -> None:
    """Refuse a grid that is too large, before anything is made of it; ``size`` is how many values the file has.

    Raises
    ------
    ValueError
        The message opens with the field to be changed.
    """
    lengths = {axis: len(v) if isinstance(v, list) else len(next(iter(v.values()))) for axis, v in sweep.items()}
    points = [math.prod(n for axis, n in lengths.items() if may_touch(axis, sweep[axis], arm)) for arm in arms]
    for field, what, count, most in (
        ("sweep", "sweep points of one arm", max(points), MAX_SWEEP_POINTS),
        ("sweep", "arms × sweep points", sum(points), MAX_ARM_POINTS),
        ("sweep", "values of the file × sweep points", sum(points) * size if sweep else 0, MAX_SWEPT_VALUES),
        ("runs", "runs over all arms and sweep points", sum(points) * runs, MAX_PLANNED_RUNS),
    ):
        if count > most:
            message = f"{field}: found {_readable(count)} {what}, expected at most {most:,}: cut it into several files"
            raise ValueError(message)


def _readable(count: int) -> str:
    return f"{count:,}" if count < 10**12 else f"10^{len(str(count)) - 1} or more"


def num_values(value: Any) -> int:
    """How many values there are in a tree of lists and mappings."""
    if isinstance(value, dict):
        return 1 + sum(map(num_values, value.values()))
    return 1 + sum(map(num_values, value)) if isinstance(value, list) else 1
