"""Ensemble learners: who acts next."""

from apel.selection import Selector
from apel.selectors.apel import Apel
from apel.selectors.constant import Fixed, Uniform
from apel.selectors.ssbas import Ssbas

__all__ = ["Apel", "Fixed", "Selector", "Ssbas", "Uniform"]
