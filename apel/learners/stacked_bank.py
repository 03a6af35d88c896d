"""Stacked learners in a shard: its runs play, and learn from the episodes of others, in lockstep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.batched import BatchedEnvironment, Runs, Stepped
from apel.book import RUNNING, Book, advance_run
from apel.learners.base import Failure, Performance, Played, State, StreakLimit
from apel.learners.lockstep import Cursor
from apel.learners.stacked import StackedLearner, Transitions
from apel.learners.streaks import EpisodeRow, criterion_measure, measure, played
from apel.representations import View
from apel.selection import Selector, starts_epoch
from apel.stacking import ViewStacks
from apel.streams import episode_seed, evaluation_seed
from apel.trajectory import Trajectory, TrajectoryBatch


class StackedBank:
    """A stacked learner with a batched environment.

    Parameters
    ----------
    learner:
        That of all runs.
    environment:
        Those of all runs.
    environment_keys:
        One 64-bit key per run (`apel.streams.episode_seed`).
    view:
        What the learner sees of the raw observations.
    action_space:
        That of the environments.
    performance:
        How good an episode was.
    freezes:
        Policies are frozen within each epoch (`apel.selection.Epochal`).
    """

    def __init__(
        self,
        learner: StackedLearner,
        environment: BatchedEnvironment,
        environment_keys: Sequence[int],
        view: View,
        action_space: spaces.Discrete,
        performance: Performance,
        *,
        freezes: bool = False,
    ) -> None:
        self.learner = learner
        self.environment = environment
        self.performance = performance
        self.first_action = int(action_space.start)
        self._num_actions = int(action_space.n)
        self._keys = [np.uint64(key) for key in environment_keys]
        self._view = view
        self._stacks = ViewStacks(len(self._keys), view.stack, view.space)
        self._freezes = freezes

    def play(
        self, runs: Sequence[int], book: Book, selector: Selector, me: int, limit: StreakLimit, *, record: bool
    ) -> Played:
        """See `LearnerBank`; runs whose streak is over sit out until all are."""
        return _Round(self, book, selector, me, limit, max(limit.steps // len(runs), 1), record=record).play(runs)

    def learn(self, batch: TrajectoryBatch) -> tuple[Failure, ...]:
        """Learn from others' episodes, one step of every run at a time."""
        cursor = Cursor(batch, self._num_actions, self.first_action)
        self.freeze_at_epoch(cursor.runs, cursor.episodes)
        seen = self.first_seen(cursor.runs, cursor.entries)
        while len(cursor.runs):
            going = self.going(cursor.runs)
            runs, step = cursor.runs[going], cursor.step(going)
            stepped = Stepped(step.next_entry, step.reward, step.terminated, step.truncated)
            seen[going] = self.learn_step(runs, seen[going], step.action, stepped, step.probability)
            self.learner.end_episode(runs[step.terminated | step.truncated])
            started, left = cursor.advance(going)
            seen, started = seen[left], started[left]
            if started.any():
                self.freeze_at_epoch(cursor.runs[started], cursor.episodes[started])
                seen[started] = self.first_seen(cursor.runs[started], cursor.entries[started])
        return ()

    def going(self, runs: Runs) -> NDArray[np.int64]:
        """Positions of those of ``runs`` that take the next step: all of them, once they learn at the same steps."""
        lag = self.learner.lag(runs)
        return np.arange(len(runs)) if lag.min() == lag.max() else np.flatnonzero(lag)

    def learn_step(
        self,
        runs: Runs,
        seen: NDArray[Any],
        action: NDArray[np.int64],
        stepped: Stepped,
        probability: NDArray[np.float64],
    ) -> NDArray[Any]:
        """Learn from one step of each of ``runs``; what their learners see after it, when they act."""
        following = self._stacks.push(runs, self.see(stepped.entry))
        reward = self._view.rewards(stepped.reward, stepped.entry)
        is_over = self._view.terminals(stepped.terminated, stepped.entry)
        truncated = stepped.truncated & ~is_over
        self.learner.learn(runs, Transitions(seen, action, reward, following, is_over, truncated, probability))
        again = is_over & ~stepped.terminated
        if again.any():
            following[again] = self.first_seen(runs[again], stepped.entry[again])
        return following

    def state(self) -> State:
        """That of the learner; environments start afresh with every episode."""
        return self.learner.state()

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        self.learner.restore(state)

    def see(self, entries: NDArray[Any]) -> NDArray[Any]:
        """What the learner sees, but for stacking, where such entries stand in trajectories."""
        return self._view.batch(self.environment.decode(entries))

    def first_seen(self, runs: Runs, entries: NDArray[Any]) -> NDArray[Any]:
        """What the learners see where an episode begins for them."""
        return self._stacks.start(runs, self.see(entries))

    def reset(self, runs: Runs, episodes: NDArray[np.int64]) -> Stepped:
        """Start an episode of each run."""
        self.freeze_at_epoch(runs, episodes)
        seeds = [episode_seed(self._keys[run], episode) for run, episode in zip(runs, episodes, strict=True)]
        return self.environment.reset(runs, seeds)

    def freeze_at_epoch(self, runs: Runs, episodes: NDArray[np.int64]) -> None:
        """Freeze the policies for which an epoch begins."""
        if self._freezes and len(begin := [i for i, episode in enumerate(episodes) if starts_epoch(int(episode))]):
            self.learner.freeze(runs[begin])

    def evaluate_one(self, run: int, episode: int) -> tuple[int, float]:
        """Length and return of an episode in which the run takes the first of its best actions, and nobody learns."""
        runs = np.array([run], dtype=np.int64)
        stepped = self.environment.reset(runs, [evaluation_seed(self._keys[run], episode)])
        length, total, begins = 0, 0.0, True
        while not (stepped.errors or stepped.terminated[0] or stepped.truncated[0]):
            view = self.see(stepped.entry)
            seen = self._stacks.start(runs, view) if begins else self._stacks.push(runs, view)
            stepped = self.environment.step(runs, self.learner.action_values(runs, seen).argmax(axis=1))
            begins = bool(self._view.terminals(stepped.terminated, stepped.entry)[0])
            length += 1
            total += float(stepped.reward[0])
        for error in stepped.errors.values():
            raise RuntimeError(error)
        return length, total


@dataclass
class _Episode:
    """One under way, step by step."""

    entries: list[NDArray[Any]]
    actions: list[int] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    probabilities: list[NDArray[np.float64]] = field(default_factory=list)

    def trajectory(self, *, terminated: bool) -> Trajectory:
        return Trajectory(
            observation=np.array(self.entries),
            action=np.array(self.actions),
            reward=np.array(self.rewards, dtype=np.float64),
            terminated=terminated,
            probability=np.array(self.probabilities),
        )


class _Round:
    """One call of `StackedBank.play`."""

    def __init__(
        self,
        bank: StackedBank,
        book: Book,
        selector: Selector,
        me: int,
        limit: StreakLimit,
        steps_per_run: int,
        *,
        record: bool,
    ) -> None:
        self._bank, self._book, self._selector, self._me = bank, book, selector, me
        self._max_episodes, self._max_steps = limit.episodes, steps_per_run
        self._record = record
        self._keeps_entries = record or callable(bank.performance)
        self._open: dict[int, _Episode] = {}
        self._streak_episodes: dict[int, int] = {}
        self._streak_steps: dict[int, int] = {}
        self._rows: list[EpisodeRow] = []
        self._trajectories: list[Trajectory] = []
        self._failures: list[Failure] = []

    def play(self, runs: Sequence[int]) -> Played:
        self._streak_episodes, self._streak_steps = dict.fromkeys(runs, 0), dict.fromkeys(runs, 0)
        active, seen = self._begin(np.array(runs, dtype=np.int64))
        while len(active):
            going = self._bank.going(active)
            ticked = self._tick(active[going], seen[going])
            active, seen = _merged((np.delete(active, going), np.delete(seen, going, axis=0)), ticked)
        return played(self._rows, self._trajectories, self._failures)

    def _begin(self, runs: Runs) -> tuple[Runs, NDArray[Any]]:
        """Start an episode of each of ``runs``: those that did start, and what their learners see."""
        stepped = self._bank.reset(runs, self._book.episode[runs])
        kept = self._without_errors(runs, stepped)
        for run, entry in zip(runs[kept].tolist(), stepped.entry[kept], strict=True):
            self._open[run] = _Episode([entry] if self._keeps_entries else [])
        return runs[kept], self._bank.first_seen(runs[kept], stepped.entry[kept])

    def _tick(self, active: Runs, seen: NDArray[Any]) -> tuple[Runs, NDArray[Any]]:
        """One step of every active run: those that go on, and what their learners see then."""
        action, probability = self._bank.learner.act(active, seen)
        stepped = self._bank.environment.step(active, action)
        if stepped.errors:
            kept = self._without_errors(active, stepped)
            active, seen, action, probability = active[kept], seen[kept], action[kept], probability[kept]
            stepped = stepped.at(kept)
        if not len(active):
            return active, seen
        following = self._bank.learn_step(active, seen, action, stepped, probability)
        self._note(active, action + self._bank.first_action, stepped, probability)
        ended = stepped.terminated | stepped.truncated
        if not ended.any():
            return active, following
        self._bank.learner.end_episode(active[ended])
        again = self._go_on(active[ended], stepped.terminated[ended])
        return self._joined(active[~ended], following[~ended], again)

    def _go_on(self, runs: Runs, terminated: NDArray[np.bool_]) -> Runs:
        """Take in the finished episodes of ``runs``; those whose streak goes on."""
        finished = zip(runs.tolist(), terminated.tolist(), strict=True)
        return np.array([run for run, ended in finished if self._goes_on(run, ended)], dtype=np.int64)

    def _joined(self, runs: Runs, seen: NDArray[Any], again: Runs) -> tuple[Runs, NDArray[Any]]:
        """The runs in mid-episode and those that begin another one, in rising order."""
        return _merged((runs, seen), self._begin(again)) if len(again) else (runs, seen)

    def _note(
        self, active: Runs, action: NDArray[np.int64], stepped: Stepped, probability: NDArray[np.float64]
    ) -> None:
        columns = (active.tolist(), action.tolist(), stepped.reward.tolist(), stepped.entry, probability)
        for run, one_action, reward, entry, distribution in zip(*columns, strict=True):
            episode = self._open[run]
            episode.actions.append(one_action)
            episode.rewards.append(reward)
            if self._keeps_entries:
                episode.entries.append(entry)
                episode.probabilities.append(distribution)

    def _goes_on(self, run: int, terminated: bool) -> bool:
        """Take in the run's finished episode; whether its streak goes on."""
        episode, book = int(self._book.episode[run]), self._book
        trajectory = self._open.pop(run).trajectory(terminated=terminated)
        try:
            value = measure(self._bank.performance, trajectory)
            total = trajectory.undiscounted_return
            judged = criterion_measure(book, self._bank, run, trajectory)
            advance_run(book, self._selector, run, len(trajectory), total, value, judged)
        except Exception as error:  # noqa: BLE001 - whatever a user's code raises ends this run, and only this one
            self._failures.append(Failure(run, episode, f"{type(error).__name__}: {error}"))
            return False
        self._rows.append((run, episode, len(trajectory), total, value, judged, terminated))
        if self._record:
            self._trajectories.append(trajectory)
        self._streak_episodes[run] += 1
        self._streak_steps[run] += len(trajectory)
        if self._streak_episodes[run] >= self._max_episodes or self._streak_steps[run] >= self._max_steps:
            return False
        return bool(book.status[run] == RUNNING and book.learner[run] == self._me)

    def _without_errors(self, runs: Runs, stepped: Stepped) -> NDArray[np.int64]:
        """The positions at which nothing was raised; the runs at the others fail."""
        for position, error in stepped.errors.items():
            run = int(runs[position])
            self._failures.append(Failure(run, int(self._book.episode[run]), error))
        return np.array([i for i in range(len(runs)) if i not in stepped.errors], dtype=np.int64)


_Seers = tuple[Runs, NDArray[Any]]
"""Runs, in rising order, and what their learners see."""


def _merged(some: _Seers, others: _Seers) -> _Seers:
    """Both, in rising order of the runs."""
    if not len(some[0]) or not len(others[0]):
        return some if len(some[0]) else others
    runs, seen = (np.concatenate(columns) for columns in zip(some, others, strict=True))
    order = np.argsort(runs)
    return runs[order], seen[order]
