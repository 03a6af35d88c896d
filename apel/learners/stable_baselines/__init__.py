"""Off-policy algorithms of stable-baselines3 as base learners."""
