"""Algorithm 5 for one run in one process: the readable statement of what this project does, and its API for a script.

Everything faster (shards of many runs, compiled streaks, `cluster`) gives the same rows as this loop; tests hold them
against it. Of environments alone that carry something from episode to episode there is one here, and one for each
learner in a job.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from apel.agents import Agent
from apel.agents.content import TrainedLearner
from apel.agents.making import selector_config, trained_agent
from apel.building import bank_of_learners, make_learner, make_performance
from apel.configs import EnvironmentConfig, LearnerConfig
from apel.environments import World, environment_list
from apel.learners.base import StreakLimit
from apel.learners.starts import begin_bank
from apel.run.criterion import Criterion
from apel.run.floor import ActingFloor
from apel.run.opening import open_book
from apel.run.rule import SelectionRule, as_selector
from apel.run.selection import Selector, common_blocks, freezes_policies
from apel.run.state import RUNNING

_ONE_EPISODE = StreakLimit(episodes=1, steps=1)


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
    acting_floor:
        The least share of the steps that each learner plays, whatever the selector thinks.

    Attributes
    ----------
    learners:
        The learners themselves.
    """

    def __init__(
        self,
        world: World,
        learners: Sequence[LearnerConfig],
        selector: Selector | SelectionRule,
        seed: int,
        num_episodes: int,
        *,
        performance: str = "return",
        criterion: Criterion | None = None,
        acting_floor: ActingFloor | None = None,
    ) -> None:
        self.selector = as_selector(selector)
        freezes, evaluates = freezes_policies(self.selector), criterion is not None and criterion.evaluation == "greedy"
        made = [
            make_learner(config, world, seed, i, freezes=freezes, evaluates=evaluates)
            for i, config in enumerate(learners)
        ]
        self.learners = [learner for learner, _ in made]
        self._learns_from_others = [config.learns_from != "own" for config in learners]
        environment, measure = environment_list([world]), make_performance(performance)
        self._banks = [
            bank_of_learners([one], environment, [world], measure, freezes=freezes, raises=True) for one in made
        ]
        for bank, config in zip(self._banks, learners, strict=True):
            begin_bank(bank, [config], [world.spaces])
        self._world, self._configs, self._seed = world, tuple(learners), seed
        self._book = open_book(
            self.selector,
            len(learners),
            num_episodes,
            criterion,
            [seed],
            [world.info],
            acting_floor=acting_floor,
        )

    @property
    def train_time(self) -> int | None:
        """Episodes until the criterion held, or None as long as it has not."""
        time = int(self._book.train_time[0])
        return time if time >= 0 else None

    def agent(self, environment: EnvironmentConfig, names: Sequence[str] = ()) -> Agent:
        """What it has come to so far, in the hand: to act, to be evaluated, and to be saved.

        Parameters
        ----------
        environment:
            What its world was made from.
        names:
            Of the learners; without any they are numbered.
        """
        given = list(names) or [f"learner {i}" for i in range(len(self.learners))]
        columns = zip(given, self._configs, self.learners, strict=True)
        learners = [TrainedLearner(name, config, learner.state()) for name, config, learner in columns]
        parts = (environment, self._world, learners, selector_config(self.selector), self._book, 0)
        return Agent(trained_agent(*parts, {"seed": self._seed}), trust=True)

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
        book, selector, selected = self._book, self.selector, int(self._book.learner[0])
        probability, estimate, concentration = common_blocks(book.selector_state[0].copy(), len(self._banks))

        # The selected learner generates a trajectory, learning while it acts. Its performance becomes its estimate; the
        # selector adjusts itself, and selects for the next episode: that is what `play` does to the book.
        record = len(self._banks) > 1
        played = self._banks[selected].play([0], book, selector, selected, _ONE_EPISODE, record=record)
        for failure in played.failures:
            raise ValueError(failure.error)

        # All others train on the trajectory, but for those that learn from their own alone.
        for index, bank in enumerate(self._banks):
            if index == selected or played.batch is None:
                continue
            if self._learns_from_others[index]:
                bank.learn(played.batch)
            else:
                bank.skip(played.batch.episodes)
        episode, length = int(played.episodes.episode[0]), int(played.episodes.length[0])
        episode_return = float(played.episodes.episode_return[0])
        return EpisodeRecord(episode, selected, episode_return, length, probability, concentration, estimate)
