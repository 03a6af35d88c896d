"""What is told of an error in a user's code: in a line, where it was, and all of it."""

from __future__ import annotations

import json

import pytest

from apel.run import user_code
from apel.run.impossible import ImpossibleStateError
from apel.run.user_code import in_a_line, place_of, trace_of


def misread() -> None:
    """The user's line is here; what raises is Python's own code."""
    json.loads("{")


def fail(function: object) -> BaseException:
    """What a call raises."""
    with pytest.raises(BaseException) as raised:  # noqa: PT011 - whatever it is
        function()  # type: ignore[operator]
    return raised.value


def test_the_place_is_the_user_s_line() -> None:
    """An installed package that the user called, and our own code above, are passed over."""
    place = place_of(fail(misread))
    assert __file__ in place
    assert "in misread: json.loads" in place


def test_without_a_line_of_the_user_s() -> None:
    """An error of code that is installed, called by none of the user's, has that code's place; ours has none."""
    frames = fail(misread).with_traceback(None)
    assert place_of(frames) == ""
    ours = fail(lambda: user_code.faults_of("learner").__enter__().nothing)  # type: ignore[attr-defined]
    assert __file__ in place_of(ours)


def test_length_of_a_line() -> None:
    """A message of megabytes does not reach the terminal."""
    assert len(in_a_line(ValueError("x" * 10_000))) == 2000
    assert in_a_line(ValueError("x" * 100)) == "ValueError: " + "x" * 100
    assert in_a_line(SystemExit()) == "SystemExit"


def test_length_of_a_trace() -> None:
    """Of a very long traceback both ends are kept: what called, and what raised."""
    limit = user_code._MOST_TRACE_CHARACTERS
    short = trace_of(fail(misread))
    assert short.startswith("Traceback")
    long = trace_of(ValueError("a" * limit + "end"))
    assert len(long) <= limit + 100
    assert long.rstrip().endswith("end")
    # "ValueError: ", the text, "end" and the end of the line are 16 characters too many.
    assert "\n[… 16 characters …]\n" in long


def test_a_fault_of_ours_is_none_of_the_user_s() -> None:
    """It keeps its own words."""
    error = ImpossibleStateError("what", {}, ["before"])
    assert in_a_line(error).startswith("ImpossibleStateError: ")
