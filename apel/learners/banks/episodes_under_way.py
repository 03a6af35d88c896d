"""Episodes while they are played, step by step."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.batched_environment import Runs, Stepped
from apel.experience.action_form import ActionForm
from apel.experience.trajectory import Trajectory


@dataclass
class _Episode:
    """What has happened so far: an entry more than there are steps, and one element each per step."""

    entries: list[NDArray[Any]]
    actions: list[Any] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    probabilities: list[NDArray[np.float64]] = field(default_factory=list)

    def trajectory(self, form: ActionForm, *, terminated: bool) -> Trajectory:
        # Whoever learns from it is told all probabilities or none.
        probability = np.array(self.probabilities)
        return Trajectory(
            observation=np.array(self.entries),
            action=form.column(self.actions),
            reward=np.array(self.rewards, dtype=np.float64),
            terminated=terminated,
            probability=None if np.isnan(probability).any() else probability,
        )


class EpisodesUnderWay:
    """The episode that each of several runs is in, with actions of a form; with ``keeps_entries`` trajectories are
    wanted whole.
    """

    def __init__(self, form: ActionForm, *, keeps_entries: bool) -> None:
        self._form = form
        self._keeps_entries = keeps_entries
        self._open: dict[int, _Episode] = {}

    def begin(self, runs: Runs, entries: NDArray[Any]) -> None:
        """An episode of each of ``runs`` has begun."""
        for run, entry in zip(runs.tolist(), entries, strict=True):
            self._open[run] = _Episode([entry] if self._keeps_entries else [])

    def note(self, runs: Runs, action: NDArray[Any], stepped: Stepped, probability: NDArray[np.float64]) -> None:
        """Each of ``runs`` has made a step, with one of the environment's own actions."""
        columns = (runs.tolist(), self._form.rows(action), stepped.reward.tolist(), stepped.entry, probability)
        for run, one_action, reward, entry, distribution in zip(*columns, strict=True):
            episode = self._open[run]
            episode.actions.append(one_action)
            episode.rewards.append(reward)
            if self._keeps_entries:
                episode.entries.append(entry)
                episode.probabilities.append(distribution)

    def finish(self, run: int, *, terminated: bool) -> Trajectory:
        """The run's episode is over."""
        return self._open.pop(run).trajectory(self._form, terminated=terminated)

    def forget(self, run: int) -> None:
        """The run's episode is lost, if it is in one."""
        self._open.pop(run, None)
