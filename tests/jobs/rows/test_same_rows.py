"""The same spec and seed give the same rows, whatever the placement, the shard size and the length of streaks."""

from __future__ import annotations

from pathlib import Path

import pytest

from cluster.shard import Execution
from tests.experiments import SMALL
from tests.forks import fork
from tests.same_rows import assert_same, play

MANY = ("runs=100", "episodes=25", "record=log")
TWO: tuple[str, ...] = ("Q_full", "APEL")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where results lie against which all others are held."""
    folder = tmp_path_factory.mktemp("reference")
    (folder / "small.yaml").write_text(SMALL)
    return folder


@pytest.fixture(scope="module")
def reference(folder: Path) -> Path:
    """All runs of an arm in one shard, in this process."""
    return play(folder / "small.yaml", folder / "results", placement="local", shard_size=100)


@pytest.fixture(scope="module")
def whole(folder: Path) -> Path:
    """A hundred short runs in one shard."""
    return play(folder / "small.yaml", folder / "many", *MANY, placement="local", shard_size=100, arms=TWO)


@pytest.mark.parametrize("shard_size", [1, 7, 50, 100])
def test_shard_size_changes_no_row(small: Path, whole: Path, tmp_path: Path, shard_size: int) -> None:
    """A hundred runs, of a learner alone and of an ensemble, give the same rows in shards of 1, 7, 50 and 100."""
    assert_same(whole, play(small, tmp_path, *MANY, placement="local", shard_size=shard_size, arms=TWO))


@pytest.mark.parametrize("streak_episodes", [1, 5, 50])
def test_streak_limit_changes_no_row(small: Path, reference: Path, tmp_path: Path, streak_episodes: int) -> None:
    """However long a host may keep a run, the rows are the same."""
    execution = Execution(streak_episodes=streak_episodes)
    assert_same(reference, play(small, tmp_path / "streak", placement="local", execution=execution))


def test_step_limit_changes_no_row(small: Path, reference: Path, tmp_path: Path) -> None:
    """However large a message may be, the rows are the same."""
    execution = Execution(streak_steps=1)
    assert_same(reference, play(small, tmp_path / "steps", placement="local", execution=execution))


@pytest.mark.ray
@pytest.mark.parametrize(("placement", "shard_size"), [("actors", 2), ("packed", 100)])
def test_placement_changes_no_row(
    ray_session: None, small: Path, reference: Path, tmp_path: Path, placement: str, shard_size: int
) -> None:
    """Ray actors give the rows that this process gives."""
    assert_same(reference, play(small, tmp_path / "ray", placement=placement, shard_size=shard_size))


def play_with(spec: Path, results: Path, cpus: int) -> None:
    """Play with a Ray of one's own."""
    play(spec, results, num_cpus=cpus, shard_size=2, arms=TWO)


@pytest.mark.ray
def test_number_of_cpus_changes_no_row(small: Path, reference: Path, tmp_path: Path) -> None:
    """A Ray of one CPU, with more actors than that, gives the rows that one of two gives, without deadlock."""
    assert fork(play_with, small, tmp_path / "cpus", 1) == 0
    assert_same(reference, tmp_path / "cpus" / "small-maze" / reference.name, *TWO)
