"""Whether a cluster can be joined is said within seconds, whatever is, or is not, at its address."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from cluster import launch, reachability
from cluster.errors import ClusterError
from cluster.reachability import check_reachable, within
from jobs.results import storage
from jobs.results.storage import reached
from jobs.results.storage_faults import StorageAwayError
from tests.command_line import call


@contextmanager
def silent() -> Iterator[int]:
    """The port of a server on all addresses that takes connections, and never says anything."""
    with socket.socket() as listening:
        listening.bind(("0.0.0.0", 0))
        listening.listen(64)
        yield listening.getsockname()[1]


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@pytest.fixture(autouse=True)
def _hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reachability, "_SECONDS", 0.5)
    monkeypatch.setattr(reachability, "_MOST_SECONDS", 2.0)


@pytest.mark.parametrize("address", ["127.0.0.1:{port}", "ray://127.0.0.1:{closed}", "127.0.0.1:{closed}"])
def test_what_is_no_cluster(address: str) -> None:
    """Nobody there, or somebody who does not speak Ray's language."""
    with silent() as port:
        address = address.format(port=port, closed=free_port())
        began = time.monotonic()
        with pytest.raises(ClusterError, match=f"could not reach a Ray cluster at '{address}'"):
            check_reachable(address)
    assert time.monotonic() - began < 5


def test_a_name_that_nobody_answers_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Looking up a name may take for ever; it is not waited for."""
    over = threading.Event()
    monkeypatch.setattr(socket, "create_connection", lambda *_, **__: over.wait())
    began = time.monotonic()
    with pytest.raises(ClusterError, match="found no answer within 2 s"):
        check_reachable("somewhere.example:6379")
    over.set()
    assert time.monotonic() - began < 5


def test_auto_beside_a_dead_address(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ray's own note of a cluster, or RAY_ADDRESS, may name one that is gone: that is looked at first."""
    address = f"127.0.0.1:{free_port()}"
    monkeypatch.setenv("RAY_ADDRESS", address)
    monkeypatch.setattr("ray.is_initialized", lambda: False)  # as in a program of its own
    with pytest.raises(ClusterError, match=f"could not reach a Ray cluster at '{address}'"), launch.ray_cluster("auto"):
        pass
    monkeypatch.delenv("RAY_ADDRESS")
    monkeypatch.setattr(launch.services, "find_gcs_addresses", list)
    monkeypatch.setattr(launch.services, "find_bootstrap_address", lambda _: None)
    with pytest.raises(ClusterError, match="found no Ray cluster on this machine"), launch.ray_cluster("auto"):
        pass


def test_within_passes_on_what_is_raised() -> None:
    """An error of what was done in time is that error."""

    def act() -> None:
        raise FileNotFoundError

    with pytest.raises(FileNotFoundError):
        within(1.0, act, "unused")
    within(1.0, lambda: None, "unused")


@pytest.mark.parametrize("command", [["jobs"], ["status", "a"], ["logs", "a"], ["stop", "a"], ["fetch", "a", "here"]])
def test_a_dashboard_that_is_silent(
    command: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Every command that asks a dashboard says soon that it does not answer."""
    from jobs.remote import connection

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(connection, "_ANSWER_SECONDS", 0.3)
    monkeypatch.setenv("RAY_API_SERVER_ADDRESS", "")
    with silent() as port:
        code, error = call(capsys, *command, "--address", f"http://127.0.0.1:{port}")
    assert code == 1
    assert f"could not reach a dashboard at http://127.0.0.1:{port}" in error


def test_a_store_that_is_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Work on a store is patient with it, but its first answer is not waited for as long as that."""
    monkeypatch.setattr(storage, "_FIRST_ANSWER_SECONDS", 0.5)
    with silent() as port:
        uri = f"s3://KEY:SECRET@bucket/results?endpoint_override=127.0.0.1:{port}&scheme=http&region=x"
        with pytest.raises(StorageAwayError, match="found a store that does not answer within 0 s") as caught:
            reached(uri)
    assert "SECRET" not in str(caught.value)
