"""Trained agents out of results: kept, or played again."""
