"""Learners with neural networks.

On the processor they are computed by compiled loops, each run by itself; on a GPU by PyTorch, with the runs of a shard
as rows of one tensor. Only `stacked_network` imports it, and only where one is made: loading PyTorch takes seconds that
others need not spend.
"""
