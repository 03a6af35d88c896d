"""Breaks lines of the pure core on purpose, one at a time, to see whether the tests notice."""
