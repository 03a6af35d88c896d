"""What can go wrong, told apart by whose fault it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

_MOST_GROUPS, _TAIL_LINES = 10, 5


@dataclass(frozen=True)
class RunFailure:
    """A run that could not be finished because of what its learner, environment, selector or metric did."""

    arm: str
    sweep: str
    run_index: int
    seed: int
    learner: str
    episode: int
    error: str
    """In a line."""
    part: str = ""
    """What raised it: environment, learner, selector or performance; empty where that is not known."""
    place: str = ""
    """File, line and function of the user's; empty where none took part."""
    trace: str = ""
    """The whole traceback; empty where nothing was raised."""

    def where(self) -> str:
        """For people."""
        return f"seed {self.seed} (run {self.run_index}), learner {self.learner}, episode {self.episode}"


class ClusterError(Exception):
    """The cluster cannot do what is asked of it; not a fault of the experiment. The message says what to do."""


class LostClusterError(ClusterError):
    """The cluster is gone; nothing may be asked of it any more."""


class ShardLostError(ClusterError):
    """A shard's processes died more often than is allowed."""


def grouped(failures: Sequence[RunFailure]) -> list[str]:
    """One line per distinct error: how many runs, the first place, and the seeds of the others.

    Below it what raised it, in which of the user's lines, and the end of the traceback.
    """
    groups: dict[tuple[str, str, str], list[RunFailure]] = {}
    for failure in failures:
        groups.setdefault((failure.arm, failure.error, failure.place), []).append(failure)
    lines = []
    for (arm, error, _), members in list(groups.items())[:_MOST_GROUPS]:
        others = ", ".join(str(member.seed) for member in members[1:6])
        more = f"; also seeds {others}{', …' if len(members) > 6 else ''}" if others else ""
        lines.append(f"{arm}: {len(members)} run(s) failed: {error} at {members[0].where()}{more}")
        lines += _story(members[0])
    if len(groups) > _MOST_GROUPS:
        lines.append(f"… and {len(groups) - _MOST_GROUPS} more distinct errors")
    return lines


def _story(failure: RunFailure) -> list[str]:
    if not failure.place:
        return []
    what = f"in the {failure.part}: " if failure.part else "in "
    end = [line for line in failure.trace.splitlines() if not line.startswith("Traceback (")][-_TAIL_LINES:]
    return [f"    {line}" for line in (f"{what}{failure.place}", *end)]
