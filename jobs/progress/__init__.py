"""How far a job has come, and whoever shows it."""
