"""An S3-compatible server in this process, on loopback."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

NAME = "apel-tests"


@dataclass(frozen=True)
class Bucket:
    """A bucket, and where its server is."""

    host: str
    port: int

    @property
    def query(self) -> str:
        """What a URI needs to find the server."""
        return f"endpoint_override={self.host}:{self.port}&scheme=http"

    def keys(self, prefix: str) -> list[str]:
        """The keys of all objects that begin so, markers of folders included."""
        import boto3

        client = boto3.client("s3", endpoint_url=f"http://{self.host}:{self.port}")
        return [item["Key"] for item in client.list_objects_v2(Bucket=NAME, Prefix=prefix).get("Contents", [])]

    def fresh(self, credentials: str = "") -> str:
        """The URI of a folder that nobody has used."""
        return f"s3://{credentials}{NAME}/{uuid.uuid4().hex[:12]}?{self.query}"


@contextmanager
def bucket() -> Iterator[Bucket]:
    """Start the server at a free port, and make the bucket: nothing under test may do that."""
    import boto3
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    try:
        host, port = server.get_host_and_port()
        boto3.client("s3", endpoint_url=f"http://{host}:{port}").create_bucket(Bucket=NAME)
        yield Bucket(host, port)
    finally:
        server.stop()
