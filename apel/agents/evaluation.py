"""How good the learners of an agent are: episodes in which nothing is learned."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from apel.agents.content import AgentContent
from apel.agents.making import make_trained
from apel.building import make_world
from apel.configs import EnvironmentConfig
from apel.environments import World, close_environments, environment_list
from apel.experience.sight import Sight
from apel.learners import LearnerList
from apel.learners.banks.greedy_evaluation import Choose, exploring_choice, greedy_choice, play_unlearned
from apel.learners.base import HasActionValues, HasGreedyAction
from apel.numerics.episode_seeds import EpisodeSeeds
from apel.numerics.intervals import expanded_levels
from apel.numerics.seeding import Role, make_key

Mode = Literal["greedy", "as trained"]
MODES: tuple[Mode, ...] = ("greedy", "as trained")
ENSEMBLE = "(ensemble)"
"""Under which name the episodes of the learners that the selector picks stand."""
_RESAMPLES = 10_000
_BATCH_NUMBERS = 20_000_000
"""Of so many that are drawn at once: 160 MB."""


@dataclass(frozen=True)
class Played:
    """The episodes of one learner.

    Attributes
    ----------
    learner:
        Its name; of the ensemble `ENSEMBLE`.
    mode:
        ``greedy``: the first of the best actions, always; or ``as trained``.
    episode_return, length:
        ``float64[episodes]``, ``int64[episodes]``.
    num_cut:
        How many did not end, and were cut off.
    """

    learner: str
    mode: Mode
    episode_return: NDArray[np.float64]
    length: NDArray[np.int64]
    num_cut: int = 0

    @property
    def mean(self) -> float:
        """Of the returns."""
        return float(self.episode_return.mean())

    @property
    def interval(self) -> tuple[float, float]:
        """Of the mean: the 95 % expanded percentile bootstrap over episodes, with the same resamples every time."""
        count = len(self.episode_return)
        if count < 2:
            return self.mean, self.mean
        rng, rows = np.random.default_rng(0), max(1, min(_RESAMPLES, _BATCH_NUMBERS // count))
        starts = range(0, _RESAMPLES, rows)
        sizes = [(min(rows, _RESAMPLES - start), count) for start in starts]
        means = np.concatenate([self.episode_return[rng.integers(count, size=size)].mean(axis=1) for size in sizes])
        low, high = np.quantile(means, expanded_levels(count))
        return float(low), float(high)


@dataclass(frozen=True)
class Evaluation:
    """What came of it, learner by learner.

    Attributes
    ----------
    environment:
        Its name.
    seed:
        From which the seeds of the episodes follow.
    played:
        Of every learner greedily and as trained, where it can do both; of several, of their ensemble too.
    """

    environment: str
    seed: int
    played: tuple[Played, ...]

    @property
    def num_cut(self) -> int:
        """How many episodes did not end; those of an ensemble are its learners', and counted with these."""
        return sum(one.num_cut for one in self.played if one.learner != ENSEMBLE)

    def of(self, learner: str, mode: Mode = "greedy") -> Played:
        """The episodes of one learner.

        Raises
        ------
        KeyError
            If it has played none in this mode.
        """
        for one in self.played:
            if (one.learner, one.mode) == (learner, mode):
                return one
        message = f"found no episodes of {learner!r}, {mode}"
        raise KeyError(message)


def evaluate_learners(
    content: AgentContent,
    config: EnvironmentConfig,
    episodes: int,
    seed: int,
    max_steps: int,
    selected: Mapping[Mode, NDArray[np.int64]],
) -> Evaluation:
    """See `apel.Agent.evaluate`; ``selected`` (``int64[episodes]``) is who plays each in an ensemble."""
    if episodes < 1 or max_steps < 1:
        message = f"found {episodes} episodes of at most {max_steps} steps, expected at least one of each"
        raise ValueError(message)
    world = make_world(config, int(content.origin.get("seed", 0)))
    try:
        check_spaces(content, world)
        played: list[Played] = []
        for index in range(len(content.learners)):
            played += _of_learner(content, index, world, episodes, seed, max_steps)
    finally:
        close_environments([world.environment])
    if len(content.learners) > 1:
        played += _of_ensemble(content, played, selected, max_steps)
    return Evaluation(config.name, seed, tuple(played))


def check_spaces(content: AgentContent, world: World) -> None:
    """See that the learners can be played in a world.

    Raises
    ------
    ValueError
        If it has other spaces than theirs.
    """
    for what, found, expected in (
        ("observations", world.spaces.observation, content.spaces.observation),
        ("actions", world.spaces.action, content.spaces.action),
    ):
        if found != expected:
            message = f"found an environment with the {what} {found}, expected those of the agent, {expected}"
            raise ValueError(message)


def _of_learner(
    content: AgentContent, index: int, world: World, episodes: int, seed: int, max_steps: int
) -> list[Played]:
    learner, view = make_trained(content, index, seed)
    choosing: dict[Mode, Callable[[Any], Choose]] = {"as trained": exploring_choice}
    if isinstance(learner, HasActionValues | HasGreedyAction):
        choosing = {"greedy": greedy_choice, **choosing}
    batched = LearnerList([learner], [content.spaces.action])
    environment, sight = environment_list([world]), Sight([view])
    seeds = EpisodeSeeds(make_key(seed, Role.EVALUATION), world.seeds.is_wide)
    played = []
    for mode, made in choosing.items():
        rows = [
            play_unlearned(made(batched), environment, sight, 0, seeds.of_episode(episode), max_steps)
            for episode in range(episodes)
        ]
        length, episode_return = (np.array(column) for column in zip(*rows, strict=True))
        played.append(Played(content.names[index], mode, episode_return, length, _num_cut(length, max_steps)))
    return played


def _num_cut(length: NDArray[np.int64], max_steps: int) -> int:
    """How many of the episodes with these lengths (``int64[episodes]``) were cut off.

    One that ends with the last step that it is allowed may count as cut: nobody can tell any more.
    """
    return int((length >= max_steps).sum())


def _of_ensemble(
    content: AgentContent, played: list[Played], selected: Mapping[Mode, NDArray[np.int64]], max_steps: int
) -> list[Played]:
    """The episodes of who plays: since nobody learns, those that they have played already."""
    found = []
    for mode, chosen in selected.items():
        episodes = np.arange(len(chosen))
        of_mode = {one.learner: one for one in played if one.mode == mode}
        if of_mode.keys() == set(content.names):
            rows = [of_mode[name] for name in content.names]
            returns = np.stack([row.episode_return for row in rows])[chosen, episodes]
            lengths = np.stack([row.length for row in rows])[chosen, episodes]
            found.append(Played(ENSEMBLE, mode, returns, lengths, _num_cut(lengths, max_steps)))
    return found
