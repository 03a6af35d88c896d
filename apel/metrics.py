"""When a run counts as trained, and how an episode's performance is measured (spec: §4.1.1, §4.1.2).

**Train time** is the number of episodes until the mean length (or return) of the last ``window`` episodes meets a
threshold. It is kept as a running state, so that it costs the same at every episode.
"""

from __future__ import annotations

from decimal import Decimal
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass

from apel.compiled import njit

LENGTH, RETURN = 0, 1
BELOW, AT_LEAST = 0, 1

_CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False)


@dataclass(frozen=True, config=_CONFIG)
class Threshold:
    """``factor`` × the number that the environment reports as ``info``, such as 1.1 × ``optimal_length``."""

    factor: Annotated[float, Field(gt=0.0)]
    info: str


@dataclass(frozen=True, config=_CONFIG)
class Criterion:
    """The mean of ``measure`` over the last ``window`` episodes is below, or at least, a threshold.

    Exactly one of ``below`` and ``at_least`` is given, as a number or as a `Threshold`.
    """

    measure: Literal["length", "return"]
    window: Annotated[int, Field(ge=1)]
    below: float | Threshold | None = None
    at_least: float | Threshold | None = None

    @model_validator(mode="after")
    def _one_bound(self) -> Criterion:
        if (self.below is None) == (self.at_least is None):
            message = "found both or neither of 'below' and 'at_least', expected exactly one"
            raise ValueError(message)
        return self

    def threshold(self, info: dict[str, float]) -> float:
        """The bound for an environment that reports ``info``.

        The product is rounded once, from decimals: in floating point 1.1 × 34 exceeds 37.4, and a mean of exactly 37.4
        would count as below it.

        Raises
        ------
        ValueError
            If the environment does not report the number.

        >>> Criterion("length", 50, below=Threshold(1.1, "optimal_length")).threshold({"optimal_length": 34})
        37.4
        """
        bound = self.at_least if self.below is None else self.below
        if not isinstance(bound, Threshold):
            assert bound is not None  # noqa: S101 - an invariant of _one_bound
            return bound
        if bound.info not in info:
            message = f"info: found {bound.info!r}, expected one of those that the environment reports: {sorted(info)}"
            raise ValueError(message)
        return float(Decimal(str(bound.factor)) * Decimal(str(info[bound.info])))

    def parameters(self) -> NDArray[np.int64]:
        """``int64[3]`` for `criterion_met`: measure, direction, window."""
        measure = LENGTH if self.measure == "length" else RETURN
        return np.array([measure, BELOW if self.at_least is None else AT_LEAST, self.window], dtype=np.int64)


@njit
def criterion_met(
    parameters: NDArray[np.int64],
    threshold: float,
    recent: NDArray[np.float64],
    episode: int,
    length: int,
    episode_return: float,
) -> bool:
    """Take in one episode and tell whether the criterion now holds.

    ``recent`` (``float64[window]``) holds the last measures, the one of episode e at e mod window. The mean is summed
    afresh, so that no rounding error builds up over a long run.
    """
    window = parameters[2]
    recent[episode % window] = float(length) if parameters[0] == LENGTH else episode_return
    if episode + 1 < window:
        return False
    total = 0.0
    for i in range(window):
        total += recent[i]
    mean = total / window
    return mean < threshold if parameters[1] == BELOW else mean >= threshold
