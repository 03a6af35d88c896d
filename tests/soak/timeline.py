"""From the events of a job's drivers to the time that each fault cost: decisions, without any effect."""

from __future__ import annotations

import json
import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass
class Timeline:
    """When each shard came further than ever before, over all drivers of a job; times on one clock.

    Attributes
    ----------
    weights:
        By arm: how much work an episode is; 1 where it is not said.
    marks:
        By shard: the times, in order, each with the episodes that were reached.
    """

    weights: dict[str, float] = field(default_factory=dict)
    marks: dict[str, list[tuple[float, int]]] = field(default_factory=dict)
    first: float | None = None
    """Of the first event."""
    num_restarts: int = 0

    def add(self, event: dict[str, Any]) -> None:
        """Take in an event; they come in the order of their times."""
        self.first = event["time"] if self.first is None else self.first
        self.num_restarts += event["what"] == "ShardRestarted"
        if "episodes" not in event:
            return
        marks = self.marks.setdefault(event["shard"], [])
        # To have stored the rows is to have come further than to have played the last episode.
        reached = event["episodes"] + (event["what"] == "ShardDone")
        if not marks or reached > marks[-1][1]:
            marks.append((event["time"], reached))

    def last(self) -> float:
        """When it came further for the last time."""
        return max(marks[-1][0] for marks in self.marks.values())

    def work(self, until: float = math.inf) -> float:
        """How many episodes had been played, each counted once, and one more for each shard that was stored.

        >>> timeline = Timeline({"solo": 0.5}, {"A · runs 0-1": [(1.0, 3), (2.0, 7)], "solo · runs 0-1": [(1.5, 4)]})
        >>> timeline.work(1.2), timeline.work(1.7), timeline.work()
        (3.0, 5.0, 9.0)
        """
        total = 0.0
        for shard, marks in self.marks.items():
            place = bisect_right(marks, until, key=lambda mark: mark[0])
            total += marks[place - 1][1] * self.weights.get(shard.split(" · ")[0], 1.0) if place else 0.0
        return total

    def stall(self, began: float, ended: float) -> float | None:
        """The longest time that a shard under way came no further, of those times that touch ``began`` to ``ended``.

        For a fault of a moment that is the time from the last progress before it to the first that is new after it.
        None if no shard was under way.

        >>> timeline = Timeline(marks={"a": [(1.0, 1), (2.0, 2), (7.0, 3), (8.0, 4)], "b": [(2.5, 1), (3.0, 2)]})
        >>> timeline.stall(2.2, 2.2), timeline.stall(2.6, 2.7), timeline.stall(7.5, 9.0), timeline.stall(9.0, 9.0)
        (5.0, 5.0, 1.0, None)
        """
        return max((gap for marks in self.marks.values() for gap in _gaps(marks, began, ended)), default=None)


def _gaps(marks: list[tuple[float, int]], began: float, ended: float) -> Iterator[float]:
    first = max(bisect_left(marks, began, key=lambda mark: mark[0]), 1)
    for place in range(first, len(marks)):
        if marks[place - 1][0] > ended:
            return
        yield marks[place][0] - marks[place - 1][0]


class Tail:
    """Reads what has been added to files of events since the last look; a last line that is not whole waits."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._place = 0

    def events(self) -> list[dict[str, Any]]:
        """The new ones."""
        if not self._path.exists():
            return []
        with self._path.open("rb") as file:
            file.seek(self._place)
            content = file.read()
        whole = content[: content.rfind(b"\n") + 1]
        self._place += len(whole)
        return [json.loads(line) for line in whole.splitlines()]
