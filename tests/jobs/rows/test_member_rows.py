"""Who learns from what, and who must act: the same rows in any shards and streaks, after a loss, and by Algorithm 5."""

from __future__ import annotations

from pathlib import Path

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

MEMBERS = SMALL.replace("Q_full: {type: q_learning}", "Q_full: {type: q_learning, learns_from: own}").replace(
    "decay: 0.01}", "decay: 0.01, acting_floor: {steps: 0.2}}"
)


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
