"""The scale of performances: rules made for rewards in [0, 1] meet returns of any size.

A selector keeps two numbers, low and high. They are either fixed, and performances are clipped to them, or they are the
least and the largest performance seen so far. The latter needs no knowledge, but makes the bandit's rewards
non-stationary: one extreme episode shrinks all others from then on. Rules that keep sums of performances keep them raw
and normalise their means when they are read, by the range of that moment; rules that cannot (EXP3, CORRAL, Thompson
sampling) have each episode as it was normalised when it ended.
"""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import AfterValidator

from apel.numerics.compiled import njit
from apel.numerics.views import Row, named_numbers

NONE, MINMAX, FIXED = 0.0, 1.0, 2.0
"""How a rule's two compiled functions know the mode."""

Normalise = Literal["none", "minmax", "fixed_bounds"]
"""Raw performances, the range of all that were seen, or given bounds."""


def _increasing(bounds: tuple[float, float]) -> tuple[float, float]:
    if not bounds[0] < bounds[1]:
        message = f"found {bounds}, expected (low, high) with low < high"
        raise ValueError(message)
    return bounds


Bounds = Annotated[tuple[float, float], AfterValidator(_increasing)]
"""(low, high) of the performances."""


def check_bounds(normalise: str, bounds: tuple[float, float] | None) -> None:
    """Refuse bounds that would not be used, and a mode whose bounds are missing.

    Raises
    ------
    ValueError
        If ``bounds`` and ``normalise`` contradict each other.
    """
    if (normalise == "fixed_bounds") != (bounds is not None):
        message = f"bounds: found {bounds} with normalise: {normalise}, expected them with fixed_bounds and only there"
        raise ValueError(message)


def mode_of(normalise: str) -> float:
    """The number that stands for a mode among the parameters."""
    return {"none": NONE, "fixed_bounds": FIXED}.get(normalise, MINMAX)


def range_of(normalise: str, bounds: tuple[float, float] | None) -> Row:
    """Low and high before the first episode, ``float64[2]``; (∞, −∞), which nothing lies in, before any is seen."""
    if bounds is not None:
        return np.array(bounds)
    return np.array([0.0, 1.0] if normalise == "none" else [np.inf, -np.inf])


def unit_mode(bounds: tuple[float, float] | None) -> float:
    """`mode_of` for rules that always need [0, 1]: the bounds, or else the range seen so far."""
    return MINMAX if bounds is None else FIXED


def unit_range(bounds: tuple[float, float] | None) -> Row:
    """`range_of` for rules that always need [0, 1]."""
    return range_of("minmax", bounds)


class UnitOptions(NamedTuple):
    """The parameters of rules that need no more than a mode."""

    mode: float


unit_options = named_numbers(UnitOptions)


@njit
def take_in(mode: float, limits: Row, performance: float) -> float:
    """Clip to fixed limits, or widen running ones (``float64[2]``, in place); the performance to be kept."""
    if mode == FIXED:
        return min(max(performance, limits[0]), limits[1])
    if mode == MINMAX:
        limits[0] = min(limits[0], performance)
        limits[1] = max(limits[1], performance)
    return performance


@njit
def to_unit(mode: float, limits: Row, performance: float) -> float:
    """`take_in`, then map [low, high] to [0, 1]; 1/2 as long as low and high are one."""
    kept = take_in(mode, limits, performance)
    if not limits[1] > limits[0]:
        return 0.5
    # Halved first, so that the difference of two numbers of any size is finite.
    value = (0.5 * kept - 0.5 * limits[0]) / (0.5 * limits[1] - 0.5 * limits[0])
    return min(max(value, 0.0), 1.0)
