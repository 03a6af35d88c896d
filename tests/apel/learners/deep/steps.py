"""Transitions for memories and stacked learners, as plain numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from apel.dynamics.batched_environment import Runs
from apel.learners.banks.batched_learner import Transitions


def runs_of(*runs: int) -> Runs:
    """Positions in the shard."""
    return np.array(runs, dtype=np.int64)


def transitions(
    observation: Any,
    next_observation: Any,
    *,
    action: Any = 0,
    reward: Any = 0.0,
    terminated: Any = False,
    truncated: Any = False,
    probability: Any = None,
    num_actions: int = 3,
) -> Transitions:
    """A step of each of A runs; what is given once holds for all of them."""
    seen = np.asarray(observation)
    count = len(seen)
    known = np.full((count, num_actions), np.nan) if probability is None else np.asarray(probability, dtype=np.float64)
    return Transitions(
        observation=seen,
        action=np.broadcast_to(np.asarray(action, dtype=np.int64), count).copy(),
        reward=np.broadcast_to(np.asarray(reward, dtype=np.float64), count).copy(),
        next_observation=np.asarray(next_observation),
        terminated=np.broadcast_to(np.asarray(terminated, dtype=np.bool_), count).copy(),
        truncated=np.broadcast_to(np.asarray(truncated, dtype=np.bool_), count).copy(),
        probability=np.broadcast_to(known, (count, known.shape[-1])).copy(),
    )
