"""A door in front of an S3 server that can be told to be in a bad way."""

from __future__ import annotations

import http.client
import random
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

_BUSY = b"<?xml version='1.0'?><Error><Code>SlowDown</Code><Message>Please reduce your request rate.</Message></Error>"
_BODILESS = frozenset({204, 304})


class StorageProxy:
    """Passes requests on to a server at ``host:port``; `fault` says what happens to them instead.

    ``num_hit`` counts the requests that met a fault.
    """

    def __init__(self, host: str, port: int, moment: random.Random) -> None:
        self.server = host, port
        self.num_hit = 0
        self._moment = moment
        self._fault: tuple[Callable[[_Handler, bytes], None], float] | None = None
        self._listener = _Server(("127.0.0.1", 0), _Handler, self)
        self._thread = threading.Thread(target=self._listener.serve_forever, daemon=True, name="storage-proxy")
        self._thread.start()

    @property
    def port(self) -> int:
        """Where it listens, on loopback."""
        return int(self._listener.server_address[1])

    @contextmanager
    def fault(self, mode: str, share: float = 1.0) -> Iterator[None]:
        """As long as the body runs, a ``share`` of the requests meets a fault of ``MODES``."""
        self._fault = MODES[mode], share
        try:
            yield
        finally:
            self._fault = None

    def chosen(self) -> Callable[[_Handler, bytes], None]:
        """What to do with the next request."""
        fault = self._fault
        if fault is None or self._moment.random() >= fault[1]:
            return _Handler.forward
        self.num_hit += 1
        return fault[0]

    def close(self) -> None:
        """Listen no more."""
        self._listener.shutdown()
        self._listener.server_close()
        self._thread.join()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    request_queue_size = 64

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler], proxy: StorageProxy) -> None:
        super().__init__(address, handler)
        self.proxy = proxy

    def handle_error(self, *_: object) -> None:
        """Clients that were killed in the middle of a request are what this is for."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True

    def answer(self) -> None:
        self.server.proxy.chosen()(self, self._body())

    do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = answer  # noqa: N815 - the names that http.server looks for

    def forward(self, body: bytes) -> None:
        """Let the server answer."""
        status, headers, content = self._ask(body)
        self.send_response_only(status)
        for name, value in headers:
            if name.lower() not in ("connection", "transfer-encoding", "content-length"):
                self.send_header(name, value)
        lengths = [value for name, value in headers if name.lower() == "content-length"]
        if status not in _BODILESS:
            self.send_header("content-length", lengths[0] if lengths else str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def busy(self, _: bytes) -> None:
        """503 SlowDown, as S3 says it."""
        self.send_response_only(503)
        self.send_header("content-type", "application/xml")
        self.send_header("content-length", str(len(_BUSY)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(_BUSY)

    def reset(self, _: bytes) -> None:
        """Break the connection off without an answer."""
        # Lingering for no time makes the kernel send a reset.
        self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self.close_connection = True
        # The server would bid a polite farewell first.
        self.connection.close()

    def lose_answer(self, body: bytes) -> None:
        """Do what is asked, and break the connection off before saying so."""
        self._ask(body)
        self.reset(body)

    def dawdle(self, body: bytes) -> None:
        """Answer late."""
        time.sleep(0.7)
        self.forward(body)

    def log_message(self, *_: object) -> None:
        """Say nothing."""

    def _body(self) -> bytes:
        if "chunked" not in self.headers.get("transfer-encoding", ""):
            return self.rfile.read(int(self.headers.get("content-length") or 0))
        parts = []
        while size := int(self.rfile.readline().split(b";")[0], 16):
            parts.append(self.rfile.read(size))
            self.rfile.readline()
        self.rfile.readline()
        return b"".join(parts)

    def _ask(self, body: bytes) -> tuple[int, list[tuple[str, str]], bytes]:
        upstream = http.client.HTTPConnection(*self.server.proxy.server, timeout=30)
        try:
            upstream.putrequest(self.command, self.path, skip_host=True, skip_accept_encoding=True)
            for name, value in self.headers.items():
                if name.lower() not in ("expect", "connection", "transfer-encoding", "content-length"):
                    upstream.putheader(name, value)
            upstream.putheader("content-length", str(len(body)))
            upstream.endheaders(body)
            response = upstream.getresponse()
            return response.status, response.getheaders(), response.read()
        finally:
            upstream.close()


MODES: dict[str, Callable[[_Handler, bytes], None]] = {
    "reset": _Handler.reset,
    "lost answer": _Handler.lose_answer,
    "SlowDown": _Handler.busy,
    "slow": _Handler.dawdle,
}
