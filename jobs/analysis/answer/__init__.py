"""Which candidate to use, and how sure that is."""

from __future__ import annotations

DEFAULT_ERROR = 0.05
"""With which probability a candidate may be called the best that is not."""
