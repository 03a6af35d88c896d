"""Learners of many runs."""
