"""Episodes of stored results as films."""
