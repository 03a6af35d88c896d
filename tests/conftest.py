"""What all tests share: one Ray for the whole session, and a small experiment."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.ray_head import Head, ray_head
from tests.s3_server import Bucket, bucket

# Before pyarrow looks for credentials: those of whoever runs the tests have no business here.
os.environ |= {"AWS_ACCESS_KEY_ID": "testing", "AWS_SECRET_ACCESS_KEY": "testing", "AWS_DEFAULT_REGION": "us-east-1"}
os.environ["AWS_EC2_METADATA_DISABLED"] = "true"
# Before Ray is imported: its first local start would write a token to the home folder and expect it of every client.
os.environ["RAY_AUTH_MODE"] = "disabled"
os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
os.environ["RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO"] = "0"
# Before PyTorch is imported: small networks on several threads wait for each other most of the time.
os.environ["OMP_NUM_THREADS"] = "1"

SMALL = """
name: small-maze
seed: 1234
runs: 6
episodes: 80
environment:
  id: apel/Maze-v0
  run_seed: maze_seed
  options: {size: 5, distractors: [3], max_steps: 100}
variables:
  dropped: [x, y, distractor]
learners:
  Q_full: {type: q_learning}
  Q_red: {type: q_learning, representation: {exclude: [$dropped]}}
arms:
  Q_full: {learners: [Q_full]}
  APEL: {learners: [Q_full, Q_red], selector: {type: apel, decay: 0.01}}
  SSBAS: {learners: [Q_full, Q_red], selector: {type: ssbas}}
criterion: {measure: length, window: 10, below: {factor: 1.3, info: optimal_length}}
record: all
"""


@pytest.fixture(scope="session")
def s3() -> Iterator[Bucket]:
    """A bucket of a real S3-compatible server on loopback, started once."""
    with bucket() as started:
        yield started


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """The file of an experiment that takes a fraction of a second."""
    path = tmp_path / "small.yaml"
    path.write_text(SMALL)
    return path


@pytest.fixture(scope="session")
def ray_session() -> Iterator[None]:
    """A real Ray with two CPUs, and a GPU by its count alone, started once."""
    import ray

    ray.init(
        address="local",
        num_cpus=2,
        num_gpus=1,
        include_dashboard=False,
        object_store_memory=150 * 2**20,
        log_to_driver=False,
        logging_level="ERROR",
    )
    yield
    ray.shutdown()


@pytest.fixture(scope="session")
def head() -> Iterator[Head]:
    """A cluster to submit jobs to, started once, as ``ray start`` does."""
    with ray_head() as running:
        yield running
