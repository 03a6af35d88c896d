"""GPUs reach the learners that are to have them. Ray counts GPUs; none has to be there."""

from __future__ import annotations

from pathlib import Path

import pytest

from cluster.errors import ClusterError
from jobs.experiment.spec_files import load_experiment
from jobs.runner import Outcome, Settings, run_experiment

SPEC = """
name: gpus
runs: 2
episodes: 6
environment: {id: "tests.user_code:Corridor"}
learners:
  with: {type: "tests.user_code:SeesGpus", expected: 1, num_gpus: 0.5}
  without: {type: "tests.user_code:SeesGpus", expected: 0}
arms:
  alone: {learners: [with]}
  none: {learners: [without]}
  both: {learners: [without, with], selector: {type: uniform}}
"""


def play(folder: Path, *overrides: str, **settings: object) -> Outcome:
    path = folder / "gpus.yaml"
    path.write_text(SPEC)
    experiment = load_experiment(str(path), overrides)
    return run_experiment(experiment, Settings(results=str(folder), dashboard=False, **settings))  # type: ignore[arg-type]


@pytest.mark.ray
def test_share_reaches_the_actor(ray_session: None, tmp_path: Path) -> None:
    """A learner with ``num_gpus`` sees a GPU, one without sees none, in one arm and in arms that follow each other."""
    assert play(tmp_path, placement="actors", arms=("none", "both")).failures == []


@pytest.mark.ray
def test_packed_shard_has_them_all(ray_session: None, tmp_path: Path) -> None:
    """Where the learners live in the coordinator it gets what they ask for together."""
    assert play(tmp_path, placement="packed", arms=("alone", "none")).failures == []


@pytest.mark.ray
def test_more_than_there_is(ray_session: None, tmp_path: Path) -> None:
    """A job that no GPU will ever be there for is refused, with one clear error, instead of waiting for ever."""
    with pytest.raises(ClusterError, match="found 1 GPUs in the Ray cluster, expected at least 2"):
        play(tmp_path, "learners.with.num_gpus=2", placement="actors")


def test_no_part_of_the_identity(tmp_path: Path) -> None:
    """Where a learner runs changes no row, and no results folder."""
    path = tmp_path / "gpus.yaml"
    path.write_text(SPEC)
    identities = {load_experiment(str(path), [f"learners.with.num_gpus={share}"]).identity for share in (0, 0.5, 2)}
    assert len(identities) == 1
    assert load_experiment(str(path), ["learners.with.expected=2"]).identity not in identities


def test_checked_without_a_gpu(tmp_path: Path) -> None:
    """An experiment for GPUs is checked where there is none; a device that nobody has is refused."""
    from jobs.experiment.plan import Plan
    from jobs.experiment.validation import check
    from jobs.experiment.yaml_source import SpecError

    path = tmp_path / "gpus.yaml"
    path.write_text(SPEC)
    check(Plan.of(load_experiment(str(path), ["learners.with={type: dqn, device: 'cuda:3', num_gpus: 1}"])))
    votes = "learners={with: {type: dqn, device: cuda}, without: {type: voting, members: [with]}}"
    check(Plan.of(load_experiment(str(path), [votes])))
    for unknown in ("gpu", "cudas", "'cuda:'"):
        with pytest.raises(SpecError, match="device"):
            check(Plan.of(load_experiment(str(path), [f"learners.with={{type: dqn, device: {unknown}}}"])))
