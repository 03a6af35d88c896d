"""Base learners."""

from apel.learners.base import Freezable, HasActionValues, Learner, LearnerBank, Transition
from apel.learners.dyna_q import DynaQ, DynaQOptions
from apel.learners.generic_bank import GenericBank
from apel.learners.q_learning import Decay, QLearning, QLearningOptions, Switch
from apel.learners.tabular_bank import TabularBank
from apel.learners.tabular_tables import TabularLearner, TabularMember
from apel.learners.voting import Voting, VotingOptions

__all__ = [
    "Decay",
    "DynaQ",
    "DynaQOptions",
    "Freezable",
    "GenericBank",
    "HasActionValues",
    "Learner",
    "LearnerBank",
    "QLearning",
    "QLearningOptions",
    "Switch",
    "TabularBank",
    "TabularLearner",
    "TabularMember",
    "Transition",
    "Voting",
    "VotingOptions",
]
