"""Whole numbers that come as floats: ``1e5`` is one, and YAML calls it a float."""

from __future__ import annotations

from typing import Any


def whole(value: Any) -> Any:
    """A float that is a whole number, of at most 64 bits, as an integer; anything else as it is.

    >>> whole(1e3), whole(1.5), whole("1e3")
    (1000, 1.5, '1e3')
    """
    return int(value) if isinstance(value, float) and value.is_integer() and abs(value) < 2**63 else value
