"""What is special about S3: no folders, uploads that end by themselves, endpoints that do not answer."""

from __future__ import annotations

import http.server
import pickle
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import pytest

from cluster.retry import RetryPolicy
from jobs.results.storage import Folder
from jobs.results.storage_faults import StorageError
from tests.s3_server import NAME, Bucket


def test_an_upload_ends_by_itself(s3: Bucket) -> None:
    """A stream that an exception closes is a whole object for S3: the temporary name is what protects from it."""
    folder = Folder(s3.fresh())
    with suppress(ValueError), folder.filesystem.open_output_stream(folder.path("half")) as stream:
        stream.write(b"half")
        raise ValueError
    assert folder.read("half") == b"half"


def test_bucket_is_left_alone(s3: Bucket, caplog: pytest.LogCaptureFixture) -> None:
    """Writing asks nothing of the bucket itself, which whoever may only write files has no right to touch; the one
    marker for a folder is what pyarrow makes of a deletion.
    """
    folder = Folder(s3.fresh())
    with caplog.at_level("INFO", "werkzeug"):
        folder.write("a/b/file", b"1")
    requests = [record.getMessage() for record in caplog.records if record.name == "werkzeug"]
    assert any(f"/{NAME}/" in request for request in requests)
    assert not [request for request in requests if f"/{NAME} " in request or f"/{NAME}/ " in request]
    assert [key for key in s3.keys(folder.path().removeprefix(f"{NAME}/")) if not key.endswith("/b/")] == [
        folder.path("a/b/file").removeprefix(f"{NAME}/")
    ]
    assert folder.filesystem.__reduce__()[1][0]["allow_bucket_creation"] is False


def test_missing_bucket(s3: Bucket) -> None:
    """A bucket that is not there is not made, and the error says so."""
    folder = Folder(f"s3://no-such-bucket/results?{s3.query}")
    assert folder.names() == []
    with pytest.raises(StorageError, match=r"NO_SUCH_BUCKET.*make the bucket, or choose another --results"):
        folder.write("x", b"y")


def test_credentials_work_and_are_not_seen(s3: Bucket) -> None:
    """Credentials in a URI are used, also after a journey, and appear nowhere."""
    folder = Folder(s3.fresh("AKIAEXAMPLE:abc%2FdefEXAMPLEKEY@"))
    travelled = pickle.loads(pickle.dumps(folder)).sub("a")
    travelled.write("x", b"y")
    assert folder.read("a/x") == b"y"
    assert folder.filesystem.__reduce__()[1][0]["secret_key"] == "abc/defEXAMPLEKEY"
    with pytest.raises(StorageError) as caught:
        Folder(f"s3://AKIAEXAMPLE:abc%2FdefEXAMPLEKEY@no-such-bucket/r?{s3.query}").write("x", b"y")
    for text in (travelled.location("x"), repr(travelled), str(travelled), str(caught.value), repr(caught.value)):
        assert "EXAMPLEKEY" not in text
        assert "***@" in text


def test_timeouts_survive_the_journey() -> None:
    """Timeouts do not fall back to pyarrow's own in another process."""
    folder = pickle.loads(pickle.dumps(Folder("s3://bucket/r?endpoint_override=127.0.0.1:1&scheme=http").sub("a")))
    options = folder.filesystem.__reduce__()[1][0]
    assert (options["connect_timeout"], options["request_timeout"]) == (3.0, 10.0)


def test_dead_endpoint() -> None:
    """An endpoint where nothing listens is an error after the attempts that there are to be."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    waits: list[float] = []
    uri = f"s3://bucket/r?endpoint_override=127.0.0.1:{port}&scheme=http"
    with pytest.raises(StorageError, match=r"NETWORK_CONNECTION.*see that the storage can be reached from here"):
        Folder(uri, RetryPolicy(2, 0.5), waits.append).write("x", b"y")
    assert waits == [0.5]


@contextmanager
def answering(status: int, code: str) -> Iterator[tuple[str, list[str]]]:
    """A server that answers everything with one error: what a URI needs to find it, and the requests so far."""
    requests: list[str] = []

    class Handler(http.server.BaseHTTPRequestHandler):
        def answer(self) -> None:
            requests.append(self.command)
            self.rfile.read(int(self.headers.get("content-length") or 0))
            body = f"<?xml version='1.0'?><Error><Code>{code}</Code><Message>m</Message></Error>".encode()
            self.send_response(status)
            self.send_header("content-type", "application/xml")
            self.send_header("content-length", str(len(body)))
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(body)

        do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = answer  # noqa: N815 - the names that it calls

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"endpoint_override=127.0.0.1:{server.server_address[1]}&scheme=http", requests
        finally:
            server.shutdown()
            thread.join()


def test_attempts_of_an_attempt() -> None:
    """Of each attempt pyarrow makes two, not as many as it likes: its own default would take six seconds and more."""
    with answering(503, "SlowDown") as (query, requests):
        with pytest.raises(StorageError):
            Folder(f"s3://bucket/r?{query}", RetryPolicy(3, 0.5), lambda _: None).names()
        assert requests == ["GET"] * 2 * 3


@pytest.mark.parametrize(
    ("status", "code", "waits"),
    [
        (503, "SlowDown", [0.5]),
        (500, "InternalError", [0.5]),
        (502, "BadGateway", [0.5]),
        (403, "AccessDenied", []),
        (403, "SignatureDoesNotMatch", []),
    ],
)
def test_answers_of_a_server(status: int, code: str, waits: list[float]) -> None:
    """What pyarrow makes of a real answer is told apart as it should be, for writing, listing and looking."""
    waited: list[float] = []
    with answering(status, code) as (query, requests):
        folder = Folder(f"s3://bucket/r?{query}", RetryPolicy(2, 0.5), waited.append)
        for operation in (lambda: folder.write("x", b"y"), folder.names, lambda: folder.exists("x")):
            waited.clear()
            with pytest.raises(StorageError, match=r"^s3://bucket/r"):
                operation()
            assert waited == waits
    assert requests
