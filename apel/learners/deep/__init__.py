"""Learners with neural networks: those of all runs of a shard in stacked tensors.

Nothing outside this package imports PyTorch, and nothing imports this package before a deep learner is asked for by
name: loading PyTorch takes seconds that a tabular experiment need not spend.
"""

from importlib.util import find_spec

if find_spec("torch") is None:
    message = 'deep learners need PyTorch: pip install "apel[deep]"'
    raise ImportError(message)
