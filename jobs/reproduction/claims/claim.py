"""What a claim is made of: a statistic of runs, and the side of a threshold on which it is claimed to lie."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from jobs.experiment.figures import SwitchRoles
from jobs.reproduction.claims import statistics as claim_statistics
from jobs.reproduction.claims.selection import Given, Selection
from jobs.reproduction.claims.theories import THEORIES

_NUM_ARMS = {"mean": 1, "deviation": 1, "share": 1, "difference": 2, "ratio": 2, "deviation_ratio": 2}
_OF_EPISODES = {"return", "length", "concentration", "probability", "performance_estimate"}
_PER_LEARNER = {"concentration", "probability", "performance_estimate"}
SWITCH_METRICS = {"switch_delay", "switch_delay_steps", "switch_delay_share"}
"""In episodes, in environment steps, and as a share of the run's episodes; see `jobs.analysis.switching.delay`."""


Share = Annotated[float, Field(ge=0.0, le=1.0)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class EpisodeRange(_Model):
    """Single episodes: first, first + every, … up to last."""

    first: Annotated[int, Field(ge=0)]
    last: int
    every: Annotated[int, Field(ge=1)] = 1


class Statistic(_Model):
    """A number that is computed of runs."""

    of: Literal[
        "mean", "deviation", "difference", "ratio", "deviation_ratio", "share", "theory_difference", "theory_ratio"
    ]
    """Of the first arm, of the first against the second, or of the first against theory; at each point of the axis."""
    metric: str
    arms: Annotated[list[str], Field(min_length=1)]
    over: str = "only"
    """What is said over the points; see `claim_statistics.SUMMARIES`."""
    axis: str | None = None
    values: Annotated[list[int | float | str], Field(min_length=1)] | None = None
    """Points of the axis, in this order; all where not given."""
    where: dict[str, int | float | str] = {}
    """Only rows with these values; rows without a value stay."""
    pool: list[str] = []
    """Columns over whose values each run is averaged."""
    location: Literal["mean", "median"] = "mean"
    below: float | None = None
    """Of a share: the metric is below this."""
    censored: bool = False
    """Of a share: the run is censored (or ``below`` holds)."""
    theory: str | None = None
    since: str | None = None
    """The field of the experiment that says where the axis counts as 0, for the theory; by its dotted path."""
    learner: Annotated[int, Field(ge=0)] | None = None
    episodes: list[tuple[int, int]] | EpisodeRange | None = None
    """Of what is recorded by episode: the mean over each window, first and last episode included."""
    parts: list[tuple[Share, Share]] = []
    """The same over parts of each run's environment steps: the mean over the episodes that end in them, ``[0.9, 1]``
    for the last tenth."""
    switch: SwitchRoles | None = None
    """Of a switch delay: which arm's learner is better early, and which late."""
    given: Given | None = None
    """Only the runs in which another arm met the criterion, or did not."""

    @property
    def windows(self) -> list[tuple[int, int]]:
        """First and last episode of each window."""
        if isinstance(self.episodes, EpisodeRange):
            return [(at, at) for at in range(self.episodes.first, self.episodes.last + 1, self.episodes.every)]
        return self.episodes or []

    @property
    def selection(self) -> Selection:
        """The rows it is computed of."""
        return Selection(
            self.metric, self.arms, self.where, self.axis, self.values, self.pool, self.learner, self.windows,
            self.parts, self.switch, self.given,
        )  # fmt: skip

    @model_validator(mode="after")
    def _is_complete(self) -> Statistic:
        against_theory = self.of in claim_statistics.AGAINST_THEORY
        windows = self.windows or self.parts
        has_axis = self.axis is not None or len(windows) > 1
        needed = _NUM_ARMS.get(self.of, 3 if (self.theory or "").startswith("performance") else 1)
        edges = [edge for window in windows for edge in window]
        inside = [(a, b) for (_, a), (b, _) in pairwise(windows)]
        is_between = any(a > b if self.parts else a >= b for a, b in inside)
        for is_wrong, message in (
            (len(self.arms) != needed, f"arms: found {len(self.arms)}, expected {needed} for {self.of}"),
            (self.over not in claim_statistics.SUMMARIES, _expected("over", self.over, claim_statistics.SUMMARIES)),
            (against_theory != (self.theory is not None), f"theory: expected for theory_… only, found of: {self.of}"),
            (
                self.theory not in (None, *THEORIES),
                _expected("theory", self.theory, THEORIES),
            ),
            ((self.of == "share") != (self.below is not None or self.censored), "below, censored: expected for share"),
            (
                bool(windows) != (self.metric in _OF_EPISODES),
                f"episodes: expected for {sorted(_OF_EPISODES)}, or parts",
            ),
            (bool(self.windows and self.parts), "parts: found beside episodes, expected one of them"),
            (
                (self.switch is not None) != (self.metric in SWITCH_METRICS),
                f"switch: expected for {sorted(SWITCH_METRICS)}",
            ),
            ((self.learner is not None) != (self.metric in _PER_LEARNER), "learner: expected for lists by learner"),
            (has_axis == (self.over == "only") and self.of != "share", "over: expected with an axis, and only then"),
            (
                self.over == "excess" and len(self.values or []) < 2,
                "values: expected for excess, the first of them against each of the others",
            ),
            (self.axis is not None and len(windows) > 1, "axis: found with several windows, expected one of them"),
            (
                edges != sorted(edges) or is_between,
                "episodes: expected windows in order that do not overlap",
            ),
        ):
            if is_wrong:
                raise ValueError(message)
        return self

    def __str__(self) -> str:
        metric = f"{self.metric}[{self.learner}]" if self.learner is not None else self.metric
        condition = [f"below {self.below:g}"] if self.below is not None else []
        condition += ["censored"] if self.censored else []
        axis = self.axis or ("part" if self.parts else "episode")
        parts_of_run = ", ".join(f"{low * 100:g} to {high * 100:g} %" for low, high in self.parts)
        places = f" at {', '.join(map(str, self.values))}" if self.values else ""
        parts = [
            f"{'median ' if self.location == 'median' else ''}{self.of} of {metric}: {', '.join(self.arms)}",
            " or ".join(condition),
            f"{self.theory}" if self.theory else "",
            f"{parts_of_run} of the steps" if self.parts else "",
            f"{self.switch.early} to {self.switch.late}" if self.switch else "",
            f"{self.over} over {axis}{places}" if self.over != "only" else "",
            ", ".join(f"{column} = {value}" for column, value in self.where.items()),
            f"where {self.given.arm} {'meets the cap' if self.given.censored else 'gets there'}" if self.given else "",
        ]
        return "; ".join(part for part in parts if part)


class Claim(_Model):
    """One claim, in our words."""

    id: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]*$")]
    source: str
    """Section and figure."""
    text: str
    expected: Literal["holds", "fails", "open"]
    """What was expected before the runs were made."""
    experiment: str
    """The name of the one beside which it stands."""
    statistic: Statistic
    direction: Literal["below", "above", "between", "every", "none"]
    threshold: float | tuple[float, float] | None = None

    @model_validator(mode="after")
    def _has_threshold(self) -> Claim:
        kinds: dict[str, type] = {"between": tuple, "every": type(None), "none": type(None)}
        kind = kinds.get(self.direction, float)
        if not isinstance(self.threshold, kind):
            expected = {"between": "two numbers", "every": "none", "none": "none"}.get(self.direction, "a number")
            message = f"threshold: found {self.threshold}, expected {expected} for {self.direction}"
            raise ValueError(message)
        if isinstance(self.threshold, tuple) and self.threshold[0] > self.threshold[1]:
            message = f"threshold: found {self.threshold}, expected the lower end first"
            raise ValueError(message)
        if self.direction in ("every", "none") and self.statistic.of != "share":
            message = f"direction: found {self.direction} for {self.statistic.of}, expected it for a share of runs"
            raise ValueError(message)
        return self

    @property
    def bounds(self) -> tuple[float, float]:
        """Between these the statistic is as claimed."""
        if isinstance(self.threshold, tuple):
            return self.threshold
        edge = self.threshold if self.threshold is not None else math.nan
        return {"below": (-math.inf, edge), "above": (edge, math.inf), "every": (1.0, 1.0)}.get(
            self.direction, (0.0, 0.0)
        )


def _expected(field: str, found: object, names: Iterable[str]) -> str:
    return f"{field}: found {found!r}, expected some of {', '.join(names)}"
