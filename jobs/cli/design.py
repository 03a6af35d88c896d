"""ν from what is wanted of APEL: what ``apel design`` shows (§3.6, and beyond it).

One criterion is wanted; each of two theories answers with a ν of its own, and each says what to expect at both: the
dissertation's, and one in which only the selected learner can gain, simulated where noise or a floor is given. Pure.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from apel.theory import closed_forms, inverses, noisy, selection_aware, selection_aware_inverses
from apel.theory.ranges import require_performance, require_positive, require_returns
from jobs.experiment.yaml_source import SpecError

DISSERTATION = "dissertation"
SELECTION_AWARE = "selection-aware"
SIMULATED = "simulation"
_MAX_EPISODES, _MAX_LEARNERS, _MAX_SIMULATED, _MIN_DECAY = 50_000, 100, 20, 1e-5


@dataclass(frozen=True)
class Request:
    """What is wanted: exactly one of the first four; the returns are needed for ``performance`` only.

    Attributes
    ----------
    adapt_within, rise_within:
        Episodes.
    explore:
        Probability of any but the best learner at the steady state.
    performance:
        Mean return at the steady state.
    best_return, other_returns:
        Return of the best learner, and of each other one; a single one stands for all others.
    num_learners:
        n ≥ 2.
    win_probability:
        p: with which a performance of the best is above one of another learner.
    floor:
        ρ: the least share of the episodes of each learner.
    """

    adapt_within: float | None = None
    rise_within: float | None = None
    explore: float | None = None
    performance: float | None = None
    best_return: float | None = None
    other_returns: tuple[float, ...] = ()
    num_learners: int = 2
    win_probability: float = 1.0
    floor: float = 0.0

    @property
    def theories(self) -> tuple[str, str]:
        """The dissertation's, and the one to trust."""
        is_plain = self.win_probability == 1.0 and self.floor == 0.0
        return DISSERTATION, SELECTION_AWARE if is_plain else SIMULATED

    @property
    def ensemble(self) -> noisy.Noisy:
        """What is simulated.

        Raises
        ------
        SpecError
            If there is no such ensemble.
        """
        try:
            return noisy.Noisy(self.num_learners, self.win_probability, self.floor)
        except ValueError as error:
            name, _, rest = str(error).partition(":")
            message = f"--{name.replace('_', '-')}:{rest}"
            raise SpecError(message) from error


@dataclass(frozen=True)
class DecayPrediction:
    """What one theory expects of one ν: times in episodes, a probability, a mean return (None without returns)."""

    decay: float
    decay_by: str
    predicted_by: str
    adaptation_time: float
    rise_time: float
    exploration: float
    performance: float | None


def design(request: Request) -> list[DecayPrediction]:
    """Two values of ν, and two predictions for each: the dissertation's first.

    Raises
    ------
    SpecError
        If not exactly one criterion is wanted, if it cannot be met, or if the returns do not fit.

    >>> for row in design(Request(explore=0.05)):
    ...     print(f"{row.decay:.4f} {row.predicted_by} {row.exploration:.4f} {row.adaptation_time:.0f}")
    0.0500 dissertation 0.0500 13
    0.0500 selection-aware 0.0526 46
    0.0476 dissertation 0.0476 14
    0.0476 selection-aware 0.0500 49
    """
    option, value = _wanted(request)
    _check_size(option, value, request)
    others = _other_returns(request)
    try:
        theories = request.theories
        decays = {theory: _decay(theory, option, value, request, others) for theory in theories}
        for decay in decays.values():
            _require_decay(decay)
        return [
            _prediction(decays[found_by], found_by, theory, request, others)
            for found_by in theories
            for theory in theories
        ]
    except ValueError as error:
        message = f"--{option}: {error}"
        raise SpecError(message) from error


def _check_size(option: str, value: float, request: Request) -> None:
    """Refuse what would be sought for hours: the time that a model takes grows with the episodes and the learners."""
    if option.endswith("-within") and _MAX_EPISODES < value < math.inf:
        message = f"--{option}: found {value:g} episodes, expected at most {_MAX_EPISODES:,}"
        raise SpecError(message)
    is_simulated = SIMULATED in request.theories
    most = _MAX_SIMULATED if is_simulated else _MAX_LEARNERS
    if request.num_learners > most:
        where = " where chains are simulated" if is_simulated else ""
        message = f"--learners: found {request.num_learners:,}, expected at most {most:,}{where}"
        raise SpecError(message)
    if is_simulated:
        _ = request.ensemble


def _require_decay(decay: float) -> None:
    if decay < _MIN_DECAY:
        message = f"found a wish that takes a decay of {decay:.3g}, expected one of at least {_MIN_DECAY:g}"
        raise ValueError(message)


def advice(predictions: Sequence[DecayPrediction], num_learners: int) -> list[str]:
    """Which ν to take, which numbers to trust, and where a ν is beyond use. One line each.

    >>> print(advice(design(Request(explore=0.05)), 2)[0])
    take ν = 0.04762 (selection-aware)
    """
    chosen, trusted = predictions[-1].decay, predictions[-1].decay_by
    lines = [
        f"take ν = {chosen:.4g} ({trusted})",
        f"trust the rows predicted by {trusted}: what runs show, as only the learner that was selected can gain",
        "times in episodes: adaptation until a new best is as likely as the old one, rise to 90 % of the steady state",
    ]
    largest = 1.0 / (num_learners + 1)
    for decay in dict.fromkeys(row.decay for row in predictions if row.decay >= largest):
        lines.append(
            f"at ν = {decay:.4g} nobody keeps a lead (ν ≥ 1/(n + 1) = {largest:.4g}): close to a uniform choice"
        )
    return lines


def _wanted(request: Request) -> tuple[str, float]:
    """The one criterion, as option and value."""
    criteria = {
        "adapt-within": request.adapt_within,
        "rise-within": request.rise_within,
        "explore": request.explore,
        "performance": request.performance,
    }
    given = [(option, value) for option, value in criteria.items() if value is not None]
    if len(given) != 1:
        found = " and ".join(f"--{option}" for option, _ in given) or "none"
        message = f"found {found}, expected exactly one of {', '.join(f'--{option}' for option in criteria)}"
        raise SpecError(message)
    option, value = given[0]
    return option, value


def _other_returns(request: Request) -> list[float]:
    """One return per other learner; empty where no returns are given and none are needed."""
    others, expected = list(request.other_returns), request.num_learners - 1
    if request.best_return is None and not others and request.performance is None:
        return []
    if request.best_return is None or not others:
        message = "found only part of --performance, --best-return, --other-return, expected both returns"
        raise SpecError(message)
    if len(others) not in (1, expected):
        message = f"--other-return: found {len(others)}, expected 1, or one per other learner, {expected}"
        raise SpecError(message)
    others = others if len(others) == expected else others * expected
    try:
        require_returns(request.best_return, others)
    except ValueError as error:
        message = f"--best-return, --other-return: {error}"
        raise SpecError(message) from error
    return others


def _decay(theory: str, option: str, value: float, request: Request, others: Sequence[float]) -> float:
    """The ν that meets the criterion by one theory."""
    if theory == SIMULATED:
        return _simulated_decay(option, value, request, others)
    num_learners, best = request.num_learners, request.best_return or 0.0
    aware = theory == SELECTION_AWARE
    undo = selection_aware_inverses if aware else inverses
    if option == "explore":
        return undo.decay_for_exploration(value, num_learners)
    if option == "performance":
        return undo.decay_for_performance(value, best, others)
    if option == "adapt-within":
        if aware:
            return selection_aware_inverses.decay_for_adaptation_time(value, num_learners)
        return inverses.decay_for_adaptation_time(value)
    if aware:
        return selection_aware_inverses.decay_for_rise_time(value, num_learners)
    return inverses.decay_for_rise_time(value)


def _simulated_decay(option: str, value: float, request: Request, others: Sequence[float]) -> float:
    ensemble = request.ensemble
    if option == "performance":
        require_performance(value, request.best_return or 0.0, others)
    else:
        require_positive("wanted", value)

    def explored(nu: float) -> float:
        return noisy.steady_state(nu, ensemble).exploration_probability

    measures = {
        "explore": explored,
        "performance": lambda nu: closed_forms.mean_return(explored(nu), request.best_return or 0.0, others),
        "adapt-within": lambda nu: noisy.adaptation_time(nu, ensemble),
        "rise-within": lambda nu: noisy.rise_time(nu, ensemble),
    }
    return noisy.decay_for(measures[option], value, request.num_learners, rising=option == "explore")


def _prediction(nu: float, decay_by: str, theory: str, request: Request, others: Sequence[float]) -> DecayPrediction:
    """What one theory expects of a ν."""
    num_learners, best = request.num_learners, request.best_return
    if theory == SIMULATED:
        ensemble = request.ensemble
        exploration = noisy.steady_state(nu, ensemble).exploration_probability
        performance = None if best is None else closed_forms.mean_return(exploration, best, others)
        times = noisy.adaptation_time(nu, ensemble), noisy.rise_time(nu, ensemble)
        return DecayPrediction(nu, decay_by, theory, *times, exploration, performance)
    if theory == SELECTION_AWARE:
        times = selection_aware.adaptation_time(nu, num_learners), selection_aware.rise_time(nu, num_learners)
    else:
        times = closed_forms.adaptation_time(nu), closed_forms.rise_time(nu)
    forms = selection_aware if theory == SELECTION_AWARE else closed_forms
    exploration = forms.exploration_probability(nu, num_learners)
    performance = None if best is None else forms.steady_state_performance(nu, best, others)
    return DecayPrediction(nu, decay_by, theory, *times, exploration, performance)
