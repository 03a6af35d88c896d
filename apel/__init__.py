"""APEL: ensembles of different reinforcement learners, the best one picked while they learn.

>>> import apel
>>> world = apel.make_world(apel.EnvironmentConfig("FrozenLake-v1"), run_seed=1)
>>> learners = [apel.LearnerConfig("q_learning"), apel.LearnerConfig("q_learning", {"learning_rate": 0.5})]
>>> ensemble = apel.Ensemble(world, learners, apel.Apel(decay=0.01), seed=1, num_episodes=100)
>>> records = list(ensemble.run())
>>> len(records)
100

What ``__all__`` lists is the public interface: it changes with a line in the changelog and a new minor version. Modules
and names beside it may change at any time.
"""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

from apel.agents import Agent, Evaluation, load
from apel.building import make_world
from apel.configs import EnvironmentConfig, LearnerConfig, OwnShare, SelectorConfig
from apel.ensemble import Ensemble, EpisodeRecord
from apel.environments import World
from apel.experience.representations import Bins, Representation
from apel.experience.trajectory import Trajectory, TrajectoryBatch
from apel.learners import Decay, DynaQ, Learner, QLearning, Switch, Transition, Voting
from apel.learners.supported_spaces import SupportedSpaces
from apel.numerics.seeding import run_seeds
from apel.run.chooser import Chooser
from apel.run.criterion import Criterion, Threshold
from apel.run.floor import ActingFloor
from apel.run.rule import SelectionRule
from apel.run.selection import Selector
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
    Incumbent,
    Ssbas,
    SwUcb,
    Ucb1,
    Uniform,
)

if TYPE_CHECKING:
    from apel.learners.deep.acer import Acer
    from apel.learners.deep.dqn import Dqn
    from apel.learners.deep.sac import DiscreteSac
    from apel.learners.stable_baselines.adapter import StableBaselines
    from apel.learners.stable_baselines.on_policy import StableBaselinesOnPolicy

__all__ = [
    "Acer",
    "ActingFloor",
    "Agent",
    "Agent57",
    "Apel",
    "ApelMargin",
    "ApelRecency",
    "ApelSurprise",
    "Bins",
    "Chooser",
    "Corral",
    "Criterion",
    "D3rb",
    "DUcb",
    "Decay",
    "DiscountedTs",
    "DiscreteSac",
    "Dqn",
    "DynaQ",
    "DynamicTs",
    "Ed2rb",
    "Ensemble",
    "EnvironmentConfig",
    "EpisodeRecord",
    "EpsilonGreedy",
    "Esbas",
    "Evaluation",
    "Exp3",
    "Exp3S",
    "Fixed",
    "Incumbent",
    "Learner",
    "LearnerConfig",
    "OwnShare",
    "QLearning",
    "Representation",
    "SelectionRule",
    "Selector",
    "SelectorConfig",
    "Ssbas",
    "StableBaselines",
    "StableBaselinesOnPolicy",
    "SupportedSpaces",
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
    "__version__",
    "load",
    "make_world",
    "run_seeds",
]

_HOMES = {
    "Acer": "apel.learners.deep.acer",
    "DiscreteSac": "apel.learners.deep.sac",
    "Dqn": "apel.learners.deep.dqn",
    "StableBaselines": "apel.learners.stable_baselines.adapter",
    "StableBaselinesOnPolicy": "apel.learners.stable_baselines.on_policy",
}
"""What only those who use it should spend the time to load."""


def __getattr__(name: str) -> Any:
    """What is imported when it is asked for; ``__version__`` is that of the installed distribution."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    if name == "__version__":
        try:
            return version("apel")
        except PackageNotFoundError:
            message = "found no installed distribution of 'apel', of which the version could be told: pip install ."
            raise AttributeError(message) from None
    message = f"module 'apel' has no attribute {name!r}"
    raise AttributeError(message)
