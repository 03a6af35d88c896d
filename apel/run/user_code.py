"""What users' code raises: whose fault it is, and how it is told.

Whatever leaves a user's environment, learner, selector or performance measure ends its run, and only this one:
`SystemExit` and other exceptions that are no `Exception` included, since programs call ``sys.exit`` where a window is
closed. Only an interruption of ours, such as the user's Ctrl-C, goes through.
"""

from __future__ import annotations

import signal
import sysconfig
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import CodeType, FrameType
from typing import Literal

Part = Literal["environment", "learner", "selector", "performance", ""]
"""What raised; empty where that is not known."""

_PART = "_apel_part"
_ROOT = Path(__file__).resolve().parents[2]
_OURS = tuple(f"{_ROOT / name}/" for name in ("apel", "cluster", "jobs"))
_INSTALLED = tuple(f"{sysconfig.get_path(name)}/" for name in ("stdlib", "platstdlib", "purelib", "platlib"))
_MOST_CHARACTERS = 2_000
_MOST_TRACE_CHARACTERS = 20_000
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class UserExitError(Exception):
    """Users' code raised what is no `Exception`, such as `SystemExit`; the message names it."""


def fault_of(part: Part, error: BaseException) -> BaseException:
    """``error`` as the fault of this part of an experiment; an interruption of ours is raised instead."""
    if is_interruption(error):
        raise error
    if not part_of(error):
        setattr(error, _PART, part)
    return error


def part_of(error: BaseException) -> Part:
    """Whose fault it is, as `fault_of` has noted."""
    part: Part = getattr(error, _PART, "")
    return part


@contextmanager
def faults_of(part: Part) -> Iterator[None]:
    """Within: what users' code raises is noted as this part's fault, and leaves as an `Exception`.

    Raises
    ------
    UserExitError
        In the place of `SystemExit` and its like.
    """
    try:
        yield
    except Exception as error:
        fault_of(part, error)
        raise
    except BaseException as error:
        message = in_a_line(fault_of(part, error))
        raise fault_of(part, UserExitError(message)) from error


def is_interruption(error: BaseException) -> bool:
    """Whether ``error`` comes from a signal to this process, and not from what users' code did of its own accord."""
    if isinstance(error, Exception):
        return False
    handlers = {code for number in _SIGNALS if (code := _code_of_handler(number)) is not None}
    if any(frame.f_code in handlers for frame, _ in traceback.walk_tb(error.__traceback__)):
        return True
    return isinstance(error, KeyboardInterrupt) and _may_be_interrupted()


def _code_of_handler(number: signal.Signals) -> CodeType | None:
    code = getattr(signal.getsignal(number), "__code__", None)
    return code if isinstance(code, CodeType) else None


def _may_be_interrupted() -> bool:
    """Python's own handler of Ctrl-C leaves no frame: where it is at work, it is thought to have raised."""
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return False
    if threading.current_thread() is not threading.main_thread():
        return False
    return signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def in_a_line(error: BaseException) -> str:
    """``KeyError: 'x'``; what ``sys.exit()`` raises is ``SystemExit``."""
    if isinstance(error, UserExitError):
        return str(error)
    try:
        text = str(error)
    except BaseException as unprintable:  # noqa: BLE001 - it is users' code, too
        text = f"(its message cannot be had: {type(fault_of('', unprintable)).__name__})"
    if isinstance(error, SystemExit) and error.code is None:
        text = ""
    return f"{type(error).__name__}: {text}"[:_MOST_CHARACTERS] if text else type(error).__name__


def place_of(error: BaseException) -> str:
    """``file:line, in function: its text`` of the last line of the user's that took part; empty if there is none."""
    for is_theirs in (_is_users, _is_not_ours):
        for one in _chain(error):
            frames = [(frame, line) for frame, line in traceback.walk_tb(one.__traceback__) if is_theirs(frame)]
            if frames:
                return _told(*frames[-1])
    return ""


def culprit_of(error: BaseException) -> BaseException:
    """The first of an error and its causes whose traceback leads through a line of the user's; itself if none does."""
    for one in _chain(error):
        if any(_is_users(frame) for frame, _ in traceback.walk_tb(one.__traceback__)):
            return one
    return error


def trace_of(error: BaseException) -> str:
    """The traceback from the first line of the user's on, with those of its causes."""
    told = traceback.TracebackException.from_exception(error)
    _drop_ours(told)
    text = "".join(told.format())
    if len(text) <= _MOST_TRACE_CHARACTERS:
        return text
    half = _MOST_TRACE_CHARACTERS // 2
    return f"{text[:half]}\n[… {len(text) - 2 * half} characters …]\n{text[-half:]}"


def _chain(error: BaseException) -> Iterator[BaseException]:
    """An error and what led to it."""
    seen: set[int] = set()
    one: BaseException | None = error
    while one is not None and id(one) not in seen:
        seen.add(id(one))
        yield one
        one = one.__cause__ or (None if one.__suppress_context__ else one.__context__)


def _told(frame: FrameType, line: int) -> str:
    code = frame.f_code
    summary = traceback.FrameSummary(code.co_filename, line, code.co_name)
    text = f": {summary.line}" if summary.line else ""
    return f"{code.co_filename}:{line}, in {code.co_name}{text}"


def _drop_ours(told: traceback.TracebackException | None) -> None:
    """Leave out the calls of ours that lead to the user's code."""
    if told is None:
        return
    theirs = [i for i, frame in enumerate(told.stack) if not frame.filename.startswith(_OURS)]
    if theirs:
        told.stack = traceback.StackSummary.from_list(told.stack[theirs[0] :])
    _drop_ours(told.__cause__)
    _drop_ours(told.__context__)


def _is_not_ours(frame: FrameType) -> bool:
    return not frame.f_code.co_filename.startswith(_OURS)


def _is_users(frame: FrameType) -> bool:
    """Neither ours, nor Python's, nor of an installed package."""
    name = frame.f_code.co_filename
    return _is_not_ours(frame) and not name.startswith(("<", *_INSTALLED))
