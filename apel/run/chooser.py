"""A selector by itself, for a script that has scores and no episodes."""

from __future__ import annotations

import math

from apel.numerics.seeding import Role, make_stream
from apel.numerics.views import Row
from apel.run.rule import SelectionRule, as_selector
from apel.run.selection import Selector, common_blocks

_NOBODY = -1


class Chooser:
    """One run of a selector: ask who is next, tell how that went. What it chooses among may be anything with a score.

    With the seed of an `apel.Ensemble`, and its performances, it makes the same choices.

    >>> from apel.selectors import Apel
    >>> chooser = Chooser(Apel(decay=0.02), num_learners=3, seed=1)
    >>> for _ in range(500):
    ...     chosen = chooser.select()
    ...     chooser.observe([0.2, 0.9, 0.5][chosen])
    >>> int(chooser.concentration.argmax())
    1

    Parameters
    ----------
    selector:
        One that is shipped, or a rule of your own.
    num_learners:
        Among how many it chooses.
    seed:
        Everything random follows from it.
    num_episodes:
        Choices at most. Some selectors bound their memory by it, such as `apel.Ssbas`.

    Raises
    ------
    ValueError
        If there is nothing to choose among, or the selector is for another number of learners.
    """

    def __init__(
        self, selector: Selector | SelectionRule, num_learners: int, seed: int, num_episodes: int = 10_000
    ) -> None:
        if num_learners < 1 or num_episodes < 1:
            message = f"found {num_learners} learners and {num_episodes} episodes, expected at least one of each"
            raise ValueError(message)
        self._selector, self._num_learners, self._num_left = as_selector(selector), num_learners, num_episodes
        self._row = self._selector.initial_state(num_learners, num_episodes)
        self._parameters, self._stream = self._selector.parameters(), make_stream(seed, Role.SELECTOR)
        self._selected = _NOBODY

    def select(self) -> int:
        """Who is next, from 0; the same one until its performance was observed.

        Raises
        ------
        ValueError
            If there were ``num_episodes`` choices, or a rule names somebody who does not exist.
        """
        if self._selected != _NOBODY:
            return self._selected
        if self._num_left == 0:
            message = "found no choice left, expected a larger num_episodes"
            raise ValueError(message)
        selected = int(self._selector.select(self._parameters, self._num_learners, self._row, self._stream))
        if not 0 <= selected < self._num_learners:
            message = f"found the learner {selected}, expected one from 0 to {self._num_learners - 1}"
            raise ValueError(message)
        self._selected, self._num_left = selected, self._num_left - 1
        return selected

    def observe(self, performance: float) -> None:
        """How it went for the one that was selected; larger is better.

        Raises
        ------
        ValueError
            If nobody was selected, or the performance is not finite.
        """
        if self._selected == _NOBODY:
            message = "found a performance of nobody, expected select() to be called first"
            raise ValueError(message)
        if not math.isfinite(performance):
            message = f"found the performance {performance}, expected a finite number"
            raise ValueError(message)
        self._selector.observe(self._parameters, self._num_learners, self._row, self._selected, float(performance))
        self._selected = _NOBODY

    @property
    def probability(self) -> Row:
        """``float64[learners]``: with which each was to be selected by the latest choice."""
        return common_blocks(self._row, self._num_learners).probability.copy()

    @property
    def concentration(self) -> Row:
        """``float64[learners]``; NaN for selectors that have none."""
        return common_blocks(self._row, self._num_learners).concentration.copy()

    @property
    def performance_estimate(self) -> Row:
        """``float64[learners]``: the latest performance of each, NaN where there was none."""
        return common_blocks(self._row, self._num_learners).performance_estimate.copy()
