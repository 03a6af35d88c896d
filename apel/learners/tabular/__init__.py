"""Learners that keep tables."""
