"""What is broadcast: the transitions of one episode, and the episodes of many runs as plain arrays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Trajectory:
    """The transitions of one episode of T steps.

    Attributes
    ----------
    observation:
        ``[T + 1, …]``: the raw observations, the last one included.
    action:
        ``[T, …]``: the environment's own, see `apel.experience.action_form`.
    reward:
        ``float64[T]``.
    terminated:
        Whether the environment ended the episode; False where it was truncated.
    probability:
        ``float64[T, actions]``: the behaviour policy's μ(·|s) at each step, or None where no learner asked for it; of
        actions that are not Discrete, ``float64[T, 1]``: the density, or the probability, of the one that was taken.
    """

    observation: NDArray[Any]
    action: NDArray[Any]
    reward: NDArray[np.float64]
    terminated: bool
    probability: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        """Number of steps."""
        return len(self.action)

    @property
    def nbytes(self) -> int:
        """Bytes of all columns."""
        known = 0 if self.probability is None else self.probability.nbytes
        return self.observation.nbytes + self.action.nbytes + self.reward.nbytes + known

    @property
    def undiscounted_return(self) -> float:
        """Sum of the rewards, added one by one.

        Compiled code adds them so; `sum` compensates rounding errors since Python 3.12, and NumPy adds in pairs.
        """
        total = 0.0
        for reward in self.reward.tolist():
            total += reward
        return total


class Episodes(NamedTuple):
    """What there is to say of E episodes in a few numbers each; those of one run stand in the order of play.

    ``performance`` is what the selector compares, ``measure`` what the criterion measures; ``terminated`` is False
    where an episode was truncated.
    """

    run: NDArray[np.int64]
    """Position of the run in its shard."""
    episode: NDArray[np.int64]
    """Index on the run's clock."""
    length: NDArray[np.int64]
    """Number of steps."""
    episode_return: NDArray[np.float64]
    performance: NDArray[np.float64]
    measure: NDArray[np.float64]
    terminated: NDArray[np.bool_]

    @classmethod
    def empty(cls, room: int) -> Episodes:
        """Columns with uninitialised room for ``room`` episodes."""
        whole = [np.empty(room, dtype=np.int64) for _ in range(3)]
        real = [np.empty(room) for _ in range(3)]
        return cls(whole[0], whole[1], whole[2], real[0], real[1], real[2], np.empty(room, dtype=np.bool_))

    def first(self, count: int) -> Episodes:
        """The first ``count`` episodes, as views."""
        return Episodes._make(column[:count] for column in self)

    def read_only(self) -> Episodes:
        """The same columns, as views that cannot be written to."""
        return Episodes._make(_read_only(column) for column in self)


@dataclass(frozen=True)
class TrajectoryBatch:
    """Episodes of several runs with all their steps, as ragged columns: E episodes with N steps in all.

    Arrays travel between processes without copies, and arrive read-only. They are read-only views from the beginning,
    so that a batch is the same within a process: what learns from it is compiled once, not for both kinds.

    Attributes
    ----------
    episodes:
        One row per episode.
    observation:
        ``[N + E, …]``: each episode's ``length + 1`` observations; for finite environments their state numbers.
    action:
        ``[N, …]``.
    reward_code:
        ``[N]``: positions in ``reward_value``. The rewards of most environments take few values; as codes they are an
        eighth of the bytes.
    reward_value:
        ``float64[values]``.
    probability:
        ``float64[N, actions]``, ``float64[N, 1]`` or None, see `Trajectory`; NaN in the steps of episodes in which it
        is not known.
    """

    episodes: Episodes
    observation: NDArray[Any]
    action: NDArray[Any]
    reward_code: NDArray[Any]
    reward_value: NDArray[np.float64]
    probability: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        """Make the columns read-only."""
        object.__setattr__(self, "episodes", self.episodes.read_only())
        for name in ("observation", "action", "reward_code", "reward_value", "probability"):
            if (column := getattr(self, name)) is not None:
                object.__setattr__(self, name, _read_only(column))

    def trajectories(self) -> Iterator[tuple[int, int, Trajectory]]:
        """``(run, episode, trajectory)`` for every episode, as views."""
        step = 0
        columns = (self.episodes.run, self.episodes.episode, self.episodes.length, self.episodes.terminated)
        for position, (run, episode, length, terminated) in enumerate(zip(*map(_list, columns), strict=True)):
            steps = slice(step, step + length)
            known = None if self.probability is None else self.probability[steps]
            trajectory = Trajectory(
                observation=self.observation[step + position : step + length + position + 1],
                action=self.action[steps],
                reward=self.reward_value[self.reward_code[steps]],
                terminated=terminated,
                probability=None if known is None or np.isnan(known[0]).any() else known,
            )
            yield run, episode, trajectory
            step += length

    @property
    def nbytes(self) -> int:
        """Bytes of all columns."""
        columns = [*self.episodes, self.observation, self.action, self.reward_code, self.reward_value, self.probability]
        return sum(column.nbytes for column in columns if column is not None)


def batch_of(episodes: Episodes, trajectories: Sequence[Trajectory]) -> TrajectoryBatch:
    """The batch of at least one trajectory, with a row of ``episodes`` for each."""
    value, code = np.unique(np.concatenate([t.reward for t in trajectories]), return_inverse=True)
    return TrajectoryBatch(
        episodes=episodes,
        observation=np.concatenate([t.observation for t in trajectories]),
        action=np.concatenate([t.action for t in trajectories]),
        reward_code=code.astype(np.min_scalar_type(len(value))),
        reward_value=value,
        probability=_probabilities(trajectories),
    )


def _probabilities(trajectories: Sequence[Trajectory]) -> NDArray[np.float64] | None:
    """What is known of one episode is known whatever other episodes, of other runs too, are in the batch."""
    known = next((t.probability for t in trajectories if t.probability is not None), None)
    if known is None:
        return None
    unknown = np.full(known.shape[1], np.nan)
    rows = (np.tile(unknown, (len(t), 1)) if t.probability is None else t.probability for t in trajectories)
    return np.concatenate(list(rows))


def _read_only(column: NDArray[Any]) -> NDArray[Any]:
    view = column.view()
    view.flags.writeable = False
    return view


def _list(column: NDArray[Any]) -> list[Any]:
    values: list[Any] = column.tolist()
    return values
