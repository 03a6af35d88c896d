"""Trained agents: the learners of a run, in the hand."""

from apel.agents.agent import Agent, load
from apel.agents.evaluation import Evaluation, Played

__all__ = ["Agent", "Evaluation", "Played", "load"]
