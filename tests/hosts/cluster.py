"""The cluster of the compose file on hosts: a head, two workers; beside them an S3 server, and a user's machine."""

from __future__ import annotations

import json
import secrets
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.hosts.compose import Service, node
from tests.hosts.hosts import Host, hosts
from tests.hosts.machine import machine

CREDENTIALS = {
    "AWS_ACCESS_KEY_ID": "lab",
    "AWS_SECRET_ACCESS_KEY": "not-so-secret",
    "AWS_DEFAULT_REGION": "us-east-1",
    "AWS_EC2_METADATA_DISABLED": "true",
}
RESULTS = "s3://lab/results?scheme=http&endpoint_override=s3:9000"
_MAKE_BUCKET = "import boto3; boto3.client('s3', endpoint_url='http://s3:9000').create_bucket(Bucket='lab')"


@dataclass(frozen=True)
class Cluster:
    """Its hosts, and what a user of it does from a machine of their own."""

    head: Host
    workers: tuple[Host, Host]
    s3: Host
    client: Host
    token: str

    @property
    def nodes(self) -> tuple[Host, ...]:
        """The hosts that run Ray."""
        return (self.head, *self.workers)

    def apel(self, *words: str, check: bool = True) -> str:
        """What the user's ``apel`` prints, errors included."""
        run = self.client.run("apel", *words, check=check)
        return run.stdout + run.stderr

    def status(self, job: str) -> dict[str, Any]:
        """What ``apel status --json`` says."""
        found: dict[str, Any] = json.loads(self.client.run("apel", "status", job, "--json").stdout)
        return found

    def answer(self, url: str, token: str | None) -> int:
        """The HTTP status that the user's machine gets."""
        code = (
            "import sys, requests; headers = {'Authorization': f'Bearer {sys.argv[2]}'} if sys.argv[2:] else {};"
            "print(requests.get(sys.argv[1], headers=headers, timeout=10).status_code)"
        )
        return int(self.client.run("python", "-c", code, url, *([token] if token else [])).stdout)


@contextmanager
def cluster(folder: Path, tell: Callable[[str], None]) -> Iterator[Cluster]:
    """Start it as Compose does: the workers once the head is well."""
    token = secrets.token_hex(32)
    with machine(folder / "disk") as under, hosts(under, _services(token), folder, token) as found:
        tell("the image is built")
        started = Cluster(found["head"], (found["worker-1"], found["worker-2"]), found["s3"], found["client"], token)
        for host in (started.s3, started.client, started.head):
            host.start()
        started.head.wait_until_well()
        tell("the head is well")
        for host in started.workers:
            host.start()
        for host in started.workers:
            host.wait_until_well()
        tell("both workers are well")
        wait_until(lambda: started.client.run("python", "-c", _MAKE_BUCKET, check=False).returncode == 0, 60.0)
        yield started


def wait_until(is_so: Callable[[], bool], seconds: float, what: Callable[[], object] = str) -> float:
    """Ask every second until it is so; the seconds that it took."""
    began = time.monotonic()
    while not is_so():
        assert time.monotonic() - began < seconds, f"it is not so after {seconds:.0f} s: {what()}"
        time.sleep(1.0)
    return time.monotonic() - began


def _services(token: str) -> Mapping[str, Service]:
    client = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": token, "RAY_API_SERVER_ADDRESS": "http://head:8265"}
    return {
        "head": node("head", CREDENTIALS),
        "worker-1": node("worker", CREDENTIALS),
        "worker-2": node("worker", CREDENTIALS),
        "s3": Service(("moto_server", "-H", "0.0.0.0", "-p", "9000"), {}),
        "client": Service(("sleep", "infinity"), {**CREDENTIALS, **client}),
    }
