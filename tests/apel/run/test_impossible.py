"""A bug of the program tells where, and what came before; also from another process."""

from __future__ import annotations

import pickle

from apel.run.impossible import ImpossibleStateError


def test_told_more_on_its_way_up() -> None:
    """Who catches it on the way adds what only they know: the place, and what came before."""
    error = ImpossibleStateError("found a gap", {"expected episode": 5, "found episode": 7}, ["episode 4 was taken in"])
    told = error.told_more({"run": 3, "seed": 17}, ["round 1: Q plays it"])
    assert str(told) == (
        "found a gap: run 3, seed 17, expected episode 5, found episode 7\n"
        "This is a bug of the program, not of the experiment. What came before:\n"
        "  round 1: Q plays it\n"
        "  episode 4 was taken in"
    )


def test_without_facts() -> None:
    """There need not be any."""
    assert str(ImpossibleStateError("found nothing")) == (
        "found nothing\nThis is a bug of the program, not of the experiment."
    )


def test_survives_pickling() -> None:
    """From process to process it stays the same, however often, and does not grow."""
    error = ImpossibleStateError("found a gap", {"run": 3}, ["round 1"]).told_more({"seed": 17}, ["round 0"])
    again = error
    for _ in range(3):
        again = pickle.loads(pickle.dumps(again))
    assert type(again) is ImpossibleStateError
    assert (again.what, again.facts, again.story) == (error.what, {"seed": 17, "run": 3}, ("round 0", "round 1"))
    assert str(again) == str(error)
