"""Algorithm 5 for one run in one process: the readable statement of what this project does, and its API for a script.

Everything faster (`apel.learners.tabular_bank`, `cluster`) gives the same rows as this loop; tests hold them against
it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from apel.book import RUNNING, advance_run, open_book
from apel.building import make_member, make_performance
from apel.configs import LearnerConfig
from apel.environments import World
from apel.learners.streaks import criterion_measure, measure, not_finite_message
from apel.metrics import Criterion
from apel.selection import Selector, freezes_policies
from apel.streams import episode_seed, evaluation_seed
from apel.trajectory import Trajectory


@dataclass(frozen=True)
class EpisodeRecord:
    """One episode, as it stands in the result files.

    Attributes
    ----------
    episode:
        Its index, from 0.
    selected:
        Position of the learner that acted.
    episode_return:
        Undiscounted sum of rewards.
    length:
        Number of steps.
    probability, concentration, performance_estimate:
        ``float64[learners]``, as they stood when the learner was selected. The concentration is NaN for selectors
        that have none, an estimate is NaN for a learner that was never selected before.
    """

    episode: int
    selected: int
    episode_return: float
    length: int
    probability: NDArray[np.float64]
    concentration: NDArray[np.float64]
    performance_estimate: NDArray[np.float64]


class Ensemble:
    """Several learners on one task, of which one acts per episode and all learn (Algorithm 5).

    Parameters
    ----------
    world:
        The environment of the run, see `apel.make_world`.
    learners:
        What to build; each learner sees its own representation.
    selector:
        Who acts.
    seed:
        The run's seed: everything random follows from it.
    num_episodes:
        Episodes at most.
    performance:
        Name or import path of the measure that the selector compares.
    criterion:
        When the run counts as trained; it then stops.
    """

    def __init__(
        self,
        world: World,
        learners: Sequence[LearnerConfig],
        selector: Selector,
        seed: int,
        num_episodes: int,
        *,
        performance: str = "return",
        criterion: Criterion | None = None,
    ) -> None:
        freezes, evaluates = freezes_policies(selector), criterion is not None and criterion.evaluation == "greedy"
        self.members = [
            make_member(config, world, seed, i, freezes=freezes, evaluates=evaluates)
            for i, config in enumerate(learners)
        ]
        self.selector = selector
        self._world = world
        self._performance = make_performance(performance)
        self._book = open_book(selector, len(learners), num_episodes, criterion, [seed], [world.info])

    @property
    def train_time(self) -> int | None:
        """Episodes until the criterion held, or None as long as it has not."""
        time = int(self._book.train_time[0])
        return time if time >= 0 else None

    def run(self) -> Iterator[EpisodeRecord]:
        """Play episode after episode until the run is over."""
        while self._book.status[0] == RUNNING:
            yield self.run_episode()

    def run_episode(self) -> EpisodeRecord:
        """One pass through the loop of Algorithm 5.

        Raises
        ------
        ValueError
            If the performance is not a finite number.
        """
        episode, selected = int(self._book.episode[0]), int(self._book.learner[0])
        probability, estimate, concentration = (
            self._book.selector_state[0, : 3 * len(self.members)].reshape(3, -1).copy()
        )

        # The selected learner generates a trajectory, learning while it acts; then all others train on it.
        trajectory = self.play_one(0, episode)
        for index, member in enumerate(self.members):
            if index != selected:
                member.learn(trajectory, episode)

        # Its performance becomes its estimate; the selector adjusts itself and selects for the next episode.
        performance = measure(self._performance, trajectory)
        if not np.isfinite(performance):
            raise ValueError(not_finite_message(performance))
        episode_return = trajectory.undiscounted_return
        judged = criterion_measure(self._book, self, 0, trajectory)
        advance_run(self._book, self.selector, 0, len(trajectory), episode_return, performance, judged)
        return EpisodeRecord(episode, selected, episode_return, len(trajectory), probability, concentration, estimate)

    def play_one(self, run: int, episode: int) -> Trajectory:
        """One episode by the learner whose turn it is; ``run`` is 0, the only one."""
        seed = episode_seed(np.uint64(self._world.key), episode)
        return self.members[int(self._book.learner[run])].play(self._world.environment, seed, episode)

    def evaluate_one(self, run: int, episode: int) -> tuple[int, float]:
        """Length and return of an episode by the same learner, without exploring or learning."""
        seed = evaluation_seed(np.uint64(self._world.key), episode)
        return self.members[int(self._book.learner[run])].evaluate(self._world.environment, seed)
