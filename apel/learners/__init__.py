"""Base learners."""

from apel.learners.base import Freezable, HasActionValues, Learner, LearnerBank, Transition
from apel.learners.dyna_q import DynaQ, DynaQOptions
from apel.learners.generic_bank import GenericBank
from apel.learners.q_learning import Decay, QLearning, QLearningOptions, Switch
from apel.learners.single import SingleLearner
from apel.learners.stacked import StackedLearner, Transitions
from apel.learners.stacked_bank import StackedBank
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
    "SingleLearner",
    "StackedBank",
    "StackedLearner",
    "Switch",
    "TabularBank",
    "TabularLearner",
    "TabularMember",
    "Transition",
    "Transitions",
    "Voting",
    "VotingOptions",
]
