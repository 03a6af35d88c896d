"""The best of several candidates is decided while runs are added, and seldom wrongly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jobs.analysis.statistics import sequential
from jobs.analysis.statistics.sequential import Decision, decide, first_look, least_error

ERROR = 0.2
"""High, so that few simulations show whether it is held."""
_REPETITIONS = 150


@pytest.fixture
def few_paths(monkeypatch: pytest.MonkeyPatch) -> None:
    """The test is exact with any number of paths; few are quick."""
    monkeypatch.setattr(sequential, "_NUM_PATHS", 512)


def wrong(means: list[float], kind: str, best: set[int], num_runs: int = 24) -> float:
    """Share of simulations in which a candidate is called the best that is not, or not alone."""
    count = 0
    for repetition in range(_REPETITIONS):
        rng = np.random.default_rng([repetition, len(means)])
        shape = (num_runs, len(means))
        noise = {"normal": rng.normal(size=shape), "heavy": rng.standard_t(1.5, size=shape)}[kind]
        values = noise + rng.normal(size=(num_runs, 1)) + means  # a run's seed is shared
        decision = decide(values, smaller_is_better=False, error=ERROR, seed=repetition)
        count += decision.best is not None and best != {decision.best}
    return count / _REPETITIONS


@pytest.mark.usefixtures("few_paths")
@pytest.mark.parametrize(
    ("means", "kind", "best"),
    [
        ([0.0, 0.0], "normal", set()),
        ([0.0, 0.0], "heavy", set()),
        ([0.0, 0.0, 0.0, 0.0], "normal", set()),
        ([0.0, 0.0, -2.0], "normal", set()),
        ([0.3, 0.0, 0.0], "normal", {0}),
    ],
)
def test_error_is_held(means: list[float], kind: str, best: set[int]) -> None:
    """Where all, or the best, are equal no answer is right; where one is the best, no other one is.

    The bound is three standard errors of a share of 0.2 above it.
    """
    assert wrong(means, kind, best) <= ERROR + 3 * np.sqrt(ERROR * (1 - ERROR) / _REPETITIONS)


def test_a_better_one_is_found() -> None:
    """One that is better by two standard deviations is found among four with few runs; the others are out."""
    rng = np.random.default_rng(3)
    values = rng.normal(size=(40, 4)) + np.array([0.0, 2.0, 0.0, 0.0])
    decision = decide(values, smaller_is_better=False)
    assert (decision.best, decision.left) == (1, (1,))
    assert first_look(4, 0.05) <= decision.num_runs < 30


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 4), st.floats(0.0, 3.0))
def test_what_is_decided_stays_so(seed: int, num_candidates: int, gap: float) -> None:
    """More runs change no decision, and looks do not depend on how many runs there are in the end; the other way round
    is the same.
    """
    values = np.random.default_rng(seed).normal(size=(20, num_candidates))
    values[:, 0] += gap
    found = decide(values, smaller_is_better=False, error=0.4)
    for num_runs in (8, 11, 15):
        early = decide(values[:num_runs], smaller_is_better=False, error=0.4)
        if early.best is not None or found.num_runs <= num_runs:
            assert early == found
        assert set(found.left) <= set(early.left)
    assert decide(-values, smaller_is_better=True, error=0.4) == found
    assert decide(1000 * values, smaller_is_better=False, error=0.4) == found


def test_no_run_in_vain() -> None:
    """Runs that agree to the last bit decide nothing, however many; nor do those that one lacks, nor too few."""
    equal = np.tile(np.arange(50.0)[:, None], 3)
    assert decide(equal, smaller_is_better=True) == Decision(None, (0, 1, 2), 50)
    apart = equal + np.array([0.0, 1.0, 2.0])
    assert decide(apart, smaller_is_better=True).best == 0
    apart[6:, 2] = np.nan
    assert decide(apart, smaller_is_better=True).left == (0, 2)
    few = first_look(3, 0.05) - 1
    assert decide(apart[:few], smaller_is_better=True) == Decision(None, (0, 1, 2), few)


@pytest.mark.parametrize(("num_candidates", "error"), [(2, 0.05), (2, 0.0005), (6, 0.002), (32, 0.01)])
def test_the_first_look_decides_where_runs_agree(num_candidates: int, error: float) -> None:
    """So many runs may decide, and no fewer can."""
    first = first_look(num_candidates, error)
    apart = np.arange(num_candidates) + np.arange(3.0 * first)[:, None] ** 2
    assert decide(apart[: first - 1], smaller_is_better=True, error=error).left == (*range(num_candidates),)
    decision = decide(apart, smaller_is_better=True, error=error)
    assert decision.best == 0
    assert decision.num_runs >= first


def test_least_error() -> None:
    """Where a path is all that may ever be cut off, less than one is; a little more, and runs decide."""
    equal = np.tile(np.arange(200.0)[:, None], 2) + np.array([0.0, 1.0])
    least = least_error(2)
    assert decide(equal, smaller_is_better=True, error=least).best is None
    with pytest.raises(ValueError, match=r"error: found 0\.000244141, expected more than 0\.000244141"):
        first_look(2, least)
    assert decide(equal, smaller_is_better=True, error=1.5 * least).best == 0


def test_no_more_paths_are_cut_off_than_allowed() -> None:
    """On each side, at every look: it is why the error is held whatever the values are, ties among them."""
    rng = np.random.default_rng(5)
    pair, before = sequential._Pair(), 0
    for look, allowed in ((8, 10), (9, 25), (12, 25), (16, 300)):
        differences = rng.integers(-2, 4, size=look - before).astype(float)
        pair.extend([sequential._signs(1, run) for run in range(before, look)], differences)
        pair.beaten(allowed)
        assert all(0 <= is_cut.sum() <= allowed for is_cut in pair._is_cut)
        before = look
    assert all(is_cut.sum() > 25 for is_cut in pair._is_cut)


def test_many_candidates() -> None:
    """Of more than can be compared two by two, each is held against the one with the best mean."""
    values = np.random.default_rng(1).normal(size=(40, sequential.MAX_COMPARED + 3))
    values[:, 20] += 4.0
    assert decide(values, smaller_is_better=False).best == 20
