"""What a learner sees, by its representation and by what its class declares."""

from __future__ import annotations

from typing import Any

from gymnasium import spaces

from apel.configs import LearnerConfig
from apel.experience.representations import PartsView, View, WholeView
from apel.learners.supported_spaces import check_spaces, supported_spaces


def view_of(
    config: LearnerConfig,
    constructor: Any,
    observation: spaces.Space[Any],
    action: spaces.Space[Any],
    features: tuple[str, ...] | None,
) -> View:
    """The view of a learner: with their parts of observations that have some, if it takes them so, else of a vector, or
    of a channel; of one with members everything, which they see in their own ways.

    Parameters
    ----------
    config:
        The learner.
    constructor:
        What its type stands for.
    observation, action, features:
        Of the environment.

    Raises
    ------
    ValueError
        If there is no such view, or if the learner declares that it is not for such spaces.
    """
    supported = supported_spaces(constructor, config.options)
    if config.members:
        view: View = WholeView(observation)
    elif supported is not None and config.representation.channel is None and supported.takes_whole(observation):
        view = PartsView(config.representation, observation)
    else:
        view = View(config.representation, observation, features)
    if supported is not None:
        check_spaces(supported, config.name, view.space, action)
    return view
