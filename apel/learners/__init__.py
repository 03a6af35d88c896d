"""Base learners, and the banks that hold them for many runs."""

from apel.learners.base import Learner, LearnerBank, Transition
from apel.learners.generic_bank import GenericBank
from apel.learners.q_learning import Decay, QLearning, QLearningOptions, Switch
from apel.learners.tabular_bank import TabularBank

__all__ = [
    "Decay",
    "GenericBank",
    "Learner",
    "LearnerBank",
    "QLearning",
    "QLearningOptions",
    "Switch",
    "TabularBank",
    "Transition",
]
