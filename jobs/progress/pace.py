"""How long something may still take."""

from __future__ import annotations

_MOST_POINTS = 128


class Pace:
    """How fast something goes, over the later half of the time that it has taken: learners get faster, or slower.

    >>> pace = Pace()
    >>> pace.left(0.0, 0, 100), pace.left(10.0, 20, 100), pace.left(20.0, 60, 100)
    (None, 40.0, 10.0)
    """

    def __init__(self) -> None:
        self._points: list[tuple[float, float]] = []
        self._spacing = 0.0

    def left(self, now: float, done: float, planned: float) -> float | None:
        """Seconds until ``planned`` of it are done, where ``done`` are at time ``now``; None where nothing moves."""
        if not self._points or now - self._points[-1][0] >= self._spacing:
            self._points.append((now, done))
        if len(self._points) > _MOST_POINTS:
            self._points = self._points[::2]
            self._spacing = (now - self._points[0][0]) / len(self._points)
        half = self._points[0][0] + (now - self._points[0][0]) / 2
        then, before = max(point for point in self._points if point[0] <= half)
        return (planned - done) * (now - then) / (done - before) if done > before else None


def clock(seconds: float) -> str:
    """Hours, minutes and seconds.

    >>> clock(3725.4)
    '1:02:05'
    """
    hours, rest = divmod(int(seconds), 3600)
    return f"{hours}:{rest // 60:02d}:{rest % 60:02d}"
