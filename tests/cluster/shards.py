"""A shard that is played in this process: what keeps its rows, and hosts that are lost."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from apel.agents.content import AgentContent
from apel.learners.base import Played
from apel.run.state import EpisodeRows
from cluster.coordinator import Coordinator
from cluster.events import ShardDone, ShardProgress
from cluster.local import LocalHosts
from cluster.protocols import RunRows
from cluster.shard import Execution, Shard
from jobs.experiment.plan import Plan
from jobs.experiment.spec_files import load_experiment


class Memory:
    """A sink and a checkpoint store that keep everything."""

    def __init__(self) -> None:
        self.rows: list[EpisodeRows] = []
        self.runs: RunRows | None = None
        self.content: bytes | None = None
        self.num_checkpoints = 0

    def spill(self, shard: Shard, part: int, rows: Sequence[EpisodeRows]) -> str:
        self.rows += rows
        return str(part)

    def commit(self, shard: Shard, runs: RunRows, parts: Sequence[str], rows: Sequence[EpisodeRows]) -> None:
        self.runs = runs
        self.rows += rows

    def keep(self, shard: Shard, position: int, mark: str, model: AgentContent) -> None:
        return

    def read(self, shard: Shard) -> bytes | None:
        return self.content

    def write(self, shard: Shard, content: bytes) -> None:
        self.content = content
        self.num_checkpoints += 1

    def delete(self, shard: Shard) -> None:
        self.content = None

    def sorted_rows(self) -> list[tuple[Any, ...]]:
        """All rows by run and episode."""
        rows = [row for part in self.rows for row in zip(*(column.tolist() for column in part), strict=True)]
        return sorted(repr(row) for row in rows)  # type: ignore[arg-type]


class FailingHosts(LocalHosts):
    """Hosts that are lost after some rounds."""

    def __init__(self, rounds: int) -> None:
        super().__init__()
        self.rounds, self.played = rounds, 0

    def play(self, orders: Sequence[Sequence[int]]) -> list[Played]:
        if self.played == self.rounds:
            message = "the hosts are gone"
            raise ConnectionError(message)
        self.played += 1
        return super().play(orders)


def shard_of(small: Path, *overrides: str, arm: str = "APEL") -> Shard:
    """All runs of an arm."""
    return Plan.of(load_experiment(str(small), overrides)).only([arm]).shards(num_cpus=1, shard_size=100)[0]


def play(
    shard: Shard, memory: Memory, execution: Execution | None = None, hosts: LocalHosts | None = None
) -> ShardDone:
    """Play a shard to its end."""
    coordinator = Coordinator(hosts or LocalHosts(), memory, memory, execution or Execution())
    *progress, done = coordinator.run(shard)
    assert all(isinstance(event, ShardProgress) for event in progress)
    assert isinstance(done, ShardDone)
    return done


def with_user_code(fault: str, learner: str = "tests.user_code:Walker") -> tuple[str, ...]:
    """Overrides that put a user's environment and learner in place."""
    return (
        f"environment={{id: 'tests.user_code:Corridor', options: {{fault: '{fault}', episode: 40}}}}",
        f"learners={{Q: {{type: q_learning}}, W: {{type: '{learner}'}}}}",
        "arms={APEL: {learners: [Q, W], selector: {type: apel}}}",
        "variables={}",
        "stop_when_met=false",
    )
