"""From configurations to the things themselves: selectors, learners of one run, banks of a shard's runs."""

from apel.building.banks import bank_of_learners, make_bank, way_of_learning
from apel.building.learners import make_learner
from apel.building.parts import make_performance, make_selector, make_world
from apel.building.tables import is_tabular

__all__ = [
    "bank_of_learners",
    "is_tabular",
    "make_bank",
    "make_learner",
    "make_performance",
    "make_selector",
    "make_world",
    "way_of_learning",
]
