"""One run played again in this process, for what no result file holds: the actions of an episode.

A result depends on the experiment and its seed alone, so this is the run itself and no other one like it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from apel.agents.content import AgentContent
from apel.environments import World, close_environments
from apel.experience.trajectory import Trajectory, TrajectoryBatch
from apel.learners.base import Failure, Played, UnbuildableError
from apel.run.impossible import ImpossibleStateError
from cluster.learner_host import make_run_world
from cluster.local import LocalHosts
from cluster.models import agents_of
from cluster.shard import ArmPlan, EverySteps, Execution, RunPlan, Shard
from cluster.shard_state import ShardState

# Short rounds: few episodes are played beyond the one that is wanted, and its progress is told often.
_EXECUTION = Execution(round_seconds=0.5)


@dataclass(frozen=True)
class Replay:
    """What was played of a run, from its beginning; E is the number of its episodes.

    Attributes
    ----------
    learner:
        ``int64[E]``: who played each.
    length:
        ``int64[E]``, in steps.
    episode_return:
        ``float64[E]``.
    """

    learner: NDArray[np.int64]
    length: NDArray[np.int64]
    episode_return: NDArray[np.float64]


@dataclass(frozen=True)
class ReplayedRun(Replay):
    """A run up to an episode.

    Attributes
    ----------
    trajectory:
        Of the last one.
    """

    trajectory: Trajectory


@dataclass(frozen=True)
class ReplayedModel(Replay):
    """A run up to its end, or to so many steps.

    Attributes
    ----------
    model:
        What it has come to then.
    """

    model: AgentContent


def replay_run(arm: ArmPlan, run: RunPlan, episode: int, told: Callable[[int], None] = lambda _: None) -> ReplayedRun:
    """Play ``run`` again up to and with ``episode``, in the rounds of a coordinator; nothing is stored.

    ``told`` gets the number of episodes so far after every round.

    Raises
    ------
    ValueError
        If the run cannot be built, fails, or ends before that episode.
    """
    hosts = LocalHosts(records=True)
    try:
        return _replay(arm, run, episode, hosts, told)
    finally:
        hosts.close()


def replay_model(
    arm: ArmPlan, run: RunPlan, steps: int | None = None, told: Callable[[int], None] = lambda _: None
) -> ReplayedModel:
    """Play ``run`` again up to its end, or up to and with the episode in which its steps reach ``steps``.

    ``told`` gets the number of episodes so far after every round; nothing is stored.

    Raises
    ------
    ValueError
        If the run cannot be built, fails, or ends before that.
    """
    shard = Shard(replace(arm, recording="none", models="none" if steps is None else EverySteps(steps)), (run,))
    hosts = LocalHosts()
    try:
        world, state = _begun(shard, hosts)
        log = _Log(arm, run, None)
        while state.is_running() and (steps is None or state.book.steps[0] < steps):
            orders = state.orders()
            answers = hosts.play(orders)
            state.take_in(answers, orders)
            log.add(answers, hosts.latest())
            told(state.num_episodes())
        if state.output.failures or (steps is not None and state.book.steps[0] < steps):
            raise ValueError(_too_short(state, f"more than {steps} steps" if steps else "it to end well"))
        models, failures = zip(*hosts.models([0]), strict=True)
        for failure in (one for of_host in failures for one in of_host):
            raise ValueError(failure.error)
        ((_, model),) = agents_of(shard, [world], state.book, [0], models)
        return ReplayedModel(*log.columns(state.num_episodes()), model)
    finally:
        hosts.close()


def play_run(arm: ArmPlan, run: RunPlan) -> tuple[Failure, ...]:
    """Play ``run`` to its end, for a debugger: what a user's code raises is raised.

    Returns how it failed without raising anything, such as with a performance that is not finite; nothing is stored.
    """
    shard, hosts = Shard(replace(arm, recording="none"), (run,)), LocalHosts()
    try:
        world = make_run_world(run)
        close_environments([world.environment])
        state = ShardState(shard, [world])
        hosts.prepare(shard, replace(_EXECUTION, raises=True), None)
        while state.is_running():
            orders = state.orders()
            state.take_in(hosts.play(orders), orders)
            state.output.rows.clear()
        for learner, failures in enumerate(hosts.catch_up()):
            state.fail(failures, learner)
    finally:
        hosts.close()
    return tuple(failure for failure, _ in state.output.failures)


def _replay(arm: ArmPlan, run: RunPlan, episode: int, hosts: LocalHosts, told: Callable[[int], None]) -> ReplayedRun:
    shard = Shard(replace(arm, recording="none", models="none"), (run,))
    (_, state), log = _begun(shard, hosts), _Log(arm, run, episode)
    while state.is_running():
        orders = state.orders()
        answers = hosts.play(orders)
        state.take_in(answers, orders)
        log.add(answers, hosts.latest())
        told(min(state.num_episodes(), episode + 1))
        if log.trajectory is not None:
            return log.replayed_run(log.trajectory)
    raise ValueError(_too_short(state, f"more than {episode}"))


def _begun(shard: Shard, hosts: LocalHosts) -> tuple[World, ShardState]:
    """The world of a run and its state before the first episode, with the hosts ready."""
    world = make_run_world(shard.runs[0])
    close_environments([world.environment])  # it has told what it has to tell
    state = ShardState(shard, [world])
    try:
        hosts.prepare(shard, _EXECUTION, None)
    except UnbuildableError as error:
        raise ValueError(str(error)) from error
    return world, state


def _too_short(state: ShardState, expected: str) -> str:
    failures = "; ".join(failure.error for failure, _ in state.output.failures)
    message = f"found the end of the run after {state.num_episodes()} episodes, expected {expected} {failures}"
    return message.strip()


class _Log:
    """What was played so far."""

    def __init__(self, arm: ArmPlan, run: RunPlan, episode: int | None) -> None:
        self.trajectory: Trajectory | None = None
        self._names, self._run = arm.learner_names, run
        self._episode = episode
        self._columns: list[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]] = []

    def add(self, answers: Sequence[Played], batches: Sequence[TrajectoryBatch | None]) -> None:
        """Take in a round: of a single run one host has played it, the others nothing."""
        for learner, (answer, batch) in enumerate(zip(answers, batches, strict=True)):
            played = answer.episodes
            self._columns.append((np.full(len(played.run), learner), played.length, played.episode_return))
            if batch is not None and self._episode in played.episode:
                self.trajectory = self._trajectory(batch, self._names[learner])

    def replayed_run(self, trajectory: Trajectory) -> ReplayedRun:
        """All of it up to the wanted episode."""
        return ReplayedRun(*self.columns((self._episode or 0) + 1), trajectory)

    def columns(self, count: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Learner, length and return of the first ``count`` episodes."""
        learner, length, episode_return = map(np.concatenate, zip(*self._columns, strict=True))
        return learner[:count], length[:count], episode_return[:count]

    def _trajectory(self, batch: TrajectoryBatch, learner: str) -> Trajectory:
        for _, episode, trajectory in batch.trajectories():
            if episode == self._episode:
                return trajectory
        facts: dict[str, int | str] = {"run": self._run.index, "seed": self._run.seed, "learner": learner}
        facts |= {
            "expected episode": -1 if self._episode is None else self._episode,
            "found episodes": str(batch.episodes.episode.tolist()),
        }
        what = "the trajectories of a round lack an episode that was played in it"
        raise ImpossibleStateError(what, facts)
