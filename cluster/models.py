"""What the runs of a shard have come to: their learners, gathered from the hosts, as agents."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from apel.agents.content import AgentContent, TrainedLearner
from apel.agents.making import trained_agent
from apel.environments import World
from apel.learners.base import State
from apel.run.state import FAILED, FINISHED, RUNNING, Book
from cluster.shard import Shard

FINAL = "final"


def mark_of(steps: int) -> str:
    """The mark of a model on the way, whose name tells where it comes: models sort by it."""
    return f"{steps:012d}"


class ModelClock:
    """Which runs have come to a model that is to be kept; pure bookkeeping over the book of a shard.

    Every host ends its streak of a run with the episode in which the run's steps reach a multiple of ``every``
    (`Book.pause_every`), so that a round never goes beyond one.
    """

    def __init__(self, book: Book) -> None:
        self._every = book.pause_every
        self._kept = self._multiples(book)

    def due(self, book: Book) -> list[tuple[int, str]]:
        """Positions of the runs that have come to one since the last call, and its mark.

        A run that is over has its last model at the end of the shard.
        """
        if not self._every:
            return []
        now = self._multiples(book)
        reached = np.flatnonzero((now > self._kept) & (book.status == RUNNING))
        self._kept = now
        return [(run, mark_of(int(now[run]) * self._every)) for run in reached.tolist()]

    def _multiples(self, book: Book) -> NDArray[np.int64]:
        return book.steps // self._every if self._every else np.zeros_like(book.steps)


def finished(book: Book) -> list[tuple[int, str]]:
    """Positions of the runs that have come to their end, and its mark."""
    return [(run, FINAL) for run in np.flatnonzero(book.status == FINISHED).tolist()]


def agents_of(
    shard: Shard, worlds: Sequence[World], book: Book, runs: Sequence[int], states: Sequence[Sequence[State]]
) -> Iterator[tuple[int, AgentContent]]:
    """The agents of those of ``runs`` that did not fail; ``states`` are those of every host for each of ``runs``."""
    arm = shard.arm
    for place, run in enumerate(runs):
        if book.status[run] == FAILED:
            continue
        plan = shard.runs[run]
        parts = zip(arm.learner_names, plan.learners, states, strict=True)
        learners = [TrainedLearner(name, config, of_host[place]) for name, config, of_host in parts]
        origin = {
            "experiment": arm.experiment,
            "identity": arm.identity,
            "arm": arm.arm,
            "sweep": arm.sweep,
            "run": plan.index,
            "seed": plan.seed,
        }
        yield run, trained_agent(plan.environment, worlds[run], learners, arm.selector, book, run, origin)
