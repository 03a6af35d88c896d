"""``apel`` for shells, forked from a process that has imported this project: an interpreter takes two seconds to come
so far, and the pages of the guide call it more than a hundred times.

A folder for ``PATH`` holds a small program of that name. It sends its words, environment, limits and standard streams
to the process that stands by, passes signals on, and ends as the command does.
"""

from __future__ import annotations

import array
import json
import multiprocessing
import os
import resource
import signal
import socket
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tests.forks import PRELOADED, become

_CLIENT = """#!{python} -IS
import array, json, os, resource, signal, socket, sys

wire = socket.socket(socket.AF_UNIX)
wire.connect({address!r})
asked = {{
    "words": sys.argv[1:], "cwd": os.getcwd(), "env": dict(os.environ),
    "file_size": resource.getrlimit(resource.RLIMIT_FSIZE),
}}
message = json.dumps(asked).encode() + b"\\n"
sent = wire.sendmsg([message], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", [0, 1, 2]))])
wire.sendall(message[sent:])
answers = wire.makefile()
child = int(answers.readline())
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, lambda number, _: os.kill(child, number))
code = int(answers.readline())
if code < 0:
    signal.signal(-code, signal.SIG_DFL)
    os.kill(os.getpid(), -code)
sys.exit(code)
"""


@contextmanager
def standing_by() -> Iterator[str]:
    """Start the process that stands by; the folder for ``PATH``. Its commands end with it."""
    with tempfile.TemporaryDirectory(prefix="apel-by-") as folder:
        address = str(Path(folder, "socket"))
        client = Path(folder, "apel")
        client.write_text(_CLIENT.format(python=sys.executable, address=address))
        client.chmod(0o755)
        listening = socket.socket(socket.AF_UNIX)
        listening.bind(address)
        listening.listen(64)
        # Each call is forked by the fork server of `tests.forks`, which has no threads.
        context: Any = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(PRELOADED)
        accepting = threading.Thread(target=_accept, args=(listening, context), daemon=True)
        accepting.start()
        try:
            yield folder
        finally:
            listening.close()


def _accept(listening: socket.socket, context: Any) -> None:
    with suppress(OSError):
        while True:
            wire, _ = listening.accept()
            threading.Thread(target=_serve, args=(wire, context), daemon=True).start()


def _serve(wire: socket.socket, context: Any) -> None:
    """Have one command forked, and tell its caller how it ends; a caller that is gone ends it."""
    with wire:
        asked, streams = _received(wire)
        process = context.Process(target=_command, args=(asked, *map(_Stream, streams)))
        process.start()
        for stream in streams:
            os.close(stream)
        wire.sendall(f"{process.pid}\n".encode())
        gone = threading.Thread(target=_end_if_gone, args=(wire, process), daemon=True)
        gone.start()
        process.join()
        with suppress(OSError):
            wire.sendall(f"{process.exitcode}\n".encode())


def _end_if_gone(wire: socket.socket, process: Any) -> None:
    with suppress(OSError):
        if not wire.recv(1) and process.exitcode is None:
            os.kill(process.pid, signal.SIGKILL)


def _received(wire: socket.socket) -> tuple[dict[str, Any], list[int]]:
    passed = array.array("i")
    content, ancillary, *_ = wire.recvmsg(1 << 20, socket.CMSG_LEN(3 * passed.itemsize))
    for _, _, data in ancillary:
        passed.frombytes(data)
    while not content.endswith(b"\n"):
        content += wire.recv(1 << 20)
    return json.loads(content), list(passed)


class _Stream:
    """A file descriptor on its way to a process that is forked elsewhere."""

    def __init__(self, number: int) -> None:
        self.number = number

    def __reduce__(self) -> Any:
        from multiprocessing import reduction

        return _stream_of, (reduction.DupFd(self.number),)  # type: ignore[attr-defined]


def _stream_of(passed: Any) -> _Stream:
    return _Stream(passed.detach())


def _command(asked: dict[str, Any], *streams: _Stream) -> None:
    """What the child does: become the command."""
    resource.setrlimit(resource.RLIMIT_FSIZE, asked["file_size"])
    for number, stream in enumerate(streams):
        os.dup2(stream.number, number)
    sys.stdin = open(0, closefd=False)  # noqa: SIM115 - the fork server has none
    sys.stdout.reconfigure(write_through=True)  # type: ignore[union-attr]
    become(tuple(asked["words"]), asked["cwd"], asked["env"])
