"""Q-learning for all runs of a shard, on any finite environment, in compiled loops."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from apel.book import Book, is_compiled
from apel.finite import FiniteModel, stack_models
from apel.learners.base import Failure, Performance, Played, State, StreakLimit
from apel.learners.q_learning import Decay, QLearningOptions, Switch
from apel.learners.streaks import not_finite_failures, play_streaks
from apel.learners.tabular_kernels import QTables, Recording, learn_episodes, play_compiled_streaks, play_episode
from apel.representations import Representation, state_rows
from apel.selection import Selector
from apel.streams import episode_seed, stream_of_seed
from apel.trajectory import Episodes, Trajectory, TrajectoryBatch

_NO_SWITCH = np.iinfo(np.int64).max


class TabularBank:
    """Q-learning for every run of a shard, on finite environments.

    Parameters
    ----------
    models:
        The environment of each run.
    environment_keys:
        One 64-bit key per run (`apel.streams.episode_seed`).
    options, representations:
        Those of each run's learner.
    seeds:
        64-bit seed of each run's learner.
    performance:
        How good an episode was.
    with_probability:
        Record μ(·|s) in the trajectories, for learners that need it.
    """

    def __init__(
        self,
        models: Sequence[FiniteModel],
        environment_keys: Sequence[int],
        options: Sequence[QLearningOptions],
        representations: Sequence[Representation],
        seeds: Sequence[int],
        performance: Performance,
        *,
        with_probability: bool,
    ) -> None:
        self._world = stack_models(models)
        self._keys = np.array(environment_keys, dtype=np.uint64)
        self._performance = performance
        self._with_probability = with_probability
        self._tables = _new_tables(models[0], options, representations, seeds)
        self._observation_type = np.uint16 if models[0].num_states <= np.iinfo(np.uint16).max else np.int32

    def play(
        self, runs: Sequence[int], book: Book, selector: Selector, me: int, limit: StreakLimit, *, record: bool
    ) -> Played:
        """See `LearnerBank`; a selector or a metric that is not compiled is asked after every episode."""
        if not is_compiled(selector) or callable(self._performance):
            return play_streaks(self._play_one, runs, book, selector, me, limit, self._performance, record=record)
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
        """Eq. 2.8 for every step of others' episodes."""
        learn_episodes(
            batch.episodes, batch.observation, batch.action, batch.reward_code, batch.reward_value, self._tables
        )
        return ()

    def state(self) -> State:
        """Tables, streams and clocks."""
        return {
            "value": self._tables.value.copy(),
            "stream": self._tables.stream.copy(),
            "steps": self._tables.steps.copy(),
        }

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        self._tables.value[:] = state["value"]
        self._tables.stream[:] = state["stream"]
        self._tables.steps[:] = state["steps"]

    def _play_one(self, run: int, episode: int) -> Trajectory:
        """One episode of one run, without the book."""
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


def _new_tables(
    model: FiniteModel,
    options: Sequence[QLearningOptions],
    representations: Sequence[Representation],
    seeds: Sequence[int],
) -> QTables:
    views = list(dict.fromkeys(representations))
    values = model.feature_values()
    rows = np.stack([state_rows(view, model.features, values) for view in views])
    explorations = [_exploration_columns(option) for option in options]
    return QTables(
        value=np.zeros((len(options), int(rows.max()) + 1, model.num_actions)),
        row=rows,
        row_set=np.array([views.index(representation) for representation in representations], dtype=np.int64),
        stream=np.array([stream_of_seed(seed) for seed in seeds], dtype=np.uint64),
        steps=np.zeros(len(options), dtype=np.int64),
        learning_rate=np.array([option.learning_rate for option in options]),
        discount=np.array([option.discount for option in options]),
        exploration=np.array([rates for rates, _, _ in explorations]),
        switch_episode=np.array([switch for _, switch, _ in explorations], dtype=np.int64),
        decay_steps=np.array([steps for _, _, steps in explorations]),
    )


def _exploration_columns(options: QLearningOptions) -> tuple[tuple[float, float], int, float]:
    match options.exploration:
        case Decay(start, end, steps):
            return (start, end), _NO_SWITCH, steps
        case Switch(before, episode, after):
            return (before, after), episode, 0.0
        case float(rate):
            return (rate, rate), _NO_SWITCH, 0.0


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
