"""Learners with neural networks.

Perceptrons are computed by compiled loops, each run by itself. Convolutions, and whatever is on a GPU, are PyTorch's,
with the runs of a shard as rows of one tensor; only `stacked_network` imports it, and only where one is made: loading
PyTorch takes seconds that others need not spend.
"""

from apel.numerics import rounding

rounding.settle()
