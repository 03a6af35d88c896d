"""A picture to draw on, as an array: rectangles, and lines with smooth edges."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Colour = tuple[int, int, int]
"""Red, green and blue, 0 to 255."""
Point = tuple[float, float]
"""(x, y) in pixels from the top left; whole numbers are the middles of pixels."""

WHITE, BLACK, GREY, LIGHT_GREY = (255, 255, 255), (30, 30, 30), (120, 120, 120), (215, 215, 215)
# Okabe & Ito 2008, *Color Universal Design*: told apart by everyone.
BLUE, GREEN, ORANGE = (0, 114, 178), (0, 158, 115), (230, 159, 0)


class Canvas:
    """A picture of ``width`` × ``height`` pixels, white at first.

    Attributes
    ----------
    image:
        ``uint8[height, width, 3]``.
    """

    def __init__(self, width: int, height: int) -> None:
        self.image: NDArray[np.uint8] = np.full((height, width, 3), WHITE, dtype=np.uint8)

    def rectangle(self, left: int, top: int, width: int, height: int, colour: Colour) -> None:
        """Fill whole pixels, from (``left``, ``top``) on."""
        self.image[max(top, 0) : max(top + height, 0), max(left, 0) : max(left + width, 0)] = colour

    def disc(self, middle: Point, radius: float, colour: Colour) -> None:
        """Fill a circle; see `line`."""
        self.line(middle, middle, radius, colour)

    def line(self, start: Point, end: Point, radius: float, colour: Colour) -> None:
        """Draw a line with round ends, ``2 · radius`` pixels thick.

        At its edge a pixel is mixed by how far its middle lies inside, which is nearly the share that is covered.
        """
        (x, y), (dx, dy) = start, (end[0] - start[0], end[1] - start[1])
        top, bottom = _span(y, y + dy, radius, self.image.shape[0])
        left, right = _span(x, x + dx, radius, self.image.shape[1])
        rows, columns = np.ogrid[top:bottom, left:right]
        along = np.clip(((columns - x) * dx + (rows - y) * dy) / max(dx * dx + dy * dy, 1e-12), 0.0, 1.0)
        distance = np.hypot(columns - x - along * dx, rows - y - along * dy)
        covered = np.clip(radius + 0.5 - distance, 0.0, 1.0)[..., np.newaxis]
        area = self.image[top:bottom, left:right]
        area[...] = np.rint(area + covered * (np.array(colour) - area))


def _span(one: float, other: float, radius: float, size: int) -> tuple[int, int]:
    """The pixels, of ``size``, that a line from ``one`` to ``other`` can touch."""
    first = min(max(math.floor(min(one, other) - radius - 1), 0), size)
    return first, max(min(math.ceil(max(one, other) + radius + 1) + 1, size), first)
