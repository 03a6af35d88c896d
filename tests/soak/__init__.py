"""Faults at random moments of a real job on three nodes: the rows must be those of a job that nobody disturbed.

Run it with ``python -m benchmarks.soak``; a small one is in the suite (`tests.cluster.test_soak`).
"""
