"""An agent: the learners of a run after their training, and who of them acts."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from apel.agents.content import BEST, SELECTOR, AgentContent, TrainedFloor, TrainedLearner, agent_digest
from apel.agents.evaluation import MODES, Evaluation, Mode, evaluate_learners
from apel.agents.files import read_agent, write_agent
from apel.agents.making import entry_of, fixed_selector, foreign_environment, foreign_names, make_trained
from apel.building import make_selector
from apel.configs import EnvironmentConfig
from apel.experience.action_form import ActionForm
from apel.experience.representations import View
from apel.experience.sight import Sight
from apel.learners import LearnerList
from apel.learners.banks.greedy_evaluation import exploring_choice, greedy_choice
from apel.learners.base import HasActionValues, HasGreedyAction, Learner
from apel.run.floor import under_floor

_ONLY = np.zeros(1, dtype=np.int64)


def load(path: str | os.PathLike[str], *, acting: str | None = None, trust: bool = False) -> Agent:
    """The agent that `apel export` or `Agent.save` wrote into a folder.

    Reading it runs no code. Its learners are made when they are asked for; what they name beyond what is shipped, such
    as a class of your own, is looked for among your modules, and only with ``trust``.

    Parameters
    ----------
    path:
        The folder.
    acting:
        Who acts: ``best``, ``selector``, or the name of a learner; None leaves it as it was saved.
    trust:
        Whether code that is not shipped may run.

    Raises
    ------
    ValueError
        If there is no agent, it has no such learner, or it names other code and ``trust`` is false.
    """
    content, _ = read_agent(path)
    agent = Agent(content, trust=trust)
    if acting is not None:
        agent.acting = acting
    return agent


class Agent:
    """The learners of a run, trained.

    Parameters
    ----------
    content:
        What it is made of.
    trust:
        Whether code that is not shipped may run, such as learners by import paths.

    Raises
    ------
    ValueError
        If it names such code and ``trust`` is false.
    """

    def __init__(self, content: AgentContent, *, trust: bool = False) -> None:
        if not trust and (named := foreign_names(content)):
            raise ValueError(_distrusted(named))
        self._content, self._trust = content, trust
        self._made: dict[str, tuple[Learner, View]] = {}
        self._sights: dict[str, Sight] = {}
        self._selector = make_selector(content.selector.config)
        self._row, self._stream = content.selector.row.copy(), content.selector.stream.copy()
        self._floor = content.selector.floor and content.selector.floor.copy()
        self._now: str | None = None
        self.acting = content.acting

    @property
    def content(self) -> AgentContent:
        """What it is made of now, with what its learners have learned since it was loaded."""
        learners = tuple(self._trained(one) for one in self._content.learners)
        return replace(self._content, learners=learners, acting=self.acting)

    @property
    def digest(self) -> str:
        """What it is known by: equal for equal agents, whoever acts."""
        return agent_digest(self.content)

    @property
    def names(self) -> list[str]:
        """Of the learners."""
        return self._content.names

    @property
    def best(self) -> str:
        """The learner with the highest score (`AgentContent.scores`), the first of several."""
        scores = self._content.scores
        return self.names[int(np.argmax(scores)) if scores else 0]

    @property
    def acting(self) -> str:
        """Who acts: ``best``, ``selector``, or the name of a learner. May be set."""
        return self._acting

    @acting.setter
    def acting(self, name: str) -> None:
        if name not in (BEST, SELECTOR, *self.names):
            message = f"found the learner {name!r}, expected {BEST!r}, {SELECTOR!r}, or one of {self.names}"
            raise ValueError(message)
        self._acting = name
        self.begin()

    @property
    def now(self) -> str:
        """Who acts in this episode; empty before its first observation."""
        return self._now or ""

    def begin(self) -> None:
        """The next observation is the first of an episode: stacks of frames begin anew, and the selector, if it is that
        which acts, selects a learner.
        """
        self._now = None

    def act(self, observation: Any, *, explore: bool = False, info: Mapping[str, Any] | None = None) -> Any:
        """The action for an observation of the environment, as that gives it.

        The first of the actions with the highest value, or what a learner says that it would do without exploring; with
        ``explore``, and where a learner cannot say, as while it was trained. ``info`` is needed where an environment's
        signals end episodes for learners. Learners are given copies.

        Raises
        ------
        ValueError
            If the observation cannot be brought into the form of the environment's space, see
            `apel.agents.making.entry_of`, or a learner answers with what is no action.
        """
        seen, name = self._seen(observation, info or {}, explore=explore)
        learner, form = self.learner(name), ActionForm(self._content.spaces.action)
        # As in a run of one: what learners are given is their own, and what they answer is checked.
        bank = LearnerList([learner], [form.space])
        is_greedy = not explore and isinstance(learner, HasGreedyAction | HasActionValues)
        choose = greedy_choice(bank) if is_greedy else exploring_choice(bank)
        return form.rows(form.uncounted(choose(_ONLY, seen)))[0]

    def learner(self, name: str) -> Learner:
        """A learner, as it was when its training ended: it can act, and go on learning.

        Raises
        ------
        ValueError
            If there is none of that name, or it cannot be made here.
        """
        return self._learner(name)[0]

    def evaluate(
        self, environment: Any = None, episodes: int = 100, *, seed: int = 0, max_steps: int = 100_000
    ) -> Evaluation:
        """Play episodes with every learner, without exploring and as while it was trained; nothing is learned.

        Parameters
        ----------
        environment:
            An `apel.EnvironmentConfig`, a Gymnasium id, an import path, or what makes the environment; None: that in
            which it was trained, as it was in its run.
        episodes:
            Of each learner, each with a seed of its own, the same for all.
        seed:
            From which these follow.
        max_steps:
            Where an episode is cut off that does not end.

        Raises
        ------
        ValueError
            If the environment cannot be made, or has other spaces.
        """
        config = self.environment(environment)
        return evaluate_learners(self.content, config, episodes, seed, max_steps, self._selected(episodes))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write it into a folder, from which `apel.load` reads it, in any process.

        Raises
        ------
        ValueError
            If the folder holds something else, or a learner's state is no tree of arrays and plain values.
        """
        write_agent(self.content, path)

    def only(self, name: str) -> Self:
        """The agent of one of its learners alone."""
        content = self.content
        at = self._index(name)
        scores = content.scores[at : at + 1]
        one = replace(content, learners=content.learners[at : at + 1], scores=scores, acting=BEST)
        return type(self)(replace(one, selector=fixed_selector(content.selector.stream)), trust=self._trust)

    def _index(self, name: str) -> int:
        if name not in self.names:
            message = f"found the learner {name!r}, expected one of {self.names}"
            raise ValueError(message)
        return self.names.index(name)

    def _learner(self, name: str) -> tuple[Learner, View]:
        if name not in self._made:
            self._made[name] = make_trained(self._content, self._index(name))
        return self._made[name]

    def _trained(self, one: TrainedLearner) -> TrainedLearner:
        return replace(one, state=self._made[one.name][0].state()) if one.name in self._made else one

    def _seen(self, observation: Any, info: Mapping[str, Any], *, explore: bool) -> tuple[NDArray[Any], str]:
        """What the acting learner sees (``[1, …]``), and who that is."""
        raw = entry_of(self._content, observation, info)
        if self._now is not None:
            return self._sights[self._now].push(_ONLY, raw), self._now
        self._now = self._next(explore=explore)
        self._sights[self._now] = Sight([self._learner(self._now)[1]])
        return self._sights[self._now].start(_ONLY, raw), self._now

    def _next(self, *, explore: bool) -> str:
        """Who acts in the coming episode."""
        if self.acting == SELECTOR:
            return self.names[self._select(self._row, self._stream, self._floor if explore else None)]
        return self.best if self.acting == BEST else self.acting

    def _selected(self, episodes: int) -> dict[Mode, NDArray[np.int64]]:
        """``int64[episodes]``: whom the selector would select, again and again as it stands; and who would play while
        they were trained, where a floor lets others do so, too.
        """
        found: dict[Mode, NDArray[np.int64]] = {}
        for mode in MODES:
            row, stream = self._row.copy(), self._stream.copy()
            floor = None if mode == "greedy" or self._floor is None else self._floor.copy()
            found[mode] = np.array([self._select(row, stream, floor) for _ in range(episodes)], dtype=np.int64)
        return found

    def _select(self, row: NDArray[np.float64], stream: NDArray[np.uint64], floor: TrainedFloor | None) -> int:
        count = len(self.names)
        selected = int(self._selector.select(self._selector.parameters(), count, row, stream))
        if floor is None:
            return selected
        return int(under_floor(floor.share, selected, floor.played, floor.length, row[:count].copy(), floor.stream))

    def environment(self, environment: Any = None) -> EnvironmentConfig:
        """What an environment is made from, see `evaluate`.

        Raises
        ------
        ValueError
            If it names code that is not shipped, and such code may not run.
        """
        config = self._content.environment if environment is None else environment
        config = config if isinstance(config, EnvironmentConfig) else EnvironmentConfig(config)
        if not self._trust and (named := foreign_environment(config)):
            raise ValueError(_distrusted(named))
        return config


def _distrusted(named: list[str]) -> str:
    listed = "".join(f"\n  {name}" for name in named)
    return (
        f"found code that is not shipped, which this agent would run:{listed}\n"
        "if you know whose it is, and trust it: apel.load(…, trust=True), or --trust"
    )
