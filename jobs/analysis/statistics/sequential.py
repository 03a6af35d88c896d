"""Which of several candidates is the best, decided while runs are added: a group-sequential permutation test.

Runs of one index share their seed, so that candidates a and c are compared by the differences of their runs. Where
neither is better, runs of the two are exchangeable, and every difference is as likely with the other sign: the sum Sₙ
of the observed ones is held against sums with signs drawn at random, *paths* of which the observed one is just
another. At every look, the paths with the largest sums, of those that were not yet cut off, are cut off, together at
most a share α' f(n) of all paths by n runs. That the observed one is cut off has a probability of at most α',
whatever the number of looks: no path is special (Phipson & Smyth 2010; Hemerik & Goeman 2018).

The share is spent by the number of runs (Lan & DeMets 1983) with f(n) = 1 − ¾ √(n₁ / n), a quarter at the first look
n₁ and the rest ever more slowly. It does not depend on how many runs there may be at most, so that runs can be added
at any time, also to results that somebody has looked at.

A candidate that any other one beats is out, as in AdaStop (Mathieu et al. 2023). The last one that is left is the
best. With m candidates α' = α / (2 (m − 1)): where one candidate b is the best, a wrong answer takes that one of the
m − 1 others beats b; where several are, that any of two of them is beaten, by m − 1 others each. So no answer is
wrong with more than the probability α, however many candidates are equally good, and whatever the others are
(Bonferroni).

What is tested is whether runs are exchangeable. Of a candidate that fails once in a hundred runs, ten without a
failure do not tell.

Sources: Phipson, B. & Smyth, G. K. (2010), *Permutation p-values should never be zero*, SAGMB 9(1); Hemerik, J. &
Goeman, J. (2018), *Exact testing with random permutations*, TEST 27; Lan, K. K. G. & DeMets, D. L. (1983), *Discrete
sequential boundaries for clinical trials*, Biometrika 70(3); Mathieu, T. et al. (2023), *AdaStop: adaptive
statistical testing for sound comparisons of deep RL agents*, arXiv:2306.10882.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jobs.analysis.statistics.bootstrap import Floats

MAX_COMPARED = 32
"""Candidates of which every two are compared; of more, each with the one whose mean is the best."""
_NUM_PATHS = 8_192
_LOOK_GROWTH = 1.1
_FIRST_SHARE = 0.25
"""Of the error, that the first look may spend."""


@dataclass(frozen=True)
class Decision:
    """What runs decide.

    Attributes
    ----------
    best:
        The candidate that is better than all others; None where that is undecided.
    left:
        Candidates that no other one has beaten.
    num_runs:
        Runs that it took, or that were there where it is undecided.
    """

    best: int | None
    left: tuple[int, ...]
    num_runs: int


def decide(values: Floats, *, smaller_is_better: bool, error: float = 0.05, seed: int = 0) -> Decision:
    """Decide which candidate is the best, with a probability of at most ``error`` to name one that is not.

    Parameters
    ----------
    values:
        ``float64[runs, candidates]`` in the order of the runs' indices; NaN where a candidate has no such run.
    smaller_is_better:
        As train times are.
    error:
        α, the family-wise error.
    seed:
        From which the signs are drawn, those of each run apart: more runs move none of them.

    >>> values = np.arange(12.0)[:, None] + [1.0, 0.0]
    >>> decide(values, smaller_is_better=False)
    Decision(best=0, left=(0,), num_runs=8)
    """
    num_runs, num_candidates = values.shape
    left = list(range(num_candidates))
    if num_candidates < 2:
        return Decision(left[0] if left else None, tuple(left), num_runs)
    pairs = {pair: _Pair() for pair in _pairs(values, smaller_is_better)}
    looks = itertools.takewhile(lambda look: look <= num_runs, _looks(num_candidates, error))
    before = 0
    for look in looks:
        signs = [_signs(seed, run) for run in range(before, look)]
        num_allowed = _num_allowed(num_candidates, error, look)
        beaten = set()
        for (one, other), pair in pairs.items():
            differences = np.nan_to_num(values[before:look, one] - values[before:look, other])
            pair.extend(signs, -differences if smaller_is_better else differences)
            beaten |= {(one, other)[place] for place in pair.beaten(num_allowed)}
        if beaten >= set(left):
            beaten = set()  # in a circle, which takes that candidates lack different runs: it says nothing
        # Who beats whom at one look is known at once: those who are out there still count as the betters of others.
        left = [candidate for candidate in left if candidate not in beaten]
        if len(left) == 1:
            return Decision(left[0], tuple(left), look)
        pairs = {pair: state for pair, state in pairs.items() if not beaten & set(pair)}
        before = look
    return Decision(None, tuple(left), num_runs)


def least_error(num_candidates: int) -> float:
    """With an error of no more than this, α' is not even one path, and no number of runs decides.

    >>> least_error(2), least_error(6)
    (0.000244140625, 0.001220703125)
    """
    return 2 * (num_candidates - 1) / _NUM_PATHS


def first_look(num_candidates: int, error: float) -> int:
    """The fewest runs that can decide: those of the first look at which a path may be cut off.

    Raises
    ------
    ValueError
        If no number of runs can.

    >>> first_look(2, 0.05), first_look(6, 0.05), first_look(2, 0.01), first_look(2, 0.0005)
    (8, 10, 10, 31)
    """
    if error <= least_error(num_candidates):
        message = f"error: found {error:g}, expected more than {least_error(num_candidates):.6g}"
        raise ValueError(message)
    return next(look for look in _looks(num_candidates, error) if _num_allowed(num_candidates, error, look))


def _first(num_candidates: int, error: float) -> int:
    """n₁: the fewest runs of which no sum but the one with all signs as observed need be cut off to spend a quarter of
    α'.
    """
    return max(2, math.ceil(math.log2(2 * (num_candidates - 1) / (_FIRST_SHARE * error))))


def _looks(num_candidates: int, error: float) -> Iterator[int]:
    look = _first(num_candidates, error)
    while True:
        yield look
        look = max(look + 1, math.ceil(_LOOK_GROWTH * look))


def _num_allowed(num_candidates: int, error: float, look: int) -> int:
    """Paths that may be cut off by so many runs: α' f(n) of all."""
    share = error / (2 * (num_candidates - 1))
    allowed = share * (1 - (1 - _FIRST_SHARE) * math.sqrt(_first(num_candidates, error) / look))
    return int(allowed * _NUM_PATHS)


def _pairs(values: Floats, smaller_is_better: bool) -> Sequence[tuple[int, int]]:
    candidates = range(values.shape[1])
    if len(candidates) <= MAX_COMPARED:
        return list(itertools.combinations(candidates, 2))
    mean = np.nanmean(values if smaller_is_better else -values, axis=0)
    leader = int(np.argmin(mean))
    return [(leader, other) for other in candidates if other != leader]


def _signs(seed: int, run: int) -> Floats:
    """Signs of a run's differences on all paths, the observed one first; the same for all pairs."""
    drawn = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(run,))).integers(0, 2, _NUM_PATHS)
    drawn[0] = 1
    return (2 * drawn - 1).astype(np.float64)


class _Pair:
    """The paths of two candidates: sums of differences, and which of them were cut off above, and below."""

    def __init__(self) -> None:
        self._total = np.zeros(_NUM_PATHS)
        self._is_cut = [np.zeros(_NUM_PATHS, dtype=np.bool_) for _ in range(2)]

    def extend(self, signs: Sequence[Floats], differences: Floats) -> None:
        for sign, difference in zip(signs, differences, strict=True):
            self._total += sign * difference

    def beaten(self, num_allowed: int) -> list[int]:
        """Cut paths off, at most ``num_allowed`` on each side with those before; the places (0, 1) of who is beaten."""
        return [1 - side for side in range(2) if self._cut(self._is_cut[side], (1, -1)[side], num_allowed)]

    def _cut(self, is_cut: NDArray[np.bool_], direction: int, num_allowed: int) -> bool:
        num_more = num_allowed - int(is_cut.sum())
        if num_more <= 0:
            return False
        sums = np.where(is_cut, -np.inf, direction * self._total)
        # The largest one that has to stay; of equal ones all stay, or all go.
        edge = np.partition(sums, _NUM_PATHS - 1 - num_more)[_NUM_PATHS - 1 - num_more]
        gone = sums > edge
        is_cut |= gone
        return bool(gone[0])
