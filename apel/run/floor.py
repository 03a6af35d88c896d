"""A floor under acting: whatever a selector thinks of them, all learners play some of the steps.

A learner that only watches others does not become what it would be by itself (Ostrovski, Castro & Dabney 2021, arXiv
2110.14020); its own episodes help. With a floor of ρ the selector's probabilities p become p ← (1 − Σφ) p + φ, where
φ_i = ρ for episodes of equal lengths, so p ← (1 − nρ) p + ρ. It is *steps* that a learner learns from, and episodes of
different learners differ in length; hence

    φ_i = (ρ Λ + max(0, ρ T − S_i) / H) / L_i,

with the mean lengths L_i of the learner's episodes and Λ of all, both weighted towards the latest, T the steps played
since there is a floor and S_i the learner's own of these: where lengths change faster than their means, what it lacks
is made up for within the next H episodes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as checked_dataclass

from apel.numerics.compiled import njit
from apel.numerics.streams import Stream, categorical, uniform

_NEWEST = 0.05
"""Weight of the latest length in a mean."""
_MAKE_UP_EPISODES = 20.0
"""H."""


@checked_dataclass(frozen=True, config=ConfigDict(extra="forbid", allow_inf_nan=False))
class ActingFloor:
    """The least share of a run's environment steps that each learner of an ensemble plays.

    Attributes
    ----------
    steps:
        ρ, at most 1 / learners.
    after:
        Environment steps of the run before there is a floor: while a learner still acts at random, its own episodes
        cost much and teach it little.
    """

    steps: float = Field(gt=0.0, le=1.0, strict=True)
    after: int = Field(default=0, ge=0, le=10**15, strict=True)


@njit
def under_floor(
    floor: float,
    selected: int,
    steps: NDArray[np.int64],
    length: NDArray[np.float64],
    probability: NDArray[np.float64],
    stream: Stream,
) -> int:
    """Who plays the coming episode where the selector has chosen ``selected``.

    ``steps`` (``[n]``) is what each learner has played; ``length`` (``[n + 1]``) its mean length of an episode, and
    that of all at the end, 0 as long as there is none. ``probability`` (``[n]``) is changed in place to what it really
    is.
    """
    count = probability.shape[0]
    share = np.empty(count)
    played, total, mean = steps.sum(), 0.0, length[count]
    for i in range(count):
        share[i] = floor
        if mean > 0.0:
            lacking = max(0.0, floor * played - steps[i]) / _MAKE_UP_EPISODES
            share[i] = (floor * mean + lacking) / (length[i] if length[i] > 0.0 else mean)
        total += share[i]
    for i in range(count):
        share[i] /= total
    total = min(total, 1.0)
    for i in range(count):
        probability[i] = (1.0 - total) * probability[i] + total * share[i]
    return selected if uniform(stream) >= total else categorical(stream, share)


@njit
def take_in_length(learner: int, episode_length: int, length: NDArray[np.float64]) -> None:
    """Count an episode of ``learner`` in ``length``, in place."""
    for place in (learner, length.shape[0] - 1):
        weight = _NEWEST if length[place] > 0.0 else 1.0
        length[place] += weight * (episode_length - length[place])
