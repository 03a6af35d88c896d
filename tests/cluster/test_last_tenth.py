"""The mean return of the last tenth of a run, against plain loops."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from apel.experience.trajectory import Episodes
from apel.run.state import ANY_STEPS
from cluster.last_tenth import LastTenth


class _Book:
    """What of a book is read."""

    def __init__(self, num_runs: int, num_episodes: int, num_steps: int) -> None:
        self.episode = np.zeros(num_runs, dtype=np.int64)
        self.steps = np.zeros(num_runs, dtype=np.int64)
        self.num_episodes, self.num_steps = num_episodes, num_steps


def _plain(played: list[tuple[int, float]], num_episodes: int, num_steps: int) -> float:
    """Of one run's lengths and returns; NaN where it came to neither cap."""
    total = sum(length for length, _ in played)
    if total >= num_steps:
        ends = np.cumsum([length for length, _ in played])
        first = num_steps - -(-num_steps // 10)
        return float(np.mean([value for end, (_, value) in zip(ends, played, strict=True) if end > first]))
    if len(played) == num_episodes:
        return float(np.mean([value for _, value in played[num_episodes - -(-num_episodes // 10) :]]))
    return float("nan")


@given(st.data())
def test_as_plain_loops(data: Any) -> None:
    """Whatever the lengths, the returns, the caps, and how many episodes are taken in at once."""
    num_episodes = data.draw(st.integers(1, 25))
    num_steps = data.draw(st.integers(1, 60) | st.just(ANY_STEPS))
    runs: list[list[tuple[int, float]]] = []
    for _ in range(data.draw(st.integers(1, 3))):
        played: list[tuple[int, float]] = []
        while len(played) < num_episodes and sum(length for length, _ in played) < num_steps:
            played.append((data.draw(st.integers(1, 9)), float(data.draw(st.integers(-5, 5)))))
        runs.append(played[: len(played) - data.draw(st.sampled_from([0, 0, 1]))])
    book: Any = _Book(len(runs), num_episodes, num_steps)
    tail = LastTenth.of(book)
    while any(book.episode[run] < len(played) for run, played in enumerate(runs)):
        taken = []
        for run in data.draw(st.permutations(range(len(runs)))):
            at = int(book.episode[run])
            coming = runs[run][at : at + data.draw(st.integers(1, 6))]
            taken += [(run, at + i, length, value) for i, (length, value) in enumerate(coming)]
        columns = [np.array(column) for column in zip(*taken, strict=True)]
        if not columns:
            continue
        run, episode, length, value = columns
        zeros = np.zeros(len(run))
        tail.take_in(Episodes(run, episode, length, value.astype(float), zeros, zeros, zeros), book.steps)
        np.add.at(book.steps, run, length)
        np.add.at(book.episode, run, 1)
    expected = [_plain(played, num_episodes, num_steps) for played in runs]
    assert tail.mean(book).tolist() == pytest.approx(expected, nan_ok=True)
