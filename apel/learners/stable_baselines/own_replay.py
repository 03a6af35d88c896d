"""A share of every minibatch that stable-baselines3 draws, from the steps that the learner played itself."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from apel.learners.own_share import own_part_of


class OwnReplay:
    """Stands between a replay buffer's choice of steps and its handing them out.

    SB3 draws B steps from all, as ever; the first ⌈share · B⌉ are then replaced by others, drawn uniformly with
    replacement from what is own, by the process's stream of NumPy, as SB3 does.

    Parameters
    ----------
    buffer:
        SB3's, of one environment. Its ``_get_samples`` is replaced.
    share:
        In (0, 1].

    Raises
    ------
    TypeError
        If it has a ``sample`` of its own, which may choose in another way.
    """

    def __init__(self, buffer: Any, share: float) -> None:
        from stable_baselines3.common.buffers import DictReplayBuffer, ReplayBuffer

        if type(buffer).sample not in (ReplayBuffer.sample, DictReplayBuffer.sample):
            message = f"found {type(buffer).__name__} with a sample of its own"
            raise TypeError(message)
        self._buffer, self._share = buffer, share
        self._is_own = np.zeros(buffer.buffer_size, dtype=np.bool_)
        self._rows = np.zeros(buffer.buffer_size, dtype=np.int64)
        """A ring of the rows that hold own steps."""
        self._forgotten, self._added = 0, 0
        self._handed_out = buffer._get_samples
        buffer._get_samples = self._get_samples

    def add(self, row: int, *, is_own: bool) -> None:
        """Note who played the step that is written to a row next."""
        if self._is_own[row]:  # rows are overwritten in the order in which they were written
            self._forgotten += 1
        self._is_own[row] = is_own
        if is_own:
            self._rows[self._added % len(self._rows)] = row
            self._added += 1

    def state(self) -> NDArray[np.bool_]:
        """Whether the step in each row is own, of those that are filled."""
        return self._is_own[: self._buffer.size()].copy()

    def restore(self, is_own: Sequence[bool] | NDArray[np.bool_]) -> None:
        """Go back to what `state` returned, after the buffer has; rows beyond it are not own."""
        self._is_own[:] = False
        self._is_own[: len(is_own)] = is_own
        position, size = self._buffer.pos, self._buffer.size()
        in_order = (np.arange(size) + (position if self._buffer.full else 0)) % len(self._rows)
        rows = in_order[self._is_own[in_order]]
        self._rows[: len(rows)] = rows
        self._forgotten, self._added = 0, len(rows)

    def _get_samples(self, rows: NDArray[np.int64], env: Any = None) -> Any:
        first, position = self._forgotten, self._buffer.pos
        # With optimize_memory_usage the oldest step's next observation has been overwritten.
        if self._buffer.optimize_memory_usage and self._buffer.full and self._is_own[position]:
            first += 1
        if self._added > first:
            part = own_part_of(len(rows), self._share)
            places = first + np.random.randint(0, self._added - first, size=part)  # noqa: NPY002 - as SB3 draws
            rows = np.concatenate((self._rows[places % len(self._rows)], rows[part:]))
        return self._handed_out(rows, env=env)
