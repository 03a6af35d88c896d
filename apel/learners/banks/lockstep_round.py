"""One round of play in lockstep: a step of every run at a time, until all their streaks are over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.batched_environment import BatchedEnvironment, Runs, Stepped
from apel.experience.action_form import ActionForm
from apel.experience.sight import Told
from apel.learners.banks.batched_learner import BatchedLearner
from apel.learners.banks.episodes_under_way import EpisodesUnderWay
from apel.learners.banks.seers import merged
from apel.learners.banks.streaks import Streaks
from apel.run.state import Book


class PlaysInLockstep(Protocol):
    """What a round asks of its bank, see `apel.learners.banks.lockstep.LockstepBank`."""

    @property
    def actions(self) -> ActionForm:
        """The form of the actions."""
        ...

    @property
    def learner(self) -> BatchedLearner:
        """The learners of all runs."""
        ...

    @property
    def environment(self) -> BatchedEnvironment:
        """Their environments."""
        ...

    def going(self, runs: Runs) -> NDArray[np.int64]:
        """Positions of those of ``runs`` that take the next step."""
        ...

    def freeze_at_epoch(self, runs: Runs, episodes: NDArray[np.int64]) -> Mapping[int, BaseException]:
        """Freeze the policies of runs in which an epoch begins."""
        ...

    def reset(self, runs: Runs, episodes: NDArray[np.int64]) -> Stepped:
        """Start episodes."""
        ...

    def first_seen(self, runs: Runs, entries: NDArray[Any]) -> NDArray[Any]:
        """What the learners see of first observations."""
        ...

    def learn_step(
        self, runs: Runs, seen: NDArray[Any], action: NDArray[Any], stepped: Stepped, probability: NDArray[np.float64]
    ) -> Told:
        """Tell the learners of a step."""
        ...

    def end_episode(self, runs: Runs) -> Mapping[int, BaseException]:
        """Tell the learners that episodes are over."""
        ...


class LockstepRound:
    """One call of `LockstepBank.play`: ``streaks`` take in finished episodes and say which runs go on; with
    ``keeps_entries`` trajectories are wanted whole.
    """

    def __init__(self, bank: PlaysInLockstep, book: Book, streaks: Streaks, *, keeps_entries: bool) -> None:
        self._bank, self._book, self._streaks = bank, book, streaks
        self._episodes = EpisodesUnderWay(bank.actions, keeps_entries=keeps_entries)

    def play(self, runs: Sequence[int]) -> None:
        """Play until every run's streak is over."""
        active, seen = self._begin(np.array(runs, dtype=np.int64))
        while len(active):
            going = self._bank.going(active)
            if len(going) == len(active):
                active, seen = self._tick(active, seen)
            else:
                ticked = self._tick(active[going], seen[going])
                active, seen = merged((np.delete(active, going), np.delete(seen, going, axis=0)), ticked)

    def _begin(self, runs: Runs) -> tuple[Runs, NDArray[Any]]:
        """Start an episode of each of ``runs``: those that did start, and what their learners see."""
        runs = runs[self._without(runs, self._bank.freeze_at_epoch(runs, self._book.episode[runs]))]
        if not len(runs):
            return runs, np.empty(0)
        stepped = self._bank.reset(runs, self._book.episode[runs])
        if stepped.errors:
            kept = self._without(runs, _by_run(runs, stepped.errors))
            runs, stepped = runs[kept], stepped.at(kept)
        self._episodes.begin(runs, stepped.entry)
        return runs, self._bank.first_seen(runs, stepped.entry)

    def _tick(self, active: Runs, seen: NDArray[Any]) -> tuple[Runs, NDArray[Any]]:
        """One step of every active run: those that go on, and what their learners see then."""
        bank = self._bank
        action, probability = bank.learner.act(active, seen)
        if bank.learner.errors:
            kept = self._without(active, bank.learner.errors)
            active, seen, action, probability = active[kept], seen[kept], action[kept], probability[kept]
        if not len(active):
            return active, seen
        stepped = bank.environment.step(active, action)
        if stepped.errors:
            kept = self._without(active, _by_run(active, stepped.errors))
            active, seen, action, probability = active[kept], seen[kept], action[kept], probability[kept]
            stepped = stepped.at(kept)
        if not len(active):
            return active, seen
        coming = bank.learn_step(active, seen, action, stepped, probability).coming
        self._episodes.note(active, bank.actions.uncounted(action), stepped, probability)
        ended = stepped.terminated | stepped.truncated
        if bank.learner.errors:
            kept = self._without(active, bank.learner.errors)
            active, coming, ended, stepped = active[kept], coming[kept], ended[kept], stepped.at(kept)
        if not ended.any():
            return active, coming
        again = self._go_on(active[ended], stepped.terminated[ended])
        return self._joined(active[~ended], coming[~ended], again)

    def _go_on(self, runs: Runs, terminated: NDArray[np.bool_]) -> Runs:
        """Take in the finished episodes of ``runs``; those whose streak goes on."""
        kept = self._without(runs, self._bank.end_episode(runs))
        finished = list(zip(runs[kept].tolist(), terminated[kept].tolist(), strict=True))
        trajectories = [self._episodes.finish(run, terminated=ended) for run, ended in finished]
        pairs = zip(finished, trajectories, strict=True)
        return np.array([run for (run, _), one in pairs if self._streaks.finish(run, one)], dtype=np.int64)

    def _joined(self, runs: Runs, seen: NDArray[Any], again: Runs) -> tuple[Runs, NDArray[Any]]:
        """The runs in mid-episode and those that begin another one, in rising order."""
        return merged((runs, seen), self._begin(again)) if len(again) else (runs, seen)

    def _without(self, runs: Runs, errors: Mapping[int, BaseException]) -> NDArray[np.int64]:
        """The positions of runs that had no errors; the others fail."""
        if not errors:
            return np.arange(len(runs))
        for run, error in errors.items():
            self._episodes.forget(run)
            self._streaks.fail(run, error)
        return np.array([i for i, run in enumerate(runs.tolist()) if run not in errors], dtype=np.int64)


def _by_run(runs: Runs, errors: Mapping[int, BaseException]) -> dict[int, BaseException]:
    return {int(runs[position]): error for position, error in errors.items()}
