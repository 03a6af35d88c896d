"""Any environments as one, one after the other: the border that whatever users' environments say has to cross."""

from __future__ import annotations

import copy
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from apel.configs import ObservationRule
from apel.dynamics.batched_environment import ENVIRONMENTS, Runs, Stepped
from apel.dynamics.finite_model import observations_of
from apel.environments import outcomes
from apel.environments.carried_state import Carried, State, Tape
from apel.environments.layers import is_known
from apel.experience.action_form import ActionForm
from apel.experience.channels import EntryForm, form_of
from apel.experience.observation_form import BorderError, ObservationForm
from apel.run.user_code import fault_of

_Outcome = tuple[Any, float, bool, bool]
"""Observation, reward, terminated, truncated of one environment."""
_CHECK_SECONDS = 5.0


class ObservationWarning(UserWarning):
    """An observation lies outside of its space, and the experiment says that this is no error."""


class EnvironmentList:
    """Any environments, one after the other.

    Entries are raw observations in the form of their space, or, of finite environments of one kind, state numbers. They
    are copied once, here, so that an environment may write its next observation into the same array. What one raises,
    or says that is not what it declares, ends nothing but its own step: it is reported in `Stepped.errors`.

    Parameters
    ----------
    environments:
        Of every run.
    feature_sizes:
        How many values each variable of an observation has; None where entries are to be raw observations.
    observations:
        What is done with an observation outside of its space.

    Attributes
    ----------
    actions:
        The form of those of the first; of Discrete ones the others may begin elsewhere, of Boxes the bounds may differ.
    is_taped:
        Whether some environment may carry over more than is known of it, see `apel.environments.carried_state`.
    """

    def __init__(
        self,
        environments: Sequence[gymnasium.Env[Any, Any]],
        feature_sizes: Sequence[int] | None = None,
        observations: ObservationRule = "check",
    ) -> None:
        self._environments = environments
        # Of one shape and type, since their entries stand side by side; bounds may differ from run to run.
        spaces = [one.observation_space for one in environments]
        distinct = [space for i, space in enumerate(spaces) if spaces.index(space) == i]
        self._forms = [form_of(space) for space in distinct]
        self._form_of_run = np.array([distinct.index(space) for space in spaces])
        self._sizes = None if feature_sizes is None else tuple(feature_sizes)
        self._actions = [ActionForm(one.action_space) for one in environments]
        self.actions = self._actions[0]
        self._is_checked = not all(is_known(one) for one in environments)
        self._warns, self._warned = observations == "warn", set[int]()
        self._carried = [Carried(one) for one in environments]
        self.is_taped = any(one.is_taped for one in self._carried)
        self._taping: dict[int, Tape] = {}
        self._step = np.zeros(len(environments), dtype=np.int64)

    def reset(self, runs: Runs, seeds: Sequence[int]) -> Stepped:
        """Start an episode of each run with its seed."""
        self._step[runs] = 0
        plain = [int(seed) for seed in seeds]
        if not self.is_taped:
            return self._call(_reset, runs, plain)
        tapes = [self._begun(run, seed) for run, seed in zip(runs.tolist(), plain, strict=True)]
        started = self._call(_reset, runs, plain)
        for entry, tape in zip(started.entry, tapes, strict=True):
            tape.begin(entry)
        return started

    def step(self, runs: Runs, actions: NDArray[Any]) -> Stepped:
        """Play one action (`apel.experience.action_form`) in each run."""
        self._step[runs] += 1
        stepped = self._call(outcomes.step, runs, self._own(runs, actions))
        if self._taping:
            self._keep(runs, self._own(runs, actions), stepped)
        return stepped

    def decode(self, entries: NDArray[Any]) -> NDArray[Any]:
        """The raw observations ``[…, features]``, or ``[…]`` where there is only one feature."""
        return entries if self._sizes is None else observations_of(entries, self._sizes)

    def state(self) -> State:
        """What the environments carry over from one episode to the next."""
        return {ENVIRONMENTS: [one.state() for one in self._carried]}

    def restore(self, state: State) -> None:
        """Go back to what `state` returned, with environments that have just been made.

        Raises
        ------
        CarriedStateError
            If one of them does not go on as the one whose state it was.
        """
        began = time.monotonic()
        for run, (carried, stored) in enumerate(zip(self._carried, state[ENVIRONMENTS], strict=True)):
            if time.monotonic() - began < _CHECK_SECONDS:
                carried.check(stored, partial(self._replayed, run))
            carried.restore(stored)
        self._taping.clear()

    def _own(self, runs: Runs, actions: NDArray[Any]) -> list[Any]:
        """The environments' own actions, which these may do with as they like."""
        if not self.actions.is_discrete:
            return self.actions.rows(actions)
        return [self._actions[run].first + action for run, action in zip(runs.tolist(), actions.tolist(), strict=True)]

    def _encoded(self, observations: NDArray[Any]) -> NDArray[Any]:
        if self._sizes is None or len(self._sizes) == 1:
            return observations
        return np.ravel_multi_index(tuple(observations.T), self._sizes)

    def _call(self, function: Callable[[Any, Any], _Outcome], runs: Runs, arguments: Iterable[Any]) -> Stepped:
        count, form = len(runs), self._forms[0]
        entry = np.zeros((count, *form.shape), dtype=form.dtype)
        reward, terminated, truncated = [0.0] * count, [False] * count, [False] * count
        errors: dict[int, BaseException] = {}
        for position, (run, argument) in enumerate(zip(runs.tolist(), arguments, strict=True)):
            try:
                observation, paid, ends, cut = function(self._environments[run], argument)
                form.write(observation, entry, position)
                reward[position], terminated[position], truncated[position] = paid, ends, cut
            except BorderError as error:
                errors[position] = fault_of("environment", self._placed(run, error))
            except BaseException as error:  # noqa: BLE001 - it ends this run, and only this one
                errors[position] = fault_of("environment", error)
        if self._is_checked:
            self._check(runs, entry, terminated, errors)
        for position in errors:
            entry[position] = np.zeros((), dtype=form.dtype)
            reward[position], terminated[position], truncated[position] = 0.0, False, False
        return Stepped(self._encoded(entry), np.array(reward), np.array(terminated), np.array(truncated), errors)

    def _check(
        self, runs: Runs, entries: NDArray[Any], terminated: Sequence[bool], errors: dict[int, BaseException]
    ) -> None:
        """Observations outside of their space are errors, or are told of once a run."""
        for position, form in self._outside(runs, entries, terminated):
            run = int(runs[position])
            if position in errors or (self._warns and run in self._warned):
                continue
            error = self._placed(run, form.error_of(entries[position]))
            if self._warns:
                self._warned.add(run)
                warnings.warn(f"run {run} of its shard, {error}", ObservationWarning, stacklevel=2)
            else:
                errors[position] = fault_of("environment", error)

    def _outside(
        self, runs: Runs, entries: NDArray[Any], terminated: Sequence[bool]
    ) -> Iterator[tuple[int, ObservationForm | EntryForm]]:
        """Positions of observations outside of their space, and its form."""
        if len(self._forms) == 1:
            form = self._forms[0]
            yield from ((position, form) for position in form.outside(entries, terminal=terminated).tolist())
            return
        for position, kind in enumerate(self._form_of_run[runs].tolist()):
            form = self._forms[kind]
            if len(form.outside(entries[position : position + 1], terminal=terminated[position : position + 1])):
                yield position, form

    def _placed(self, run: int, error: Exception) -> ValueError:
        """With the step of the episode."""
        step = int(self._step[run])
        placed = ValueError(f"{f'step {step}' if step else 'reset'}: {error}")
        placed.__cause__ = error
        return placed

    def _replayed(self, run: int, seed: int, actions: Sequence[Any]) -> str:
        """The digest of an episode's beginning, played again."""
        runs, tape = np.array([run], dtype=np.int64), self._begun(run, seed)
        tape.begin(self._call(_reset, runs, [seed]).entry[0])
        for action in actions:
            self._keep(runs, [action], self._call(outcomes.step, runs, [copy.copy(action)]))
        return tape.digest

    def _begun(self, run: int, seed: int) -> Tape:
        """The tape of an episode that begins."""
        tape = self._taping[run] = self._carried[run].begin(seed)
        return tape

    def _keep(self, runs: Runs, actions: Sequence[Any], stepped: Stepped) -> None:
        """A step of those runs whose tapes are not full."""
        columns = (stepped.entry, stepped.reward.tolist(), stepped.terminated.tolist(), stepped.truncated.tolist())
        for run, action, *answer in zip(runs.tolist(), actions, *columns, strict=True):
            tape = self._taping.get(run)
            if tape is None:
                continue
            tape.add(action, *answer)
            if tape.is_full:
                del self._taping[run]


def _reset(environment: gymnasium.Env[Any, Any], seed: int) -> _Outcome:
    observation, _ = outcomes.reset(environment, seed)
    return observation, 0.0, False, False
