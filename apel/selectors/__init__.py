"""Ensemble learners: who acts next."""

from apel.run.selection import Selector
from apel.selectors.agent57 import Agent57
from apel.selectors.apel import Apel
from apel.selectors.apel_variants import ApelMargin, ApelRecency, ApelSurprise
from apel.selectors.constant import Fixed, Uniform
from apel.selectors.corral import Corral
from apel.selectors.epsilon_greedy import EpsilonGreedy
from apel.selectors.esbas import Esbas
from apel.selectors.exp3 import Exp3, Exp3S
from apel.selectors.incumbent import Incumbent
from apel.selectors.regret_balancing import D3rb, Ed2rb
from apel.selectors.ssbas import Ssbas
from apel.selectors.sw_ucb import SwUcb
from apel.selectors.thompson import DiscountedTs, DynamicTs
from apel.selectors.ucb import DUcb, Ucb1

__all__ = [
    "Agent57",
    "Apel",
    "ApelMargin",
    "ApelRecency",
    "ApelSurprise",
    "Corral",
    "D3rb",
    "DUcb",
    "DiscountedTs",
    "DynamicTs",
    "Ed2rb",
    "EpsilonGreedy",
    "Esbas",
    "Exp3",
    "Exp3S",
    "Fixed",
    "Incumbent",
    "Selector",
    "Ssbas",
    "SwUcb",
    "Ucb1",
    "Uniform",
]
