"""What is refused: arguments out of range, in one wording."""

from __future__ import annotations

import math
from collections.abc import Sequence


def require_decay(nu: float) -> None:
    """ν in (0, 1).

    Raises
    ------
    ValueError
        Otherwise. At ν = 0 concentrations grow without bound: there is no steady state.
    """
    if not 0.0 < nu < 1.0:
        message = f"nu: found {nu}, expected a number above 0 and below 1"
        raise ValueError(message)


def require_learners(num_learners: int) -> None:
    """Two learners or more.

    Raises
    ------
    ValueError
        Otherwise: with one there is nothing to select.
    """
    if num_learners < 2:
        message = f"num_learners: found {num_learners}, expected 2 or more"
        raise ValueError(message)


def require_positive(name: str, value: float) -> None:
    """A finite number above 0.

    Raises
    ------
    ValueError
        Otherwise.
    """
    if not 0.0 < value < math.inf:
        message = f"{name}: found {value}, expected a finite number above 0"
        raise ValueError(message)


def require_fraction(fraction: float) -> None:
    """A share of the steady state in (0, 1).

    Raises
    ------
    ValueError
        Otherwise: the steady state itself is approached and never reached.
    """
    if not 0.0 < fraction < 1.0:
        message = f"fraction: found {fraction}, expected a number above 0 and below 1"
        raise ValueError(message)


def require_exploration(exploration: float, num_learners: int) -> None:
    """A probability in (0, (n − 1)/n]: from never to as often as in a uniform choice.

    Raises
    ------
    ValueError
        Otherwise: no ν in (0, 1) makes APEL explore so much, or so little.
    """
    require_learners(num_learners)
    most = (num_learners - 1) / num_learners
    if not 0.0 < exploration <= most:
        message = f"exploration: found {exploration}, expected above 0 and at most (n - 1)/n = {most:.6g}"
        raise ValueError(message)


def require_selection_probability(probability: float, num_learners: int) -> None:
    """A probability of the best learner in [1/n, 1).

    Raises
    ------
    ValueError
        Otherwise: no ν in (0, 1) makes APEL select the best so rarely, or always.
    """
    require_learners(num_learners)
    least = 1 / num_learners
    if not least <= probability < 1.0:
        message = f"probability: found {probability}, expected at least 1/n = {least:.6g} and below 1"
        raise ValueError(message)


def require_returns(best_return: float, other_returns: Sequence[float]) -> None:
    """Finite returns of which ``best_return`` is strictly the highest.

    Raises
    ------
    ValueError
        Otherwise.
    """
    require_learners(1 + len(other_returns))
    if not all(map(math.isfinite, (best_return, *other_returns))):
        message = f"returns: found {best_return} and {list(other_returns)}, expected finite numbers"
        raise ValueError(message)
    if best_return <= max(other_returns):
        message = f"best_return: found {best_return}, expected above the others' highest, {max(other_returns)}"
        raise ValueError(message)


def require_performance(performance: float, best_return: float, other_returns: Sequence[float]) -> None:
    """A mean return from a uniform choice's up to, and without, the best learner's.

    Raises
    ------
    ValueError
        Otherwise: no ν in (0, 1) gives it.
    """
    require_returns(best_return, other_returns)
    uniform = (best_return + sum(other_returns)) / (1 + len(other_returns))
    if not uniform <= performance < best_return:
        message = (
            f"performance: found {performance}, expected at least {uniform:.6g}, which a uniform choice earns, "
            f"and below the best return, {best_return:.6g}"
        )
        raise ValueError(message)
