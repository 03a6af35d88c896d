"""A Ray cluster as users start it, in processes of its own, with token authentication."""

from __future__ import annotations

import os
import secrets
import socket
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from tests.forks import BIN
from tests.processes import apel

# Secrets for which whatever a cluster writes may be searched.
PLANTED = {"AWS_ACCESS_KEY_ID": "planted-key-4711", "AWS_SECRET_ACCESS_KEY": "planted-secret-4711"}


@dataclass(frozen=True)
class Head:
    """A running head; ``env`` is what a client or another node needs in its environment."""

    url: str
    address: str
    metrics_url: str
    env: Mapping[str, str]
    temp_dir: str
    program: Callable[..., subprocess.CompletedProcess[str]] = apel
    """How ``apel`` is called: as a user does, unless it is forked (`tests.forks.apel`)."""

    def apel(
        self, *words: str, cwd: Path, check: bool = True, timeout: float = 400.0
    ) -> subprocess.CompletedProcess[str]:
        """Call ``apel`` as a user of this cluster."""
        return self.program(*words, cwd=cwd, env=self.env, check=check, timeout=timeout)


@contextmanager
def ray_head(num_cpus: int = 2, variables: Mapping[str, str] | None = None) -> Iterator[Head]:
    """Start a head on free ports of this machine, and stop its processes, and no others, at the end."""
    gcs, dashboard, agent, metrics, client = free_ports(5)
    # Ray's sockets lie below it, and their paths may not be long.
    temp_dir = tempfile.mkdtemp(prefix="apel-ray-")
    env = {
        **os.environ,
        "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}",
        "RAY_AUTH_MODE": "token",
        "RAY_AUTH_TOKEN": secrets.token_hex(32),
        "RAY_API_SERVER_ADDRESS": f"http://127.0.0.1:{dashboard}",
        "RAY_max_direct_call_object_size": "2000000",
        "RAY_GRACEFUL_SHUTDOWN_DRAIN_TIMEOUT_S": "0",
        "XDG_STATE_HOME": str(Path(temp_dir, "state")),
        **(variables or {}),
    }
    env.pop("RAY_ADDRESS", None)
    options = [
        f"--port={gcs}", f"--dashboard-port={dashboard}", f"--dashboard-agent-listen-port={agent}",
        f"--metrics-export-port={metrics}", f"--ray-client-server-port={client}", f"--num-cpus={num_cpus}",
        "--dashboard-host=127.0.0.1", "--object-store-memory=200000000", f"--temp-dir={temp_dir}",
    ]  # fmt: skip
    with _started(["--head", *options], env) as process:
        url = f"http://127.0.0.1:{dashboard}"
        # Written once the head has started as a whole.
        current = Path(temp_dir, "ray_current_cluster")
        _wait_for(process, lambda: _answers(f"{url}/api/gcs_healthz") and current.exists())
        address = current.read_text().strip()
        yield Head(url, address, f"http://127.0.0.1:{metrics}/metrics", env, temp_dir)


@contextmanager
def _started(options: Sequence[str], env: Mapping[str, str]) -> Iterator[subprocess.Popen[bytes]]:
    command = [str(BIN / "ray"), "start", "--block", "--disable-usage-stats", *options]
    process = subprocess.Popen(command, env=dict(env), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(timeout=30)
        process.kill()


def _wait_for(process: subprocess.Popen[bytes], is_there: Callable[[], bool], seconds: float = 400.0) -> None:
    deadline = time.monotonic() + seconds
    while not is_there():
        assert process.poll() is None, f"the head ended with {process.returncode} before it was there"
        assert time.monotonic() < deadline, f"the head was not there after {seconds:.0f} s"
        time.sleep(0.1)


def _answers(url: str) -> bool:
    try:
        with urllib.request.urlopen(url, timeout=5):
            return True
    except OSError:
        return False


def free_ports(count: int) -> list[int]:
    """Ports of the loopback that nobody uses now, outside the range that Ray gives to its workers."""
    sockets = []
    try:
        while len(sockets) < count:
            one = socket.socket()
            one.bind(("127.0.0.1", 0))
            if one.getsockname()[1] > 20_000:
                sockets.append(one)
            else:
                one.close()
        return [one.getsockname()[1] for one in sockets]
    finally:
        for one in sockets:
            one.close()
