"""A small coordinator: banks that play runs in rounds, every one learning from all others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from apel.building import make_bank, make_performance
from apel.configs import LearnerConfig
from apel.ensemble import Ensemble, EpisodeRecord
from apel.environments import World
from apel.learners import LearnerBank
from apel.learners.base import Failure, StreakLimit
from apel.run.criterion import Criterion
from apel.run.opening import open_book
from apel.run.selection import Selector
from apel.run.state import RUNNING, Book, EpisodeRows, replay

SHORT = StreakLimit(episodes=5, steps=10**4)


@dataclass
class Played:
    """What a shard of runs gave."""

    book: Book
    rows: dict[int, list[tuple[float, ...]]]
    """Per run: episode, selected, return, length, then probability, estimate and concentration."""
    failures: list[Failure]
    rounds: int


def make_banks(
    learners: Sequence[LearnerConfig],
    worlds: Sequence[World],
    run_seeds: Sequence[int],
    *,
    performance: str = "return",
    with_probability: bool = False,
    freezes: bool = False,
    evaluates: bool = False,
) -> list[LearnerBank]:
    """One bank per learner, with the same configuration in every run."""
    measure = make_performance(performance)
    return [
        make_bank(
            [config] * len(worlds),
            worlds,
            run_seeds,
            i,
            measure,
            with_probability=with_probability,
            freezes=freezes,
            evaluates=evaluates,
        )
        for i, config in enumerate(learners)
    ]


def play_rounds(
    banks: Sequence[LearnerBank],
    worlds: Sequence[World],
    run_seeds: Sequence[int],
    selector: Selector,
    num_episodes: int,
    *,
    criterion: Criterion | None = None,
    limit: StreakLimit = SHORT,
    stops_when_met: bool = True,
) -> Played:
    """Let each bank in turn play a streak of the runs that are its, until all runs are over or have failed.

    The rows are those of a second book that replays what was played.
    """
    book, second = (
        open_book(
            selector,
            len(banks),
            num_episodes,
            criterion,
            run_seeds,
            [world.info for world in worlds],
            stops_when_met=stops_when_met,
        )
        for _ in range(2)
    )
    played = Played(book, {run: [] for run in range(len(worlds))}, [], 0)
    everything = np.ones(num_episodes, dtype=np.bool_)
    failed: set[int] = set()
    while True:
        running = [run for run in np.flatnonzero(book.status == RUNNING).tolist() if run not in failed]
        if not running:
            break
        played.rounds += 1
        for me, bank in enumerate(banks):
            runs = [run for run in running if book.status[run] == RUNNING and book.learner[run] == me]
            if not runs:
                continue
            answer = bank.play(runs, book, selector, me, limit, record=len(banks) > 1)
            failures = list(answer.failures)
            if answer.batch is not None:
                for other, one in enumerate(banks):
                    if other != me:
                        failures += one.learn(answer.batch)
            played.failures += failures
            failed |= {failure.run for failure in failures}
            _append(played, replay(second, selector, answer.episodes, everything))
    for one, other in zip(book, second, strict=True):
        np.testing.assert_array_equal(one, other)
    return played


def _append(played: Played, rows: EpisodeRows) -> None:
    columns = (rows.run, rows.episode, rows.selected, rows.episode_return, rows.length)
    for (run, *numbers), header in zip(zip(*(c.tolist() for c in columns), strict=True), rows.header, strict=True):
        played.rows[run].append((*numbers, *header.tolist()))


def row_of(record: EpisodeRecord) -> tuple[float, ...]:
    """A record of `Ensemble`, in the form of `Played.rows`."""
    header = np.concatenate([record.probability, record.performance_estimate, record.concentration])
    return (record.episode, record.selected, record.episode_return, record.length, *header.tolist())


def ensemble_rows(
    learners: Sequence[LearnerConfig],
    worlds: Sequence[World],
    run_seeds: Sequence[int],
    selector: Selector,
    num_episodes: int,
    *,
    performance: str = "return",
    criterion: Criterion | None = None,
) -> tuple[dict[int, list[tuple[float, ...]]], list[int | None]]:
    """The rows and train times of the same runs, one after the other through `Ensemble`."""
    rows, times = {}, []
    for run, (world, seed) in enumerate(zip(worlds, run_seeds, strict=True)):
        ensemble = Ensemble(world, learners, selector, seed, num_episodes, performance=performance, criterion=criterion)
        rows[run] = [row_of(record) for record in ensemble.run()]
        times.append(ensemble.train_time)
    return rows, times


def assert_same_rows(one: dict[int, list[tuple[float, ...]]], other: dict[int, list[tuple[float, ...]]]) -> None:
    """Equal runs, lengths and numbers; a number that is missing is missing on both sides."""
    assert one.keys() == other.keys()
    for run in one:
        np.testing.assert_array_equal(np.array(one[run]), np.array(other[run]))
