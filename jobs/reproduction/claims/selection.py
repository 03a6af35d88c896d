"""Which numbers of some results a claim asks for, and what may be wrong with that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from jobs.experiment.figures import SwitchRoles

WINDOW, PART = "window", "part"
"""The axes of a claim on several windows of episodes, and on several parts of the runs' environment steps."""


class MissingError(Exception):
    """The results that a claim needs are not there (yet)."""


class UnknownNameError(Exception):
    """A claim names what its experiment does not have."""


@dataclass(frozen=True)
class Given:
    """Only runs in which another arm met the criterion, or did not.

    Attributes
    ----------
    arm:
        Which other one; it has one row per run where the selection's ``where`` holds.
    censored:
        Whether it met the cap instead.
    """

    arm: str
    censored: bool


@dataclass(frozen=True)
class Selection:
    """Which rows, side by side: see `jobs.reproduction.claims.claim.Statistic` for the fields."""

    metric: str
    arms: Sequence[str]
    where: dict[str, Any]
    axis: str | None = None
    values: Sequence[Any] | None = None
    pool: Sequence[str] = ()
    learner: int | None = None
    windows: Sequence[tuple[int, int]] = ()
    parts: Sequence[tuple[float, float]] = ()
    switch: SwitchRoles | None = None
    given: Given | None = None

    @property
    def implied_axis(self) -> str | None:
        """That of several windows or parts."""
        return WINDOW if len(self.windows) > 1 else PART if len(self.parts) > 1 else None

    @property
    def is_of_runs(self) -> bool:
        """Whether the metric is a column of the run rows, and not made of recorded episodes."""
        return not (self.windows or self.parts or self.switch)
