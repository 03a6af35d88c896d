"""What can go wrong, told apart by whose fault it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


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

    def where(self) -> str:
        """For people."""
        return f"seed {self.seed} (run {self.run_index}), learner {self.learner}, episode {self.episode}"


class ClusterError(Exception):
    """The cluster cannot do what is asked of it; not a fault of the experiment. The message says what to do."""


class ShardLostError(ClusterError):
    """A shard's processes died more often than is allowed."""


def grouped(failures: Sequence[RunFailure]) -> list[str]:
    """One line per distinct error: how many runs, the first place, and the seeds of the others."""
    groups: dict[tuple[str, str], list[RunFailure]] = {}
    for failure in failures:
        groups.setdefault((failure.arm, failure.error), []).append(failure)
    lines = []
    for (arm, error), members in groups.items():
        others = ", ".join(str(member.seed) for member in members[1:6])
        more = f"; also seeds {others}{', …' if len(members) > 6 else ''}" if others else ""
        lines.append(f"{arm}: {len(members)} run(s) failed: {error} at {members[0].where()}{more}")
    return lines
