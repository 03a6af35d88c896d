"""Many claims at once: Holm's correction, so that *no* verdict is wrong by chance in 95 % of ledgers.

Source: Holm, S. (1979), *A simple sequentially rejective multiple test procedure*, Scandinavian Journal of Statistics
6(2).
"""

from __future__ import annotations

from collections.abc import Sequence


def holm(levels: Sequence[float]) -> list[float]:
    """Corrected p-values: of the i-th smallest of m, the largest of (m − j + 1) p₍ⱼ₎ for j ≤ i, at most 1.

    It holds however the tests depend on each other, as claims on the same runs do.

    >>> holm([0.01, 0.04, 0.03])
    [0.03, 0.06, 0.06]
    """
    corrected = [1.0] * len(levels)
    largest = 0.0
    for place, index in enumerate(sorted(range(len(levels)), key=levels.__getitem__)):
        largest = max(largest, min(1.0, (len(levels) - place) * levels[index]))
        corrected[index] = largest
    return corrected
