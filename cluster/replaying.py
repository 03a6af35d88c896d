"""One run played again in this process, for what no result file holds: the actions of an episode.

A result depends on the experiment and its seed alone, so this is the run itself and no other one like it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from apel.learners.base import Played
from apel.trajectory import Trajectory, TrajectoryBatch
from cluster.learner_host import make_run_world
from cluster.local import LocalHosts
from cluster.play import Play
from cluster.shard import ArmPlan, Execution, RunPlan, Shard

# Short rounds: few episodes are played beyond the one that is wanted, and its progress is told often.
_EXECUTION = Execution(round_seconds=0.5)


@dataclass(frozen=True)
class Replay:
    """A run from its beginning up to an episode; E is the number of its episodes.

    Attributes
    ----------
    learner:
        ``int64[E]``: who played each.
    length:
        ``int64[E]``, in steps.
    episode_return:
        ``float64[E]``.
    trajectory:
        Of the last one.
    """

    learner: NDArray[np.int64]
    length: NDArray[np.int64]
    episode_return: NDArray[np.float64]
    trajectory: Trajectory


def replay_run(arm: ArmPlan, run: RunPlan, episode: int, told: Callable[[int], None] = lambda _: None) -> Replay:
    """Play ``run`` again up to and with ``episode``, in the rounds of a coordinator; nothing is stored.

    ``told`` gets the number of episodes so far after every round.

    Raises
    ------
    ValueError
        If the run cannot be built, fails, or ends before that episode.
    """
    shard = Shard(replace(arm, recording="none"), (run,))
    play, hosts, log = Play(shard, [make_run_world(run)]), LocalHosts(records=True), _Log(episode)
    hosts.prepare(shard, _EXECUTION, None)
    while play.is_running():
        orders = play.orders()
        answers = hosts.play(orders)
        play.take_in(answers, orders)
        log.add(answers, hosts.latest())
        told(min(play.num_episodes(), episode + 1))
        if log.trajectory is not None:
            return log.replay(log.trajectory)
    failures = "; ".join(failure.error for failure, _ in play.progress.failures)
    message = f"found the end of the run after {play.num_episodes()} episodes, expected more than {episode} {failures}"
    raise ValueError(message.strip())


class _Log:
    """What was played so far."""

    def __init__(self, episode: int) -> None:
        self.trajectory: Trajectory | None = None
        self._episode = episode
        self._columns: list[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]] = []

    def add(self, answers: Sequence[Played], batches: Sequence[TrajectoryBatch | None]) -> None:
        """Take in a round: of a single run one host has played it, the others nothing."""
        for learner, (answer, batch) in enumerate(zip(answers, batches, strict=True)):
            played = answer.episodes
            self._columns.append((np.full(len(played.run), learner), played.length, played.episode_return))
            if batch is not None and self._episode in played.episode:
                found = (trajectory for _, episode, trajectory in batch.trajectories() if episode == self._episode)
                self.trajectory = next(found)

    def replay(self, trajectory: Trajectory) -> Replay:
        """All of it up to the wanted episode."""
        count = self._episode + 1
        learner, length, episode_return = map(np.concatenate, zip(*self._columns, strict=True))
        return Replay(learner[:count], length[:count], episode_return[:count], trajectory)
