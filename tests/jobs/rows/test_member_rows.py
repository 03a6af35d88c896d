"""Who learns from what, and who must act: the same rows in any shards and streaks, after a loss, and by Algorithm 5."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from apel import ActingFloor, Ensemble
from apel.building import make_selector
from cluster.learner_host import make_run_world
from cluster.shard import Execution
from jobs.experiment.plan import Plan
from jobs.experiment.spec_files import load_experiment
from tests.cluster.losing import assert_goes_on
from tests.experiments import SMALL
from tests.same_rows import assert_same, episode_rows, play

# Its exploration ends by a clock of its own: with its twentieth own episode, whatever that of the run is.
OWN = "Q_full: {type: q_learning, learns_from: own, exploration: {before: 0.9, episode: 20, after: 0.0}}"
MEMBERS = SMALL.replace("Q_full: {type: q_learning}", OWN).replace(
    "decay: 0.01}", "decay: 0.01, acting_floor: {steps: 0.2}}"
)
EPOCHS = """
name: epochs
runs: 4
episodes: 70
environment: {id: apel/Maze-v0, run_seed: maze_seed, options: {size: 4, max_steps: 60}}
learners:
  one: {type: q_learning, learns_from: own}
  two: {type: q_learning, learns_from: own, learning_rate: 0.5}
  three: {type: q_learning, learns_from: own, learning_rate: 0.05}
arms: {ESBAS: {learners: [one, two, three], selector: {type: esbas}}}
record: all
"""
RETICENT = """
name: reticent
runs: 3
episodes: 40
environment: {id: apel/CartPole-v0, options: {max_steps: 60}}
learners:
  W: {type: "tests.user_code:Reticent", share: 0.5}
  A: {type: acer, network: {hidden: [8]}, learning_starts: 1, rollout: 5}
arms: {APEL: {learners: [W, A], selector: {type: apel, decay: 0.1}}}
record: all
"""


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of the experiment."""
    path = tmp_path_factory.mktemp("members") / "members.yaml"
    path.write_text(MEMBERS)
    return path


@pytest.fixture(scope="module")
def reference(spec: Path) -> Path:
    """All runs of an arm in one shard, in this process."""
    return play(spec, spec.parent / "reference", placement="local", shard_size=100, arms=("APEL",))


@pytest.mark.parametrize(("shard_size", "streak"), [(1, 50), (100, 1), (4, 3)])
def test_shards_and_streaks_change_no_row(
    spec: Path, reference: Path, tmp_path: Path, shard_size: int, streak: int
) -> None:
    """However many runs lie in a shard, and however long a host keeps one."""
    execution = Execution(streak_episodes=streak)
    options = {"placement": "local", "shard_size": shard_size, "execution": execution, "arms": ("APEL",)}
    assert_same(reference, play(spec, tmp_path, **options))


@pytest.mark.parametrize("rounds", [2, 9])
def test_goes_on_from_the_checkpoint(spec: Path, rounds: int) -> None:
    """A shard that is lost ends with the rows of an undisturbed one."""
    shard = Plan.of(load_experiment(str(spec))).only(["APEL"]).shards(num_cpus=1, shard_size=100)[-1]
    assert_goes_on(shard, rounds)


def test_as_algorithm_5(spec: Path, reference: Path) -> None:
    """A job stores what the readable loop gives; both fields made a difference."""
    shard = Plan.of(load_experiment(str(spec))).only(["APEL"]).shards(num_cpus=1, shard_size=100)[0]
    arm, run = shard.arm, shard.runs[0]
    selector, floor = make_selector(arm.selector), ActingFloor(0.2)
    args = make_run_world(run), run.learners, selector, run.seed, arm.num_episodes
    loop = Ensemble(*args, performance=arm.performance, criterion=arm.criterion, acting_floor=floor)
    records = list(loop.run())
    stored = episode_rows(reference)
    rows = stored[stored["run_index"] == run.index]
    assert rows["selected"].tolist() == [record.selected for record in records]
    assert rows["return"].tolist() == [record.episode_return for record in records]


@pytest.mark.parametrize("override", ["learners.Q_full.learns_from=all", "arms.APEL.selector.acting_floor=null"])
def test_both_matter(spec: Path, reference: Path, tmp_path: Path, override: str) -> None:
    """Another experiment, with other rows."""
    other = play(spec, tmp_path, override, placement="local", shard_size=100, arms=("APEL",))
    assert other.name != reference.name
    with pytest.raises(AssertionError):
        assert_same(reference, other)


def learned(table: Any) -> dict[Any, list[float]]:
    """What is known of states; looking at one adds it without anything."""
    return {key: values.tolist() for key, values in table.items() if values.any()}


def test_epochs_begin_for_all(tmp_path: Path) -> None:
    """Under ESBAS a learner that learns from its own episodes acts from an epoch's first episode on as it knows then,
    whoever plays that one; a job gives the rows of the readable loop.
    """
    spec = tmp_path / "epochs.yaml"
    spec.write_text(EPOCHS)
    (shard,) = Plan.of(load_experiment(str(spec))).shards(num_cpus=1, shard_size=100)
    stored = episode_rows(play(spec, tmp_path, placement="local", shard_size=100))
    num_known = 0
    for run in shard.runs:
        loop = Ensemble(make_run_world(run), run.learners, make_selector(shard.arm.selector), run.seed, 70)
        selected = [loop.run_episode().selected for _ in range(15)]
        known = [learned(learner.table) for learner in loop.learners]  # type: ignore[attr-defined]
        selected += [loop.run_episode().selected for _ in range(15)]
        frozen = [learned(learner.frozen) for learner in loop.learners]  # type: ignore[attr-defined]
        selected += [loop.run_episode().selected for _ in range(40)]
        assert frozen == known
        num_known += sum(map(len, known))
        assert stored[stored["run_index"] == run.index]["selected"].tolist() == selected
    assert num_known > 0


def test_what_one_keeps_to_itself_concerns_its_episodes_alone(tmp_path: Path) -> None:
    """ACER learns with μ from the episodes of which it is known, whatever other episodes, and runs, are beside them."""
    spec = tmp_path / "reticent.yaml"
    spec.write_text(RETICENT)
    alone = play(spec, tmp_path / "alone", placement="local", shard_size=1)
    assert_same(alone, play(spec, tmp_path / "together", placement="local", shard_size=100))
    short = Execution(streak_episodes=1)
    assert_same(alone, play(spec, tmp_path / "short", placement="local", shard_size=2, execution=short))
