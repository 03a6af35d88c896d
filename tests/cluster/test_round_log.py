"""A shard in an impossible state says which run, whose, and what came before; wherever it is noticed."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from apel.experience.trajectory import Episodes
from apel.learners.base import Played
from apel.run.impossible import ImpossibleStateError
from cluster.learner_host import LearnerHost
from cluster.local import LocalHosts
from cluster.round_log import RoundLog
from cluster.run_replay import replay_run
from cluster.shard import Execution, RunPlan, Shard
from tests.cluster.test_coordinator import Memory, play, shard_of

ONE_BY_ONE = Execution(streak_episodes=1)


class Forging(LocalHosts):
    """Hosts whose answer of the third round is not what was played: an episode per round, with such columns."""

    def __init__(self, **columns: int) -> None:
        super().__init__()
        self.columns, self.rounds = columns, 0

    def play(self, orders: Sequence[Sequence[int]]) -> list[Played]:
        answers = super().play(orders)
        self.rounds += 1
        if self.rounds == 3:
            host = next(i for i, answer in enumerate(answers) if len(answer.episodes.run))
            episodes = answers[host].episodes
            new = {name: np.full_like(getattr(episodes, name), value) for name, value in self.columns.items()}
            answers[host] = replace(answers[host], episodes=episodes._replace(**new))
        return answers


def test_gap(small: Path) -> None:
    """An episode that does not go on where the coordinator's book stands: run, seed, learner, expected and found."""
    shard = shard_of(small, "runs=1", arm="Q_full")
    with pytest.raises(ImpossibleStateError) as raised:
        play(shard, Memory(), Execution(streak_episodes=1, streak_steps=1), Forging(episode=70))
    error = raised.value
    facts = error.facts
    seed = shard.runs[0].seed
    assert facts["shard"] == "Q_full · runs 0-0"
    assert (facts["noticed by"], facts["run"], facts["seed"]) == ("the coordinator", 0, seed)
    assert (facts["learner"], facts["expected episode"], facts["found episode"]) == ("Q_full", 2, 70)
    assert error.story[:-1] == (
        "round 1: the book stood before episode 0 of run 0; to play: Q_full",
        "round 2: the book stood before episode 1 of run 0; to play: Q_full",
        "round 3: the book stood before episode 2 of run 0; to play: Q_full",
    )
    assert "the episodes do not go on where the book of the shard stands" in str(error)
    assert f"seed {seed}, learner Q_full" in str(error)
    again = pickle.loads(pickle.dumps(error))
    assert str(again) == str(error)


def test_run_that_nobody_ordered(small: Path) -> None:
    """A host that plays what it was not told to."""
    shard = shard_of(small)
    with pytest.raises(ImpossibleStateError, match="that the learner's host was not told to play") as raised:
        play(shard, Memory(), ONE_BY_ONE, Strange())
    facts = raised.value.facts
    assert (facts["run"], facts["seed"], facts["learner"]) == (5, shard.runs[5].seed, "Q_red")
    assert raised.value.story == ("round 1: the book stood before episode 0 of run 5; to play: Q_full",)


class Strange(LocalHosts):
    """Hosts of which the second plays run 5 in place of the first."""

    def play(self, orders: Sequence[Sequence[int]]) -> list[Played]:
        answers = super().play(orders)
        assert 5 in orders[0]
        strange = Episodes.empty(1)
        strange.run[0], strange.episode[0] = 5, 0
        return [answers[0], Played(strange)]


def _host(shard: Shard, index: int) -> LearnerHost:
    host = LearnerHost()
    host.prepare(shard, index, ONE_BY_ONE, None)
    return host


def _players(shard: Shard) -> tuple[list[LearnerHost], int]:
    """The hosts, and which of them is to play the first episode of run 0."""
    hosts = [_host(shard, index) for index in range(2)]
    return hosts, int(hosts[0]._book.learner[0])


def test_gap_at_a_host(small: Path) -> None:
    """A host that missed what another one played says so itself."""
    hosts, player = _players(shard_of(small, "stop_when_met=false"))
    batch = None
    while batch is None or 1 not in batch.episodes.episode:
        # It plays until the selector names the other one; that one then hears of the last episodes alone.
        _, batch = hosts[player].play([0] if hosts[player]._book.learner[0] == player else [])
        assert batch is not None
    other = 1 - player
    with pytest.raises(ImpossibleStateError) as raised:
        hosts[other].play([], batch)
    facts = raised.value.facts
    names = ("Q_full", "Q_red")
    assert (facts["noticed by"], facts["run"]) == (f"the host of {names[other]}", 0)
    assert (facts["expected episode"], facts["found episode"]) == (0, 1)


def test_turn_that_is_not_its_own(small: Path) -> None:
    """A host that is told to play where its own book names another learner would answer with nothing for ever."""
    shard = shard_of(small)
    hosts, player = _players(shard)
    other = 1 - player
    with pytest.raises(ImpossibleStateError, match="not its own by its own book") as raised:
        hosts[other].play([0])
    facts = raised.value.facts
    assert (facts["run"], facts["seed"], facts["selected learner"]) == (0, shard.runs[0].seed, player)


def test_only_the_last_rounds_are_told(small: Path) -> None:
    """However long a shard is played, the story stays short; a position that no run has tells of the shard alone."""
    shard = shard_of(small)
    log = RoundLog(shard, "the coordinator")
    for number in range(100):
        log.begun({0: [0], 1: [1, 2]}, np.full(6, number))
    what = ImpossibleStateError("found a gap", {"position in the shard": 2})
    with pytest.raises(ImpossibleStateError) as raised, log.telling():
        raise what
    assert raised.value.story == tuple(
        f"round {number}: the book stood before episode {number - 1} of run 2; to play: Q_red"
        for number in range(96, 101)
    )
    with pytest.raises(ImpossibleStateError) as raised, log.telling():
        raise ImpossibleStateError("found a gap", {"position in the shard": 6})
    assert raised.value.facts == {
        "shard": "APEL · runs 0-5",
        "noticed by": "the coordinator",
        "position in the shard": 6,
    }


def test_replayed_run_without_its_trajectory(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A round whose trajectories lack an episode that was played in it names run, seed and learner."""
    shard = shard_of(small)
    monkeypatch.setattr("apel.experience.trajectory.TrajectoryBatch.trajectories", lambda _: iter(()))
    with pytest.raises(ImpossibleStateError, match="lack an episode") as raised:
        replay_run(replace(shard.arm, learner_names=("Q_full",)), _alone(shard), 3)
    assert raised.value.facts["seed"] == shard.runs[0].seed
    assert (raised.value.facts["learner"], raised.value.facts["expected episode"]) == ("Q_full", 3)


def _alone(shard: Shard) -> RunPlan:
    return replace(shard.runs[0], learners=shard.runs[0].learners[:1])
