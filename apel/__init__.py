"""APEL: ensembles of different reinforcement learners, the best one picked while they learn.

>>> import apel
>>> world = apel.make_world(apel.EnvironmentConfig("FrozenLake-v1"), run_seed=1)
>>> learners = [apel.LearnerConfig("q_learning"), apel.LearnerConfig("q_learning", {"learning_rate": 0.5})]
>>> ensemble = apel.Ensemble(world, learners, apel.Apel(decay=0.01), seed=1, num_episodes=100)
>>> records = list(ensemble.run())
>>> len(records)
100
"""

from apel import rounding as rounding  # first of all: it is about what others load
from apel.configs import EnvironmentConfig, LearnerConfig, SelectorConfig
from apel.ensemble import Ensemble, EpisodeRecord
from apel.environments import World, make_world
from apel.learners import Decay, DynaQ, Learner, QLearning, Switch, Transition, Voting
from apel.metrics import Criterion, Threshold
from apel.representations import Bins, Representation
from apel.seeding import run_seeds
from apel.selection import Selector
from apel.selectors import (
    Agent57,
    Apel,
    ApelMargin,
    ApelRecency,
    ApelSurprise,
    Corral,
    D3rb,
    DiscountedTs,
    DUcb,
    DynamicTs,
    Ed2rb,
    EpsilonGreedy,
    Esbas,
    Exp3,
    Exp3S,
    Fixed,
    Ssbas,
    SwUcb,
    Ucb1,
    Uniform,
)
from apel.trajectory import Trajectory, TrajectoryBatch

__all__ = [
    "Agent57",
    "Apel",
    "ApelMargin",
    "ApelRecency",
    "ApelSurprise",
    "Bins",
    "Corral",
    "Criterion",
    "D3rb",
    "DUcb",
    "Decay",
    "DiscountedTs",
    "DynaQ",
    "DynamicTs",
    "Ed2rb",
    "Ensemble",
    "EnvironmentConfig",
    "EpisodeRecord",
    "EpsilonGreedy",
    "Esbas",
    "Exp3",
    "Exp3S",
    "Fixed",
    "Learner",
    "LearnerConfig",
    "QLearning",
    "Representation",
    "Selector",
    "SelectorConfig",
    "Ssbas",
    "SwUcb",
    "Switch",
    "Threshold",
    "Trajectory",
    "TrajectoryBatch",
    "Transition",
    "Ucb1",
    "Uniform",
    "Voting",
    "World",
    "make_world",
    "run_seeds",
]
