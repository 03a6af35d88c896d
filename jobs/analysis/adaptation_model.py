"""What the selection-aware model says of the measured adaptation time, for the lengths that an experiment states."""

from __future__ import annotations

from functools import lru_cache

from apel.run.criterion import Threshold
from apel.theory.adaptation import WindowCriterion, adaptation_time_distribution
from jobs.experiment.spec import Experiment
from jobs.experiment.spec_parts import LearnerSpec

NUM_CHAINS = 300


def window_criterion(experiment: Experiment, arm: str) -> WindowCriterion | None:
    """The experiment's criterion, with the mean lengths of the episodes of an arm's two learners after the switch.

    None where the file does not state them: it does where the criterion is a factor times a shortest length between
    whose ends the environment is drawn (§4.3.2), the learner that is better until the switch explores with a constant
    ε, and the one that is better from then on with an ε that changes. Of the first, a move out of ε is random and gets
    nowhere on average, so that its episodes are 1 / (1 − ε) times as long; the second, which hardly explores any more,
    is taken to walk the shortest way.
    """
    criterion, names = experiment.criterion, experiment.arms[arm].learner_names
    if criterion is None or criterion.measure != "length" or not isinstance(criterion.below, Threshold):
        return None
    ends = experiment.environment.options.get(criterion.below.info)
    explorations = [_exploration(experiment.learners[name]) for name in names]
    if not isinstance(ends, list) or len(explorations) != 2:
        return None
    old, new = explorations
    if not isinstance(old, int | float) or not 0 <= old < 1 or not isinstance(new, dict):
        return None
    shortest = sum(ends) / len(ends)
    threshold = criterion.threshold({criterion.below.info: shortest})
    return WindowCriterion((shortest / (1.0 - old), shortest), threshold, criterion.window)


def _exploration(learner: LearnerSpec) -> object:
    return learner.options.get("exploration")


@lru_cache
def mean_adaptation_time(nu: float, num_learners: int, criterion: WindowCriterion) -> float:
    """Mean number of episodes until the criterion holds, of simulated chains that began in steady state."""
    return float(adaptation_time_distribution(nu, num_learners, criterion=criterion, num_chains=NUM_CHAINS).mean)
