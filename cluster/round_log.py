"""The last rounds of a shard, for the story of an impossible state."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from apel.run.impossible import ImpossibleStateError
from apel.run.state import POSITION
from cluster.shard import Shard

_REMEMBERED = 5


@dataclass(frozen=True)
class _Round:
    number: int
    orders: Mapping[int, Sequence[int]]
    """Which runs a learner's host was told to play, by position."""
    episode: NDArray[np.int64]
    """``int64[runs]``: where the book stood before."""


class RoundLog:
    """Remembers who was to play what, and tells it, by the names that people know, where a state is impossible.

    Cheap enough for every round: some numbers per run are kept, and words are made only of what went wrong.

    Parameters
    ----------
    noticed_by:
        The process that keeps the log, as ``the coordinator`` or ``the host of Q_full``.
    """

    def __init__(self, shard: Shard, noticed_by: str) -> None:
        self._shard = shard
        self._noticed_by = noticed_by
        self._num_rounds = 0
        self._rounds: deque[_Round] = deque(maxlen=_REMEMBERED)

    def begun(self, orders: Mapping[int, Sequence[int]], episode: NDArray[np.int64]) -> None:
        """A round begins: learner i is to play the runs ``orders[i]``; ``episode`` (``int64[runs]``) is the book's.

        Rounds are counted from where this process began or resumed the shard.
        """
        self._num_rounds += 1
        self._rounds.append(_Round(self._num_rounds, orders, episode.copy()))

    @contextmanager
    def telling(self, played_by: int | None = None) -> Iterator[None]:
        """Add place and story to an impossible state that is found in the body.

        ``played_by`` is the learner of whose episodes the body is about, where it is one alone.
        """
        try:
            yield
        except ImpossibleStateError as error:
            raise self._told(error, played_by) from error

    def _told(self, error: ImpossibleStateError, played_by: int | None) -> ImpossibleStateError:
        facts: dict[str, int | str] = {"shard": self._shard.label, "noticed by": self._noticed_by}
        position = error.facts.get(POSITION)
        if not isinstance(position, int) or not 0 <= position < len(self._shard.runs):
            return error.told_more(facts)
        run = self._shard.runs[position]
        facts |= {"run": run.index, "seed": run.seed}
        if played_by is not None:
            facts["learner"] = self._shard.arm.learner_names[played_by]
        return error.told_more(facts, [self._line(one, position) for one in self._rounds])

    def _line(self, one: _Round, position: int) -> str:
        names = self._shard.arm.learner_names
        told = [names[learner] for learner, order in one.orders.items() if position in order]
        not_told = [names[learner] for learner in one.orders]
        who = " and ".join(told) or f"not {' or '.join(not_told)}"
        run = self._shard.runs[position].index
        return f"round {one.number}: the book stood before episode {one.episode[position]} of run {run}; to play: {who}"
