"""Signals that end a job in good order."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class InterruptedJobError(Exception):
    """The user has stopped a job."""


@contextmanager
def stop_on_signals(on_first: Callable[[], None]) -> Iterator[Callable[[], bool]]:
    """Within: the first SIGINT or SIGTERM asks to stop, and calls ``on_first``; a second one interrupts at once.

    Yields a function that says whether to stop.

    Raises
    ------
    KeyboardInterrupt
        At the second signal.
    """
    asked = False

    def handle(_: int, __: FrameType | None) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True
        on_first()

    before = [signal.signal(number, handle) for number in _SIGNALS]
    try:
        yield lambda: asked
    finally:
        for number, handler in zip(_SIGNALS, before, strict=True):
            signal.signal(number, handler)
