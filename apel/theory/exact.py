"""The exact distribution of the crossing time, for short horizons: every reachable state with its probability.

After the switch only the old best (c₀), the new best (c₁) and whether the new best was selected yet matter: all others
stay at 1 and are selected with probability (n − 2) / Σc, so that any n is as small as 2. States whose values are the
same floating-point numbers are merged, which the floor at 1 makes frequent; nothing is rounded and nothing is dropped.

**Exactness ends** where the number of states, which grows exponentially, would exceed ``max_states``: an error says
so. For two learners and ν ≥ 0.08 the floor holds the number down, and the whole distribution is within reach; for more
learners or a smaller ν it is about the first 20 episodes, and `apel.theory.adaptation` simulates the rest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from apel.theory.selection_aware import steady_state_concentration

Floats = NDArray[np.float64]


def crossing_distribution(nu: float, num_learners: int, horizon: int, max_states: int = 1_000_000) -> Floats:
    """P(T ≤ k) for k = 0, …, horizon; T is the first episode after the switch with c₁ ≥ c₀.

    The switch comes at the steady state of the mean field, c₀ = c* and all others at 1. Exact but for the rounding of
    floating-point sums.

    Parameters
    ----------
    nu:
        ν in (0, 1).
    num_learners:
        n ≥ 2.
    horizon:
        Episodes; 0 or more.
    max_states:
        Bound on the number of states, and so on memory.

    Returns
    -------
    ``float64[horizon + 1]``, never falling.

    Raises
    ------
    ValueError
        If an argument is out of range, or there are more states than allowed.

    >>> crossing_distribution(0.25, 2, 3).round(6).tolist()
    [0.0, 0.333333, 0.333333, 0.429864]
    """
    old_best = steady_state_concentration(nu, num_learners)
    # Columns: old best, new best, discovered (0 or 1), probability.
    states = np.array([[old_best, 1.0, 0.0, 1.0]])
    crossed = np.empty(horizon + 1)
    total = 0.0
    for k in range(horizon + 1):
        if k:
            states = _merged(_successors(states, nu, num_learners))
        done = states[:, 1] >= states[:, 0]
        total += states[done, 3].sum()
        crossed[k] = total
        states = states[~done]
        if len(states) > max_states:
            message = f"horizon: found {len(states)} states after {k} episodes, expected at most {max_states}"
            raise ValueError(message)
    return crossed


def _successors(states: Floats, nu: float, num_learners: int) -> Floats:
    """What each of three selections leads to: the old best, the new best, one of the others."""
    old_best, new_best, discovered, probability = states.T
    total = old_best + new_best + (num_learners - 2)
    gain = 1.0 - discovered  # the old best gains as long as it is not known to be second
    cases = [
        (old_best + gain, new_best, discovered, probability * old_best / total),
        (old_best, new_best + 1.0, np.ones_like(discovered), probability * new_best / total),
    ]
    if num_learners > 2:
        cases.append((old_best, new_best, discovered, probability * (num_learners - 2) / total))
    after = np.concatenate([np.stack(case, axis=1) for case in cases])
    after[:, :2] = np.maximum(after[:, :2] * (1.0 - nu), 1.0)
    return after


def _merged(states: Floats) -> Floats:
    """Equal states as one, with the sum of their probabilities."""
    order = np.lexsort(states[:, :3].T)
    states = states[order]
    first = np.ones(len(states), dtype=bool)
    first[1:] = (states[1:, :3] != states[:-1, :3]).any(axis=1)
    merged = states[first]
    if len(merged):
        merged[:, 3] = np.add.reduceat(states[:, 3], np.flatnonzero(first))
    return merged
