"""How much of a minibatch is to come from episodes that the learner played itself."""

from __future__ import annotations

import math
from fractions import Fraction


def own_part_of(size: int, share: float) -> int:
    """⌈share · size⌉, with the share as it is written.

    >>> own_part_of(32, 0.5), own_part_of(5, 0.5), own_part_of(100, 0.07), math.ceil(100 * 0.07)
    (16, 3, 7, 8)
    """
    return math.ceil(Fraction(str(share)) * size)
