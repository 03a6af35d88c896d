"""What all tests share: one Ray at a time in each process, and a small experiment."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import settings

from tests.experiments import SMALL
from tests.forks import apel
from tests.ray_head import PLANTED, Head, ray_head
from tests.s3_server import Bucket, bucket
from tests.scheduling import kind_of, share_out

# No deadlines: the first call of a compiled function takes as long as its compilation, and a machine may be busy.
settings.register_profile("apel", deadline=None)
settings.load_profile("apel")
# Before pyarrow looks for credentials: those of whoever runs the tests have no business here.
os.environ |= {"AWS_ACCESS_KEY_ID": "testing", "AWS_SECRET_ACCESS_KEY": "testing", "AWS_DEFAULT_REGION": "us-east-1"}
os.environ["AWS_EC2_METADATA_DISABLED"] = "true"
# Before Ray is imported: its first local start would write a token to the home folder and expect it of every client.
os.environ["RAY_AUTH_MODE"] = "disabled"
os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
os.environ["RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO"] = "0"
# Ray's workers give way to all others otherwise, and beside tests that compute they would hardly come to anything.
os.environ["RAY_worker_niceness"] = "0"  # noqa: SIM112 - Ray's spelling
# Before PyTorch is imported: small networks on several threads wait for each other most of the time.
os.environ["OMP_NUM_THREADS"] = "1"


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


class Rays:
    """The Ray that is there, of at most one kind at a time: an idle one takes its share of two cores, too."""

    def __init__(self) -> None:
        self._kind: str | None = None
        self._running = ExitStack()
        self.head: Head | None = None

    def want(self, kind: str) -> None:
        """See that this one is there, and no other."""
        if kind == self._kind:
            return
        self.close()
        self._kind = kind
        if kind == "session":
            self._running.enter_context(_ray())
        if kind == "head":
            self.head = replace(self._running.enter_context(ray_head(variables=PLANTED)), program=apel)

    def close(self) -> None:
        """End what is there."""
        self._kind = self.head = None
        self._running.close()


@contextmanager
def _ray() -> Iterator[None]:
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
def rays() -> Iterator[Rays]:
    """What starts Rays, and ends the last one."""
    with closing(Rays()) as rays:
        yield rays


@pytest.fixture(autouse=True)
def _only_one_ray(request: pytest.FixtureRequest) -> None:
    """A test that needs a Ray finds its kind, or, where it starts one itself, none."""
    if kind := kind_of(request.node):
        request.getfixturevalue("rays").want(kind)


@pytest.fixture
def ray_session(rays: Rays) -> None:
    """A real Ray with two CPUs, and a GPU by its count alone, shared by the tests that ask for it."""
    rays.want("session")


@pytest.fixture
def head(rays: Rays) -> Head:
    """A shared cluster to submit jobs to, started as ``ray start`` does, with secrets in its nodes' environment."""
    rays.want("head")
    assert rays.head
    return rays.head


@pytest.hookimpl(tryfirst=True)  # before xdist reads the marks
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Where several processes share the tests out, say which of them stay together."""
    if config.getoption("dist", "no") != "no" or hasattr(config, "workerinput"):
        share_out(items)
