"""From stored results to the agent of one of their runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from apel.agents import Agent
from apel.agents.content import AgentContent
from cluster.run_replay import replay_model
from jobs.agents.kept import kept_model, refuse_steps_not_kept
from jobs.experiment.yaml_source import SpecError
from jobs.films.scenes import Scene, check_replay
from jobs.results.store import ResultStore

_MOST_STEPS = 10_000


@dataclass(frozen=True)
class Exported:
    """An agent, and how it was come by.

    Attributes
    ----------
    was_kept:
        Whether it was kept with the results; else its run was played again.
    num_checked:
        How many recorded episodes the replay was held against.
    """

    agent: Agent
    was_kept: bool
    num_checked: int = 0


def agent_of(
    store: ResultStore, scene: Scene, steps: int | None, told: Callable[[int], None], *, trust: bool
) -> Exported:
    """The agent of a run at its end, or with the episode in which its steps reached ``steps``.

    Raises
    ------
    SpecError
        If the run cannot be played again, or has not so many steps.
    StoreError
        If what is kept is damaged, or the replay is not what is stored.
    """
    if steps is not None:
        refuse_steps_not_kept(store.folder, scene.arm, scene.run, steps)
    try:
        kept = kept_model(store.folder, scene.arm, scene.run, steps)
        if kept is not None:
            return Exported(Agent(_with_parts(kept, scene), trust=trust), was_kept=True)
        replay = replay_model(scene.arm, scene.to_play(), steps, told)
        num_checked = check_replay(store, replace(scene, episode=len(replay.length) - 1), replay)
        return Exported(Agent(replay.model, trust=trust), was_kept=False, num_checked=num_checked)
    except ValueError as error:
        raise SpecError(str(error)) from error


def _with_parts(kept: AgentContent, scene: Scene) -> AgentContent:
    """What was kept knows its parts by name; of a script, which may hold them, the parts themselves."""
    learners = zip(kept.learners, scene.run.learners, strict=True)
    return replace(
        kept,
        environment=scene.run.environment,
        learners=tuple(replace(one, config=replace(config, start=None)) for one, config in learners),
        selector=replace(kept.selector, config=scene.arm.selector),
    )


def with_scores(agent: Agent, episodes: int, *, trust: bool) -> Agent:
    """The same agent, its best learner told by its mean return of greedy episodes in its own environment.

    Learners that cannot act greedily are told by their episodes as trained.
    """
    played = agent.evaluate(episodes=episodes, seed=1, max_steps=_MOST_STEPS).played
    best = {one.learner: one.mean for one in reversed(played)}  # greedy ones stand before those as trained
    scores = tuple(best[name] for name in agent.names)
    content: AgentContent = replace(agent.content, scores=scores, score_name=f"mean return of {episodes} episodes")
    return Agent(content, trust=trust)


def refuse_other_learner(names: list[str], wanted: str | None) -> None:
    """See that there is such a learner."""
    if wanted is not None and wanted not in names:
        message = f"--learner: found {wanted!r}, expected one of {', '.join(names)}"
        raise SpecError(message)
