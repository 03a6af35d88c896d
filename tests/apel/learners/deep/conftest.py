"""PyTorch's engine is for GPUs. That the processor can stand in for one here, its products must not depend on where
numbers lie in memory.
"""

from __future__ import annotations

from apel.numerics import rounding

rounding.settle()
