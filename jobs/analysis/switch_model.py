"""What the selection-aware model says of the measured adaptation time in the mazes of §4.3.2."""

from __future__ import annotations

from functools import lru_cache

from apel.theory.adaptation import WindowCriterion, adaptation_time_distribution

LENGTHS = (34 * 1.67, 34.0)
"""Mean episode lengths after the switch: the old best, of whose moves ε = 0.4 are random, and the new best."""
CRITERION = WindowCriterion(LENGTHS, 1.1 * 34)
NUM_CHAINS = 300


@lru_cache
def measured_adaptation_time(nu: float, num_learners: int) -> float:
    """Mean number of episodes until the last 50 are short enough, of simulated chains that began in steady state."""
    return float(adaptation_time_distribution(nu, num_learners, criterion=CRITERION, num_chains=NUM_CHAINS).mean)
