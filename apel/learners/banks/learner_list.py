"""A list of plain learners, one per run, as one batched learner: the mirror of a list of environments
(`apel.environments.batched.EnvironmentList`).
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.dynamics.batched_environment import Runs
from apel.experience.action_form import ActionForm
from apel.learners.answers import action_of, action_values_of, mu_of, pair_of
from apel.learners.banks.batched_learner import Transitions
from apel.learners.base import Freezable, HasActionValues, HasGreedyAction, Learner, State, Transition
from apel.run.user_code import fault_of


class LearnerList:
    """Any learners, one after the other.

    What a learner raises concerns its own run alone: it is reported in `errors`.

    Parameters
    ----------
    learners:
        Of every run.
    action_spaces:
        Those of their environments.
    """

    off_policy: ClassVar[bool] = True
    is_alone: ClassVar[bool] = True

    def __init__(self, learners: Sequence[Learner], action_spaces: Sequence[spaces.Space[Any]]) -> None:
        self.learners = list(learners)
        self.errors: dict[int, BaseException] = {}
        self._forms = [ActionForm(space) for space in action_spaces]

    def act(self, runs: Runs, observation: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.float64]]:
        """See `BatchedLearner`; probabilities that a learner does not know are NaN."""
        self.errors = {}
        actions, probability = self._forms[0].room(len(runs)), self._forms[0].unknown(len(runs))
        for position, (run, seen) in enumerate(zip(runs.tolist(), _rows(observation), strict=True)):
            try:
                action, known = pair_of(self.learners[run].act(seen))
                actions[position] = action_of(action, self._forms[run])
                if known is not None:
                    probability[position] = mu_of(known, self._forms[run])
            except BaseException as error:  # noqa: BLE001 - it ends this run, and only this one
                self.errors[run] = fault_of("learner", error)
        return actions, probability

    def learn(self, runs: Runs, transitions: Transitions) -> None:
        """See `BatchedLearner`; a learner is told no probabilities where one of them is NaN.

        A run may be named for several steps in turn; it learns no further than to the first that it fails at.
        """
        self.errors = {}
        columns: tuple[list[Any], ...] = (
            _rows(transitions.observation),
            self._own(runs, transitions.action),
            transitions.reward.tolist(),
            _rows(transitions.next_observation),
            transitions.terminated.tolist(),
            transitions.truncated.tolist(),
            self._forms[0].told(transitions.probability),
        )
        for run, step in zip(runs.tolist(), zip(*columns, strict=True), strict=True):
            if run not in self.errors:
                self._try(run, self.learners[run].learn, Transition(*step))

    def lag(self, runs: Runs) -> NDArray[np.int64]:
        """See `BatchedLearner`: nothing is won by waiting for each other."""
        return np.zeros(len(runs), dtype=np.int64)

    def end_episode(self, runs: Runs) -> None:
        """See `BatchedLearner`."""
        self.errors = {}
        for run in runs.tolist():
            self._try(run, self.learners[run].end_episode)

    def action_values(self, runs: Runs, observation: NDArray[Any]) -> NDArray[np.float64]:
        """See `BatchedLearner`; of learners that have them."""
        self.errors = {}
        values = np.zeros((len(runs), self._forms[0].width))
        for position, (run, seen) in enumerate(zip(runs.tolist(), _rows(observation), strict=True)):
            found = self._try(run, self._values, run, seen)
            if found is not None:
                values[position] = found
        return values

    def greedy_actions(self, runs: Runs, observation: NDArray[Any]) -> NDArray[Any]:
        """What they would do without exploring, as `act` gives it; of learners that can say."""
        self.errors = {}
        actions = self._forms[0].room(len(runs))
        for position, (run, seen) in enumerate(zip(runs.tolist(), _rows(observation), strict=True)):
            found = self._try(run, self._greedy_action, run, seen)
            if found is not None:
                actions[position] = found
        return actions

    def freeze(self, runs: Runs) -> None:
        """See `BatchedLearner`; of learners that can be frozen."""
        self.errors = {}
        for run in runs.tolist():
            self._try(run, cast("Freezable", self.learners[run]).freeze)

    def state(self) -> State:
        """The states of all learners; None of one that raises."""
        self.errors = {}
        return {"learners": [self._try(run, learner.state) for run, learner in enumerate(self.learners)]}

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        for learner, stored in zip(self.learners, state["learners"], strict=True):
            if stored is not None:
                learner.restore(stored)

    def _own(self, runs: Runs, actions: NDArray[Any]) -> list[Any]:
        """The actions that each learner knows."""
        if not self._forms[0].is_discrete:
            return self._forms[0].rows(actions)
        return [self._forms[run].first + action for run, action in zip(runs.tolist(), actions.tolist(), strict=True)]

    def _values(self, run: int, seen: Any) -> NDArray[np.float64]:
        learner = cast("HasActionValues", self.learners[run])
        return action_values_of(learner.action_values(seen), self._forms[run].width)

    def _greedy_action(self, run: int, seen: Any) -> Any:
        learner = self.learners[run]
        if isinstance(learner, HasGreedyAction):
            return action_of(learner.greedy_action(seen), self._forms[run])
        return self._values(run, seen).argmax()

    def _try(self, run: int, function: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return function(*arguments)
        except BaseException as error:  # noqa: BLE001 - it ends this run, and only this one
            self.errors[run] = fault_of("learner", error)
            return None


def _rows(seen: NDArray[Any]) -> list[Any]:
    """What each of A runs sees, ``[A, …]`` or ``object[A]``; single numbers as plain ones.

    Arrays are copies: what a learner writes into them is seen by nobody else, and not by itself at the next step.
    """
    if seen.dtype == object:
        return [row.item() if isinstance(row, np.number | np.bool_) else copy.deepcopy(row) for row in seen]
    return seen.tolist() if seen.ndim == 1 and seen.dtype.names is None else list(seen.copy())
