"""The compiled bank: tabular learners on finite environments, whole streaks in compiled loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.dynamics.finite_model import FiniteModel, observations_of, stack_models
from apel.experience.action_form import ActionForm
from apel.experience.trajectory import Episodes, Trajectory, TrajectoryBatch
from apel.learners.banks.batched_learner import NO_ERRORS
from apel.learners.banks.compiled_streaks import learn_episodes, play_compiled_streaks, skip_episodes
from apel.learners.banks.streaks import Streaks, most_per_run, not_finite_failures
from apel.learners.base import Failure, Performance, Played, State, StreakLimit
from apel.learners.tabular.kernels import TrajectoryRoom, evaluate_episode, play_episode
from apel.learners.tabular.table_states import TableStates
from apel.learners.tabular.tables import TabularLearner, make_tables, restore_tables, tables_state
from apel.numerics.streams import episode_seed, evaluation_seed, stream_of_seed
from apel.run.selection import Selector
from apel.run.state import Book, is_compiled


class StateNumbers:
    """How state numbers are read, of finite environments whose features take so many values each."""

    def __init__(self, feature_sizes: Sequence[int]) -> None:
        self._sizes = tuple(feature_sizes)

    def decode(self, entries: NDArray[Any]) -> NDArray[np.int64]:
        """``int64[…, features]``, or ``int64[…]`` where there is only one feature."""
        return observations_of(entries.astype(np.int64), self._sizes)


class CompiledBank:
    """Q-learning, Dyna-Q, or a vote of several of them, for every run of a shard, on finite environments.

    Parameters
    ----------
    models:
        The environment of each run.
    environment_keys:
        One 64-bit key per run (`apel.numerics.streams.episode_seed`).
    learners:
        That of each run, all with the same number of members.
    performance:
        How good an episode was.
    with_probability:
        Record μ(·|s) in the trajectories, for learners that need it.
    freezes:
        Policies are frozen within each epoch (`apel.run.selection.Epochal`).
    raises:
        What a user's code raises is raised; otherwise it ends its run, and only this one.
    """

    is_compiled: ClassVar[bool] = True

    def __init__(
        self,
        models: Sequence[FiniteModel],
        environment_keys: Sequence[int],
        learners: Sequence[TabularLearner],
        performance: Performance,
        *,
        with_probability: bool,
        freezes: bool = False,
        raises: bool = False,
    ) -> None:
        self.environment = StateNumbers(models[0].feature_sizes)
        self.actions = ActionForm(spaces.Discrete(models[0].num_actions))
        self._world = stack_models(models)
        self._keys = np.array(environment_keys, dtype=np.uint64)
        self._performance, self._raises = performance, raises
        self._with_probability = with_probability
        self._tables = make_tables(models[0], learners, freezes=freezes)
        self._states = TableStates(self._tables, learners, models[0])
        self._observation_type = models[0].state_type

    def play(
        self, runs: Sequence[int], book: Book, selector: Selector, me: int, limit: StreakLimit, *, record: bool
    ) -> Played:
        """See `LearnerBank`; a selector or a metric that is not compiled is asked after every episode."""
        if not is_compiled(selector) or callable(self._performance):
            performance, raises = self._performance, self._raises
            streaks = Streaks(self, runs, book, selector, me, limit, performance, record=record, raises=raises)
            return self._play_one_by_one(runs, book, streaks)
        most = most_per_run(limit, len(runs))
        most[0] = min(most[0], book.num_episodes)
        bytes_per_step = self._bytes_per_step() if record else 0
        recording = self._new_recording(len(runs) * self._room(most, bytes_per_step), len(runs) * int(most[0]))
        episodes = Episodes.empty(len(runs) * int(most[0]))
        count = play_compiled_streaks(
            np.array(runs, dtype=np.int64),
            self._world,
            self._keys,
            self._tables,
            book,
            selector.select,
            selector.observe,
            me,
            self._performance == "negative_length",
            most,
            bytes_per_step,
            record,
            recording,
            episodes,
        )
        return _played(recording, self._world.reward_value, episodes.first(count), record=record)

    @property
    def errors(self) -> Mapping[int, BaseException]:
        """See `LearnerBank`; none of its code is a user's."""
        return NO_ERRORS

    def learn(self, batch: TrajectoryBatch) -> tuple[Failure, ...]:
        """Learn from every step of others' episodes."""
        learn_episodes(
            batch.episodes, batch.observation, batch.action, batch.reward_code, batch.reward_value, self._tables
        )
        return ()

    def skip(self, episodes: Episodes) -> tuple[Failure, ...]:
        """See `LearnerBank`."""
        skip_episodes(episodes, self._tables)
        return ()

    def state(self) -> State:
        """Tables, streams and clocks."""
        return tables_state(self._tables)

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        restore_tables(self._tables, state)

    def models(self, runs: Sequence[int]) -> list[State]:
        """See `LearnerBank`."""
        return [self._states.of_run(run) for run in runs]

    def begin_from(self, states: Sequence[State]) -> None:
        """See `LearnerBank`."""
        for run, state in enumerate(states):
            self._states.begin(run, state)

    def evaluate_one(self, run: int, episode: int) -> tuple[int, float]:
        """See `apel.learners.banks.streaks.Evaluator`."""
        stream = stream_of_seed(evaluation_seed(self._keys[run], episode))
        length, episode_return = evaluate_episode(self._world, self._tables, run, stream)
        return int(length), float(episode_return)

    def _play_one_by_one(self, runs: Sequence[int], book: Book, streaks: Streaks) -> Played:
        for run in runs:
            while streaks.finish(run, self._play_one(run, int(book.episode[run]))):
                pass
        return streaks.played()

    def _play_one(self, run: int, episode: int) -> Trajectory:
        recording = self._new_recording(self._world.max_steps, 1)
        stream = stream_of_seed(episode_seed(self._keys[run], episode))
        length, _, terminated = play_episode(self._world, self._tables, run, episode, stream, recording, 0, 0, True)
        return Trajectory(
            observation=recording.observation[: length + 1],
            action=recording.action[:length],
            reward=self._world.reward_value[recording.reward_code[:length]],
            terminated=bool(terminated),
            probability=recording.probability[:length] if self._with_probability else None,
        )

    def _bytes_per_step(self) -> int:
        return sum(column[:1].nbytes for column in self._new_recording(1, 0))

    def _room(self, most: NDArray[np.int64], bytes_per_step: int) -> int:
        """Steps of a streak that is recorded; the last episode may go beyond its limits."""
        if bytes_per_step == 0:
            return 0
        return int(min(most[1], most[2] // bytes_per_step + 1)) + self._world.max_steps

    def _new_recording(self, steps: int, episodes: int) -> TrajectoryRoom:
        return TrajectoryRoom(
            np.empty(steps + episodes, dtype=self._observation_type),
            np.empty(steps, dtype=np.min_scalar_type(self._tables.value.shape[2] - 1)),
            np.empty(steps, dtype=self._world.reward_code.dtype),
            np.empty((steps if self._with_probability else 0, self._tables.value.shape[2])),
        )


def _played(
    recording: TrajectoryRoom, reward_value: NDArray[np.float64], episodes: Episodes, *, record: bool
) -> Played:
    batch = None
    if record:
        steps = int(episodes.length.sum())
        batch = TrajectoryBatch(
            episodes=episodes,
            observation=recording.observation[: steps + len(episodes.run)],
            action=recording.action[:steps],
            reward_code=recording.reward_code[:steps],
            reward_value=reward_value,
            probability=recording.probability[:steps] if len(recording.probability) else None,
        )
    return Played(episodes, batch, not_finite_failures(episodes))
