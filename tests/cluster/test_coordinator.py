"""A shard in local mode: what it yields, how user errors end single runs, and how it goes on from a checkpoint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from apel.learners.base import State
from apel.run.state import EpisodeRows
from cluster.checkpoint import CheckpointError, pack, seal, unpack, unseal
from cluster.coordinator import Coordinator
from cluster.events import ShardDone, ShardProgress, ShardReplayed
from cluster.local import LocalHosts
from cluster.protocols import RunRows
from cluster.shard import Execution, Shard
from cluster.shard_state import CHECKPOINT_VERSION
from tests.cluster.shards import FailingHosts, Memory, play, shard_of, with_user_code


def test_a_shard_ends_with_its_rows(small: Path) -> None:
    """Every run has a row, and every episode played one."""
    memory = Memory()
    done = play(shard_of(small), memory)
    assert memory.runs is not None
    assert memory.runs.position.tolist() == [0, 1, 2, 3, 4, 5]
    assert sum(len(rows.run) for rows in memory.rows) == memory.runs.episodes.sum()
    assert done.failures == ()
    assert done.steps == memory.runs.steps.sum()


def test_every_report_tells_of_episodes(small: Path) -> None:
    """However short the time between two: the last of a shard, too, tells how the episodes before it went."""
    memory = Memory()
    coordinator = Coordinator(LocalHosts(), memory, memory, Execution(progress_seconds=0.0))
    *reports, _ = coordinator.run(shard_of(small))
    assert len(reports) > 1
    assert all(sum(report.played) > 0 for report in reports if isinstance(report, ShardProgress))


def test_users_code_plays(small: Path) -> None:
    """A user's environment, learner, plain-Python selector and measure play beside ours."""
    overrides = (
        *with_user_code(""),
        "arms.APEL.selector.type=tests.user_code:RoundRobin",
        "performance=tests.user_code:shortness",
    )
    memory = Memory()
    assert play(shard_of(small, *overrides), memory).failures == ()
    selected = np.concatenate([rows.selected[rows.run == 0] for rows in memory.rows])
    episode = np.concatenate([rows.episode[rows.run == 0] for rows in memory.rows])
    assert selected[np.argsort(episode)].tolist() == [0, 1] * 40


FAULTS = {
    "an environment that raises": (with_user_code("raise"), "OSError: the motor is stuck", 40),
    "a reward that is no number": (
        with_user_code("nan"),
        "ValueError: step 1: found the reward nan, expected a finite number",
        40,
    ),
    "a measure that is no number": (
        (*with_user_code(""), "performance=tests.user_code:no_number"),
        "found the performance inf, expected a finite number",
        0,
    ),
    "rewards whose sum is no number": (
        (*with_user_code("huge"), "performance=negative_length"),
        "found the return inf, expected a finite number",
        40,
    ),
    "a learner that raises": (with_user_code("", "tests.user_code:Choosy"), "RuntimeError: out of ideas", 20),
}


@pytest.mark.parametrize("name", FAULTS)
def test_user_error_ends_its_runs(small: Path, name: str) -> None:
    """An error of user code ends the run and names seed, learner and episode; nothing of it is stored as a result."""
    overrides, error, episode = FAULTS[name]
    memory = Memory()
    # Environments count their own resets, so that the fault comes when this host has played that many episodes.
    overrides = (*overrides, "arms.APEL.learners=[W]") if "environment" in name or "reward" in name else overrides
    done = play(shard_of(small, *overrides), memory)
    assert {failure.error for failure in done.failures} == {error}
    assert sorted(failure.run_index for failure in done.failures) == [0, 1, 2, 3, 4, 5]
    assert {failure.episode for failure in done.failures} == {episode}
    assert done.failures[0].seed == 1892932127
    assert memory.runs is not None
    assert len(memory.runs.position) == 0


def test_one_failing_run_leaves_the_others(small: Path) -> None:
    """Runs that do not fail are finished and stored, with the rows they have without the failing one."""
    shard = shard_of(small)
    broken = Shard(shard.arm, tuple(run if run.index != 2 else _unbuildable(run) for run in shard.runs))
    memory, alone = Memory(), Memory()
    done = play(broken, memory)
    assert [failure.run_index for failure in done.failures] == [2]
    assert "none of 3 mazes" in done.failures[0].error
    play(shard.without([2]), alone)
    assert memory.sorted_rows() == alone.sorted_rows()


FREQUENT = Execution(checkpoint_episodes=1, checkpoint_seconds=0.0, checkpoint_share=1.0)


@pytest.mark.parametrize("models", ["none", "final"])
@pytest.mark.parametrize(
    "execution", [Execution(), Execution(streak_episodes=3), Execution(streak_episodes=5), FREQUENT]
)
@pytest.mark.parametrize("runs", [[0], [0, 1, 2]])
def test_failing_at_anothers_last_episodes(small: Path, runs: list[int], execution: Execution, models: str) -> None:
    """A learner that fails at an episode of another's fails its run, also where no round comes after it."""
    overrides = (*with_user_code("", "tests.user_code:Tiring"), "learners.W.last=7", "episodes=8", f"models={models}")
    memory = Memory()
    shard = shard_of(small, *overrides, "arms.APEL.selector.type=fixed").only(runs)
    done = play(shard, memory, execution)
    assert memory.runs is not None
    assert memory.runs.position.tolist() == []
    found = [(failure.run_index, failure.learner, failure.episode, failure.error) for failure in done.failures]
    assert found == [(run, "W", 7, "RuntimeError: out of ideas") for run in runs]


def test_shard_without_a_buildable_run(small: Path) -> None:
    """Where no environment of a shard can be made, every run is told of, and nothing is played or stored."""
    shard = shard_of(small)
    memory = Memory()
    done = play(Shard(shard.arm, tuple(_unbuildable(run) for run in shard.runs)), memory)
    assert [failure.run_index for failure in done.failures] == [0, 1, 2, 3, 4, 5]
    assert {failure.learner for failure in done.failures} == {"(environment)"}
    assert memory.runs is not None
    assert len(memory.runs.position) == 0


def _unbuildable(run: Any) -> Any:
    options = {**run.environment.options, "optimal_length": 1, "max_draws": 3}
    environment = type(run.environment)(run.environment.id, options, run.environment.run_seed)
    return type(run)(run.index, run.seed, environment, run.learners, run.variables)


@pytest.mark.parametrize("rounds", [1, 2, 7, 30])
def test_goes_on_from_the_checkpoint(small: Path, rounds: int) -> None:
    """Whenever the hosts are lost, the rows are those of an undisturbed shard."""
    execution = Execution(streak_episodes=2, checkpoint_seconds=0.0, checkpoint_share=1.0)
    undisturbed, memory = Memory(), Memory()
    play(shard_of(small), undisturbed, execution)
    with pytest.raises(ConnectionError):
        play(shard_of(small), memory, execution, FailingHosts(rounds))
    assert memory.num_checkpoints == rounds
    memory.rows.clear()
    done = play(shard_of(small), memory, execution)
    assert memory.sorted_rows() == undisturbed.sorted_rows()
    assert done.rounds > rounds


DAMAGES = {
    "cut off": "cut off, or of an older version",
    "a flipped bit": "found a damaged file",
    "no seal": "of an older version",
    "another version": "found the format '0', expected",
    "another shape": "found a state of another form (ValueError",
    "another arm's": "found the arm 'SSBAS', expected 'APEL'",
    "other runs'": "found the runs '0-2', expected '0-5'",
    "other seeds'": "found the seeds ",
    "another experiment's": "found the identity ",
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_unusable_checkpoint_costs_no_result(small: Path, damage: str) -> None:
    """A checkpoint that cannot be gone on from is as good as none: the shard is played again, with a word."""
    execution = Execution(streak_episodes=2, checkpoint_seconds=0.0, checkpoint_share=1.0)
    undisturbed, memory = Memory(), Memory()
    play(shard_of(small), undisturbed, execution)
    with pytest.raises(ConnectionError):
        play(shard_of(small), memory, execution, FailingHosts(7))
    assert memory.content is not None
    memory.content = damaged(memory.content, shard_of(small), damage, small)
    memory.rows.clear()
    replayed, *progress, done = Coordinator(LocalHosts(), memory, memory, Execution(streak_episodes=2)).run(
        shard_of(small)
    )
    assert isinstance(replayed, ShardReplayed)
    assert DAMAGES[damage] in replayed.reason
    assert isinstance(done, ShardDone)
    assert all(isinstance(event, ShardProgress) for event in progress)
    assert memory.sorted_rows() == undisturbed.sorted_rows()


def damaged(content: bytes, shard: Shard, damage: str, small: Path) -> bytes:
    """A checkpoint of a shard that went through one of `DAMAGES`."""
    label = {**shard.binding, "format": str(CHECKPOINT_VERSION)}
    plain = unseal(content, label)
    run = shard.runs[0]
    others = {
        "another arm's": shard_of(small, arm="SSBAS"),
        "other runs'": Shard(shard.arm, shard.runs[:3]),
        "other seeds'": Shard(shard.arm, (replace(run, seed=run.seed + 1), *shard.runs[1:])),
        "another experiment's": shard_of(small, "episodes=81"),
    }
    if damage in others:
        return seal(plain, {**label, **others[damage].binding})
    if damage == "another shape":
        tree = unpack(plain)
        return seal(pack({**tree, "book": tree["book"][:-1]}), label)
    if damage == "another version":
        return seal(plain, {**label, "format": "0"})
    flipped = bytearray(content)
    flipped[len(content) // 2] ^= 4
    return {"cut off": content[: len(content) // 2], "a flipped bit": bytes(flipped), "no seal": plain}[damage]


def test_lost_parts_cost_no_result(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where rows that were put aside are not there any more as they were, the shard is played again, with a word."""

    class Leaky(Memory):
        leaks = True

        def commit(self, shard: Shard, runs: RunRows, parts: Sequence[str], rows: Sequence[EpisodeRows]) -> None:
            if self.leaks:
                self.leaks = False
                self.rows.clear()
                message = "found a damaged file"
                raise CheckpointError(message)
            super().commit(shard, runs, parts, rows)

    whole, memory = Memory(), Leaky()
    play(shard_of(small), whole)
    monkeypatch.setattr("cluster.coordinator._MAX_ROWS_IN_MEMORY", 20)
    events = list(Coordinator(LocalHosts(), memory, memory, Execution(streak_episodes=2)).run(shard_of(small)))
    assert [event.reason for event in events if isinstance(event, ShardReplayed)] == [
        "episodes that were put aside do not fit: found a damaged file"
    ]
    assert sum(isinstance(event, ShardDone) for event in events) == 1
    assert memory.sorted_rows() == whole.sorted_rows()


def test_users_learner_goes_on_from_the_checkpoint(small: Path) -> None:
    """The state of a user's learner is part of the checkpoint."""
    execution = Execution(streak_episodes=2, checkpoint_seconds=0.0, checkpoint_share=1.0)
    overrides = (*with_user_code(""), "environment.options.fault=''")
    undisturbed, memory = Memory(), Memory()
    play(shard_of(small, *overrides), undisturbed, execution)
    with pytest.raises(ConnectionError):
        play(shard_of(small, *overrides), memory, execution, FailingHosts(5))
    memory.rows.clear()
    play(shard_of(small, *overrides), memory, execution)
    assert memory.sorted_rows() == undisturbed.sorted_rows()


class FrozenHosts(LocalHosts):
    """Hosts whose states come with arrays that may only be read, as all do that travel through Ray's object store."""

    def prepare(self, shard: Shard, execution: Execution, states: Sequence[State] | None) -> None:
        super().prepare(shard, execution, [_frozen(state) for state in states] if states is not None else None)


def _frozen(tree: Any) -> Any:
    if isinstance(tree, np.ndarray):
        tree = tree.copy()
        tree.flags.writeable = False
    if isinstance(tree, dict):
        return {key: _frozen(child) for key, child in tree.items()}
    return [_frozen(child) for child in tree] if isinstance(tree, list) else tree


def test_state_that_has_travelled(small: Path) -> None:
    """A learner may keep the arrays of the state that it goes on from, and write into them."""
    execution = Execution(streak_episodes=2, checkpoint_seconds=0.0, checkpoint_share=1.0)
    overrides = (*with_user_code("", "tests.user_code:Counting"), "environment.options.fault=''")
    undisturbed, memory = Memory(), Memory()
    play(shard_of(small, *overrides), undisturbed, execution)
    with pytest.raises(ConnectionError):
        play(shard_of(small, *overrides), memory, execution, FailingHosts(5))
    memory.rows.clear()
    done = play(shard_of(small, *overrides), memory, execution, FrozenHosts())
    assert done.failures == ()
    assert memory.sorted_rows() == undisturbed.sorted_rows()


def test_state_that_cannot_be_stored(small: Path) -> None:
    """A learner whose state is not plain data is named at the first checkpoint."""
    execution = Execution(streak_episodes=1, checkpoint_seconds=0.0, checkpoint_share=1.0)
    with pytest.raises(CheckpointError, match=r"generator: found object, expected only"):
        play(shard_of(small, *with_user_code("", "tests.user_code:Forgetful")), Memory(), execution)


def test_memory_is_bounded(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows beyond a number are put aside, so that memory does not grow with the number of episodes."""
    monkeypatch.setattr("cluster.coordinator._MAX_ROWS_IN_MEMORY", 20)
    memory, whole = Memory(), Memory()
    play(shard_of(small), memory, Execution(streak_episodes=2))
    monkeypatch.undo()
    play(shard_of(small), whole)
    assert memory.sorted_rows() == whole.sorted_rows()
    assert len(memory.rows) > 1
