"""What a pool was told and answered last, for the story of an impossible state."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from cluster import pool_events as told
from cluster.pool_events import Instruction, PoolEvent

_REMEMBERED, _TOLD = 200, 20


@dataclass(frozen=True, slots=True)
class _Entry:
    seconds: float
    """Of a monotonic clock."""
    event: PoolEvent
    answer: tuple[Instruction, ...]

    def concerns(self, gang: int) -> bool:
        """Whether it is about a gang, or about all of them."""
        gangs = {gang_of(message) for message in (self.event, *self.answer)}
        return gang in gangs or gangs == {None}

    def line(self) -> str:
        answer = ", ".join(map(told.in_words, self.answer)) or "nothing"
        return f"{self.seconds:.1f} s: {told.in_words(self.event)} -> {answer}"


class PoolStory:
    """The last events, and the instructions that answered them.

    >>> story = PoolStory()
    >>> story.add(0.0, told.CpusCounted(2), []), story.add(0.1, told.Tick(), [told.Wait((), 0.5)])
    (None, None)
    >>> story.add(9.5, told.Tick(), [told.Hire(0, ()), told.Wait((), 0.5)])
    >>> story.lines()
    ['9.5 s: Tick() -> Hire(gang=0, gpus=())']
    """

    def __init__(self) -> None:
        self._entries: deque[_Entry] = deque(maxlen=_REMEMBERED)

    def add(self, now: float, event: PoolEvent, instructions: Sequence[Instruction]) -> None:
        """Remember it, unless time passed without any effect, as it does several times a second."""
        answer = tuple(one for one in instructions if not isinstance(one, told.Wait))
        if answer or not isinstance(event, told.Tick | told.CpusCounted):
            self._entries.append(_Entry(now, event, answer))

    def lines(self, gang: int | None = None) -> list[str]:
        """A line each, the oldest first; of one gang alone where one is named, and of what concerns all."""
        return list(self._lines(gang))[-_TOLD:]

    def _lines(self, gang: int | None) -> Iterator[str]:
        for entry in self._entries:
            if gang is None or entry.concerns(gang):
                yield entry.line()


def gang_of(message: PoolEvent | Instruction) -> int | None:
    """The gang that it is about, if it is about one."""
    match message:
        case told.GangReported(gang) | told.GangFreed(gang) | told.GangLost(gang) | told.GangFailed(gang):
            return gang
        case told.Hire(gang) | told.Dismiss(gang) | told.Start(gang) | told.AskToStop(gang):
            return gang
    return None
