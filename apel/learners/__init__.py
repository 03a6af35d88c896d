"""Base learners."""

from apel.learners.banks.batched_learner import BatchedLearner, Transitions
from apel.learners.banks.compiled import CompiledBank
from apel.learners.banks.learner_list import LearnerList
from apel.learners.banks.lockstep import LockstepBank
from apel.learners.banks.single import SingleLearner
from apel.learners.base import Freezable, HasActionValues, Learner, LearnerBank, Transition
from apel.learners.tabular.dyna_q import DynaQ, DynaQOptions
from apel.learners.tabular.q_learning import Decay, QLearning, QLearningOptions, Switch
from apel.learners.tabular.tables import TabularLearner, TabularMember
from apel.learners.tabular.voting import Voting, VotingOptions

__all__ = [
    "BatchedLearner",
    "CompiledBank",
    "Decay",
    "DynaQ",
    "DynaQOptions",
    "Freezable",
    "HasActionValues",
    "Learner",
    "LearnerBank",
    "LearnerList",
    "LockstepBank",
    "QLearning",
    "QLearningOptions",
    "SingleLearner",
    "Switch",
    "TabularLearner",
    "TabularMember",
    "Transition",
    "Transitions",
    "Voting",
    "VotingOptions",
]
