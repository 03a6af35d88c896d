"""How late an ensemble notices that another learner has become the better one (Figure 4.6, §4.2.3).

Of two learners one is better early and the other late. Each is also played alone, with the seeds of the ensemble's
runs. In a run, with W the window (100 episodes, as in the text's "mean 100 episode reward"):

- The *curve* of an arm at environment step s is the mean return of the last W episodes that it has finished by s; of
  fewer at its beginning.
- The *crossover* s× is the first step from which on the late learner's curve is above the early one's, both alone,
  until the first of the two ends. Where it is not above there, there is none, and no delay is defined.
- The *switch* is the first episode of the ensemble from which on the late learner has at least half of the last W
  selections until the end. Where it has not at the end, the run is censored.
- The *delay* is the index of that episode minus e×, that of the episode under way at s×; in steps, its start minus s×.

The delay may be negative: in an ensemble a learner learns of other data than alone. Curve and share look W episodes
back. After a sudden change the share tells of it W / 2 episodes late, and the curves between 0 and W, so that a delay
within ± W / 2 is not told from none. Where the curves part slowly, noise makes them cross again and again, and the last
time is late: that lowers the delays of all ensembles of a run alike, and not the differences between them.

A censored run counts with the episodes (steps) that were left after s×, a lower bound, as do train times at their cap.

Everything here is of one run, and pure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jobs.analysis.statistics.bootstrap import Floats

NEVER = float("nan")
ROUNDING = 1e-9
"""What one curve is less above another one is none: sums of the same returns in another order differ as well."""


@dataclass(frozen=True)
class SwitchDelay:
    """When a run of an ensemble switched.

    Attributes
    ----------
    crossover_step:
        s×, in environment steps; NaN where the late learner is not above the early one in the end.
    episode_at_crossover:
        e×; NaN without a crossover. The number of the run's episodes where it was over by then.
    switch_episode, switch_step:
        Index of the episode, and the environment steps before it; NaN where it never switched.
    num_episodes, num_steps:
        Of the ensemble's run.
    """

    crossover_step: float
    episode_at_crossover: float
    switch_episode: float
    switch_step: float
    num_episodes: int
    num_steps: float

    @property
    def censored(self) -> bool:
        """Whether there was reason to switch, and the run did not."""
        return not np.isnan(self.crossover_step) and bool(np.isnan(self.switch_episode))

    @property
    def episodes(self) -> float:
        """The delay; of a censored run a lower bound; NaN without a crossover."""
        switch = self.num_episodes if self.censored else self.switch_episode
        return switch - self.episode_at_crossover

    @property
    def steps(self) -> float:
        """The delay in environment steps; likewise."""
        switch = max(self.num_steps, self.crossover_step) if self.censored else self.switch_step
        return switch - self.crossover_step


def first_of_last_stretch(holds: NDArray[np.bool_]) -> NDArray[np.int64]:
    """First place from which on ``bool[…, places]`` holds until the end; the number of places where it does not end so.

    >>> first_of_last_stretch(np.array([[True, False, True, True], [True, True, True, False]])).tolist()
    [2, 4]
    """
    is_otherwise = ~holds[..., ::-1]
    length = np.where(is_otherwise.any(axis=-1), np.argmax(is_otherwise, axis=-1), holds.shape[-1])
    return np.asarray(holds.shape[-1] - length, dtype=np.int64)


def crossover_step(early: Floats, early_ends: Floats, late: Floats, late_ends: Floats) -> float:
    """First step from which on the late curve is above the early one until the first of them ends; NaN if it is not.

    Parameters
    ----------
    early, late:
        ``float64[episodes]`` each, of as many episodes as the run has: values of the curves from the end of each
        episode to that of the next.
    early_ends, late_ends:
        ``float64[episodes]`` each, rising: environment steps at the end of each episode.
    """
    steps = np.union1d(early_ends, late_ends)
    steps = steps[(steps >= max(early_ends[0], late_ends[0])) & (steps <= min(early_ends[-1], late_ends[-1]))]
    if not len(steps):
        return NEVER
    at_early = early[np.searchsorted(early_ends, steps, side="right") - 1]
    at_late = late[np.searchsorted(late_ends, steps, side="right") - 1]
    is_above = at_late > at_early + ROUNDING * np.maximum(1.0, np.abs(at_early))
    place = int(first_of_last_stretch(is_above))
    return float(steps[place]) if place < len(steps) else NEVER


def switch_episode(is_late: NDArray[np.bool_], window: int) -> float:
    """First episode from which on at least half of the last ``window`` selections are the late learner's; NaN if never.

    At the beginning of the run, of as many as there are. ``is_late`` is ``bool[episodes]``.

    >>> switch_episode(np.array([False, False, False, True, True, True]), 4)
    4.0
    """
    number = np.cumsum(is_late, dtype=np.int64)
    number[window:] -= number[:-window].copy()
    total = np.minimum(np.arange(1, len(is_late) + 1), window)
    place = int(first_of_last_stretch(2 * number >= total))
    return float(place) if place < len(is_late) else NEVER


def switch_delay(crossover: float, is_late: NDArray[np.bool_], ends: Floats, window: int) -> SwitchDelay:
    """The switch of an ensemble's run, held against the crossover of its learners alone.

    Parameters
    ----------
    crossover:
        Of `crossover_step`; NaN if there is none.
    is_late:
        ``bool[episodes]``: the late learner was selected.
    ends:
        ``float64[episodes]``, rising: environment steps at the end of each episode of the ensemble.
    window:
        W, in episodes.
    """
    episode = switch_episode(is_late, window)
    starts = np.concatenate(([0.0], ends))
    under_way = NEVER if np.isnan(crossover) else float(np.searchsorted(ends, crossover, side="right"))
    step = NEVER if np.isnan(episode) else float(starts[int(episode)])
    return SwitchDelay(crossover, under_way, episode, step, len(ends), float(ends[-1]))
