"""Tabular learners for all runs of a shard, on any finite environment, in compiled loops."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from apel.book import Book, is_compiled
from apel.finite import FiniteModel, stack_models
from apel.learners.base import Failure, Performance, Played, State, StreakLimit
from apel.learners.streaks import not_finite_failures, play_streaks
from apel.learners.tabular_kernels import Recording, evaluate_episode, play_episode
from apel.learners.tabular_streaks import learn_episodes, play_compiled_streaks
from apel.learners.tabular_tables import TabularLearner, make_tables, restore_tables, tables_state
from apel.selection import Selector
from apel.streams import episode_seed, evaluation_seed, stream_of_seed
from apel.trajectory import Episodes, Trajectory, TrajectoryBatch


class TabularBank:
    """Q-learning, Dyna-Q, or a vote of several of them, for every run of a shard, on finite environments.

    Parameters
    ----------
    models:
        The environment of each run.
    environment_keys:
        One 64-bit key per run (`apel.streams.episode_seed`).
    learners:
        That of each run, all with the same number of members.
    performance:
        How good an episode was.
    with_probability:
        Record μ(·|s) in the trajectories, for learners that need it.
    freezes:
        Policies are frozen within each epoch (`apel.selection.Epochal`).
    """

    def __init__(
        self,
        models: Sequence[FiniteModel],
        environment_keys: Sequence[int],
        learners: Sequence[TabularLearner],
        performance: Performance,
        *,
        with_probability: bool,
        freezes: bool = False,
    ) -> None:
        self._world = stack_models(models)
        self._keys = np.array(environment_keys, dtype=np.uint64)
        self._performance = performance
        self._with_probability = with_probability
        self._tables = make_tables(models[0], learners, freezes=freezes)
        self._observation_type = models[0].state_type

    def play(
        self, runs: Sequence[int], book: Book, selector: Selector, me: int, limit: StreakLimit, *, record: bool
    ) -> Played:
        """See `LearnerBank`; a selector or a metric that is not compiled is asked after every episode."""
        if not is_compiled(selector) or callable(self._performance):
            return play_streaks(self, runs, book, selector, me, limit, self._performance, record=record)
        steps_per_run = max(limit.steps // len(runs), 1)
        max_episodes = min(limit.episodes, book.num_episodes)
        room = len(runs) * (steps_per_run + self._world.max_steps) if record else 0
        recording = self._new_recording(room, len(runs) * max_episodes)
        episodes = Episodes.empty(len(runs) * max_episodes)
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
            max_episodes,
            steps_per_run,
            record,
            recording,
            episodes,
        )
        return _played(recording, self._world.reward_value, episodes.first(count), record=record)

    def learn(self, batch: TrajectoryBatch) -> tuple[Failure, ...]:
        """Learn from every step of others' episodes."""
        learn_episodes(
            batch.episodes, batch.observation, batch.action, batch.reward_code, batch.reward_value, self._tables
        )
        return ()

    def state(self) -> State:
        """Tables, streams and clocks."""
        return tables_state(self._tables)

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        restore_tables(self._tables, state)

    def evaluate_one(self, run: int, episode: int) -> tuple[int, float]:
        """See `apel.learners.streaks.Player`."""
        stream = stream_of_seed(evaluation_seed(self._keys[run], episode))
        length, episode_return = evaluate_episode(self._world, self._tables, run, stream)
        return int(length), float(episode_return)

    def play_one(self, run: int, episode: int) -> Trajectory:
        """See `apel.learners.streaks.Player`."""
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

    def _new_recording(self, steps: int, episodes: int) -> Recording:
        return Recording(
            np.empty(steps + episodes, dtype=self._observation_type),
            np.empty(steps, dtype=np.min_scalar_type(self._tables.value.shape[2] - 1)),
            np.empty(steps, dtype=self._world.reward_code.dtype),
            np.empty((steps if self._with_probability else 0, self._tables.value.shape[2])),
        )


def _played(recording: Recording, reward_value: NDArray[np.float64], episodes: Episodes, *, record: bool) -> Played:
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
