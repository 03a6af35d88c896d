"""When a run counts as trained, and how an episode's performance is measured (spec: §4.1.1, §4.1.2).

**Train time** is the number of episodes until the mean length (or return) of the last ``window`` episodes meets a
threshold. It is kept as a running state, so that it costs the same at every episode. **Adaptation time** is the same,
counting only the episodes after a switch.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from decimal import Decimal
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass

from apel.numerics.compiled import njit
from apel.numerics.near_names import did_you_mean

LENGTH, RETURN = 0, 1
BELOW, AT_LEAST = 0, 1

_MAX_AFTER = 10_000_000
_CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False)


@dataclass(frozen=True, config=_CONFIG)
class Threshold:
    """``factor`` × (the number that the environment reports as ``info`` + ``plus``), such as 1.1 × ``optimal_length``.

    ``plus`` serves the reading that counts a path's cells, of which there is one more than moves.
    """

    factor: Annotated[float, Field(gt=0.0)]
    info: str
    plus: float = 0.0


@dataclass(frozen=True, config=_CONFIG)
class Criterion:
    """The mean of ``measure`` over the last ``window`` episodes is below, or at least, a threshold.

    Attributes
    ----------
    measure:
        What is averaged of each episode.
    window:
        Number of episodes in the mean.
    below, at_least:
        Exactly one of them, as a number or as a `Threshold`.
    after:
        Only episodes from this one on count (e_s, §4.3.2): until ``window`` of them were played nothing can be met.
        Where it differs from run to run, ``$name``: the value that is drawn for a run by that name.
    evaluation:
        ``training``: what is measured is the episode itself, exploration on. ``greedy``: after every episode whoever
        played it plays another one, without exploring and without anybody learning, and that one is measured.
    """

    measure: Literal["length", "return"]
    window: Annotated[int, Field(ge=1, le=10_000_000)]
    below: float | Threshold | None = None
    at_least: float | Threshold | None = None
    after: Annotated[int, Field(ge=0, le=_MAX_AFTER)] | Annotated[str, Field(pattern=r"^\$.+$")] = 0
    evaluation: Literal["training", "greedy"] = "training"

    @model_validator(mode="after")
    def _one_bound(self) -> Criterion:
        if (self.below is None) == (self.at_least is None):
            message = "found both or neither of 'below' and 'at_least', expected exactly one"
            raise ValueError(message)
        return self

    def of_run(self, variables: Mapping[str, Any]) -> Criterion:
        """The criterion of a run for which ``variables`` were drawn.

        Raises
        ------
        ValueError
            If there is no such variable, or if it is no number of episodes.

        >>> Criterion("return", 50, at_least=1.0, after="$switch").of_run({"switch": 1300}).after
        1300
        """
        if isinstance(self.after, int):
            return self
        name = self.after[1:]
        if name not in variables:
            known = f"{sorted(variables)}{did_you_mean(name, variables)}"
            message = f"after: found {self.after!r}, expected one of the variables {known}"
            raise ValueError(message)
        value = variables[name]
        if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= _MAX_AFTER:
            message = f"after: found {value!r}, drawn for {self.after!r}, expected a number of episodes"
            raise ValueError(message)
        return replace(self, after=value)

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
            known = f"{sorted(info)}{did_you_mean(bound.info, info)}"
            message = f"info: found {bound.info!r}, expected one of those that the environment reports: {known}"
            raise ValueError(message)
        return float(Decimal(str(bound.factor)) * (Decimal(str(info[bound.info])) + Decimal(str(bound.plus))))

    def parameters(self) -> NDArray[np.int64]:
        """``int64[5]``: measure, direction, window, first episode that counts, whether to evaluate greedily.

        Raises
        ------
        ValueError
            If the first episode that counts is one for each run.
        """
        if isinstance(self.after, str):
            message = f"after: found {self.after!r}, expected the number that was drawn for a run"
            raise ValueError(message)
        measure = LENGTH if self.measure == "length" else RETURN
        direction = BELOW if self.at_least is None else AT_LEAST
        greedy = int(self.evaluation == "greedy")
        return np.array([measure, direction, self.window, self.after, greedy], dtype=np.int64)


NO_CRITERION = np.array([LENGTH, BELOW, 1, 0, 0], dtype=np.int64)
"""Parameters where there is none; with a threshold of minus infinity nothing is ever below it."""


@njit(inline="always")
def evaluates_greedily(parameters: NDArray[np.int64]) -> bool:
    """Whether `Criterion.evaluation` is ``greedy``."""
    return parameters[4] == 1


@njit(inline="always")
def measure_of(parameters: NDArray[np.int64], length: int, episode_return: float) -> float:
    """What the criterion measures of an episode."""
    return float(length) if parameters[0] == LENGTH else episode_return


@njit
def criterion_met(
    parameters: NDArray[np.int64],
    threshold: float,
    recent: NDArray[np.float64],
    episode: int,
    measure: float,
) -> bool:
    """Take in one episode's measure and tell whether the criterion now holds.

    ``recent`` (``float64[window]``) holds the last measures, the e-th that counts at e mod window. The mean is summed
    afresh, so that no rounding error builds up over a long run.
    """
    window, counted = parameters[2], episode - parameters[3]
    if counted < 0:
        return False
    recent[counted % window] = measure
    if counted + 1 < window:
        return False
    total = 0.0
    for i in range(window):
        total += recent[i]
    mean = total / window
    return mean < threshold if parameters[1] == BELOW else mean >= threshold
