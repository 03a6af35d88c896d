"""The lockstep bank: any learners on any environments, one step of every run at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.dynamics.batched_environment import ENVIRONMENTS, BatchedEnvironment, CarriesState, Runs, Stepped
from apel.dynamics.worlds import HasWorlds
from apel.experience.action_form import ActionForm
from apel.experience.sight import Sight, Told
from apel.experience.trajectory import Episodes, Trajectory, TrajectoryBatch
from apel.learners.banks.batch_walk import BatchWalk
from apel.learners.banks.batched_learner import NO_ERRORS, BatchedLearner, EpisodePlayer, Transitions
from apel.learners.banks.greedy_evaluation import evaluate_greedily, raise_first
from apel.learners.banks.learner_list import LearnerList
from apel.learners.banks.lockstep_round import LockstepRound
from apel.learners.banks.seers import replaced
from apel.learners.banks.streaks import Streaks
from apel.learners.banks.whole_episodes import whole_episodes
from apel.learners.base import Failure, Performance, Played, State, StreakLimit
from apel.learners.starting import begin, of_run, of_runs, with_own
from apel.numerics.episode_seeds import EpisodeSeeds
from apel.run.selection import Selector, starts_epoch
from apel.run.state import Book

_STEPS_TOGETHER = 512
"""Of others' episodes, for which one call is made: a call takes as long as learning from a dozen steps."""


class LockstepBank:
    """A batched learner, or a list of learners, with a batched environment, or a list of environments.

    Parameters
    ----------
    learner:
        That of all runs.
    environment:
        Those of all runs.
    seeds:
        Of each run's episodes.
    sight:
        What the learners see of the raw observations.
    action_space:
        That of the environments.
    performance:
        How good an episode was.
    player:
        Plays whole episodes, where there is one.
    freezes:
        Policies are frozen within each epoch (`apel.run.selection.Epochal`).
    raises:
        What a user's code raises is raised; otherwise it ends its run, and only this one.
    single:
        Makes a batched learner like this one for a single run; None for a list of learners.
    """

    def __init__(
        self,
        learner: BatchedLearner,
        environment: BatchedEnvironment,
        seeds: Sequence[EpisodeSeeds],
        sight: Sight,
        action_space: spaces.Space[Any],
        performance: Performance,
        *,
        player: EpisodePlayer | None = None,
        freezes: bool = False,
        raises: bool = False,
        single: Callable[[], BatchedLearner] | None = None,
    ) -> None:
        self.learner = learner
        self.environment = environment
        self.performance = performance
        self.actions = ActionForm(action_space)
        self._seeds = list(seeds)
        self._sight = sight
        self._freezes, self._raises, self._single = freezes, raises, single
        self._player = player

    @property
    def is_compiled(self) -> bool:
        """See `LearnerBank`."""
        return bool(getattr(self.learner, "is_compiled", False))

    def play(
        self, runs: Sequence[int], book: Book, selector: Selector, me: int, limit: StreakLimit, *, record: bool
    ) -> Played:
        """See `LearnerBank`; runs whose streak is over sit out until all are.

        Where whole episodes are played in compiled code, one run after the other.
        """
        performance, raises = self.performance, self._raises
        streaks = Streaks(self, runs, book, selector, me, limit, performance, record=record, raises=raises)
        if self._player is not None:
            for run in runs:
                while streaks.finish(run, self._play_one(self._player, run, int(book.episode[run]))):
                    pass
            return streaks.played()
        LockstepRound(self, book, streaks, keeps_entries=record or callable(performance)).play(runs)
        return streaks.played()

    def learn(self, batch: TrajectoryBatch) -> tuple[Failure, ...]:
        """Learn from others' episodes, one step of every run at a time; a run whose learner raises fails alone."""
        if self.learner.is_alone and self._sight.is_memoryless:
            return self._learn_whole_episodes(batch)
        walk, failures = BatchWalk(batch, self.actions), list[Failure]()
        every = np.ones(len(walk.runs), dtype=np.bool_)
        seen = self._begin(walk, every, np.empty(0), failures)
        while len(walk.runs):
            going = self.going(walk.runs)
            runs, step = walk.runs[going], walk.step(going)
            stepped = Stepped(step.next_entry, step.reward, step.terminated, step.truncated)
            told = self.learn_step(runs, seen[going], step.action, stepped, step.probability)
            errors = self.learner.errors
            ended = step.terminated | step.truncated
            if ended.any():
                errors = {**errors, **self.end_episode(runs[ended], errors)}
            seen = told.coming if len(going) == len(seen) else replaced(seen, going, told.coming)
            if errors:
                seen, going = self._forget(walk, errors, seen, going, failures)
            started, left = walk.advance(going)
            seen = self._begin(walk, started[left], seen if left.all() else seen[left], failures)
        return tuple(failures)

    def skip(self, episodes: Episodes) -> tuple[Failure, ...]:
        """See `LearnerBank`."""
        pairs = zip(episodes.run.tolist(), episodes.episode.tolist(), strict=True)
        # Of two epochs that begin unheeded the first is told of: whatever fails, fails there.
        begun = dict(reversed([(run, episode) for run, episode in pairs if starts_epoch(episode)]))
        errors = self.freeze_at_epoch(np.array([*begun], dtype=np.int64), np.array([*begun.values()], dtype=np.int64))
        if errors and self._raises:
            raise_first(errors)
        return tuple(Failure.of(run, begun[run], error) for run, error in errors.items())

    def _learn_whole_episodes(self, batch: TrajectoryBatch) -> tuple[Failure, ...]:
        """The same run by run, where nothing is gained from lockstep."""
        failures: dict[int, Failure] = {}
        # What is compiled fails at nothing, and need not be told that an episode is over: so it is asked less often.
        most_steps = _STEPS_TOGETHER if self.is_compiled and not self._freezes else 1
        for some in whole_episodes(batch, self.actions, most_steps):
            one, run, episode = some.runs[:1], int(some.runs[0]), int(some.episodes[0])
            if run in failures:
                continue
            errors = self.freeze_at_epoch(one, some.episodes[:1])
            if not errors:
                seen = self.first_seen(some.runs, some.entry)
                self.learn_step(some.runs, seen, some.action, some.stepped, some.probability)
                errors = self.learner.errors or self.end_episode(one)
            if errors:
                if self._raises:
                    raise_first(errors)
                failures[run] = Failure.of(run, episode, errors[run])
        return tuple(failures.values())

    def _play_one(self, player: EpisodePlayer, run: int, episode: int) -> Trajectory:
        one = np.array([run], dtype=np.int64)
        self.freeze_at_epoch(one, np.array([episode]))
        return player.play(run, cast("HasWorlds", self.environment).start(self._seeds[run].of_episode(episode)))

    def going(self, runs: Runs) -> NDArray[np.int64]:
        """Positions of those of ``runs`` that take the next step: all of them, once they learn at the same steps."""
        lag = self.learner.lag(runs)
        return np.flatnonzero(lag) if lag.any() and lag.min() != lag.max() else np.arange(len(runs))

    def learn_step(
        self,
        runs: Runs,
        seen: NDArray[Any],
        action: NDArray[Any],
        stepped: Stepped,
        probability: NDArray[np.float64],
    ) -> Told:
        """Learn from one step of each of ``runs``, which saw ``seen`` before it; what they were told of it."""
        raw = self.environment.decode(stepped.entry)
        told = self._sight.step(runs, raw, stepped.reward, stepped.terminated, stepped.truncated)
        self.learner.learn(runs, Transitions(seen, action, *told[:4], probability))
        return told

    def end_episode(self, runs: Runs, errors: Mapping[int, BaseException] = NO_ERRORS) -> Mapping[int, BaseException]:
        """Tell those of ``runs`` that had no ``errors`` that their episode is over; the errors of that."""
        self.learner.end_episode(runs[[run not in errors for run in runs.tolist()]] if errors else runs)
        return self.learner.errors

    @property
    def errors(self) -> Mapping[int, BaseException]:
        """See `LearnerBank`."""
        return self.learner.errors

    def state(self) -> State:
        """That of the learner, and what environments carry over from one episode to the next."""
        carried = self.environment.state() if isinstance(self.environment, CarriesState) else {}
        return {**self.learner.state(), **carried}

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        self.learner.restore({name: part for name, part in state.items() if name != ENVIRONMENTS})
        if isinstance(self.environment, CarriesState):
            self.environment.restore({ENVIRONMENTS: state[ENVIRONMENTS]})

    def models(self, runs: Sequence[int]) -> list[State]:
        """See `LearnerBank`."""
        state = self.learner.state()
        if self._single is None:
            return [state["learners"][run] or {} for run in runs]
        # Through a learner of one run, whose state has no room that only other runs need.
        one, states = self._single(), list[State]()
        for run in runs:
            one.restore(of_run(state, run))
            states.append(one.state())
        return states

    def begin_from(self, states: Sequence[State]) -> None:
        """See `LearnerBank`."""
        if isinstance(self.learner, LearnerList):
            for learner, state in zip(self.learner.learners, states, strict=True):
                begin(learner, state)
        else:
            self.learner.restore(with_own(of_runs(states), self.learner.state()))

    def first_seen(self, runs: Runs, entries: NDArray[Any]) -> NDArray[Any]:
        """What the learners see where an episode begins for them."""
        return self._sight.start(runs, self.environment.decode(entries))

    def reset(self, runs: Runs, episodes: NDArray[np.int64]) -> Stepped:
        """Start an episode of each run."""
        pairs = zip(runs.tolist(), episodes.tolist(), strict=True)
        seeds = [self._seeds[run].of_episode(episode) for run, episode in pairs]
        return self.environment.reset(runs, seeds)

    def freeze_at_epoch(self, runs: Runs, episodes: NDArray[np.int64]) -> Mapping[int, BaseException]:
        """Freeze the policies for which an epoch begins; the errors of that."""
        begin = [i for i, episode in enumerate(episodes.tolist()) if starts_epoch(episode)] if self._freezes else []
        if not begin:
            return NO_ERRORS
        self.learner.freeze(runs[begin])
        return self.learner.errors

    def evaluate_one(self, run: int, episode: int) -> tuple[int, float]:
        """See `apel.learners.banks.streaks.Evaluator`."""
        seed = self._seeds[run].of_evaluation(episode)
        return evaluate_greedily(self.learner, self.environment, self._sight, run, seed)

    def _begin(
        self, walk: BatchWalk, started: NDArray[np.bool_], seen: NDArray[Any], failures: list[Failure]
    ) -> NDArray[Any]:
        """Begin the episodes of those of the walk's runs that ``started`` marks; what all of them see."""
        if not started.any():
            return seen
        errors = self.freeze_at_epoch(walk.runs[started], walk.episodes[started])
        first = self.first_seen(walk.runs[started], walk.entries[started])
        seen = first if started.all() else replaced(seen, np.flatnonzero(started), first)
        if errors:
            seen, _ = self._forget(walk, errors, seen, np.empty(0, dtype=np.int64), failures)
        return seen

    def _forget(
        self,
        walk: BatchWalk,
        errors: Mapping[int, BaseException],
        seen: NDArray[Any],
        going: NDArray[np.int64],
        failures: list[Failure],
    ) -> tuple[NDArray[Any], NDArray[np.int64]]:
        """Runs with errors fail, in the episode that the walk is in; what the others see, and those ``going`` there."""
        if self._raises:
            raise_first(errors)
        rows = zip(walk.runs.tolist(), walk.episodes.tolist(), strict=True)
        failures += [Failure.of(run, episode, errors[run]) for run, episode in rows if run in errors]
        kept = np.array([run not in errors for run in walk.runs.tolist()], dtype=np.bool_)
        goes = np.isin(np.arange(len(kept)), going)
        walk.keep(kept)
        return seen[kept], np.flatnonzero(goes[kept])
