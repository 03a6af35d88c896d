"""Whether a cluster can be joined, asked in a moment: Ray itself goes on trying for a quarter of an hour where nothing
listens, and for twenty seconds, with as many warnings, where it is refused.
"""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import grpc

from cluster.errors import ClusterError

_SECONDS, _MOST_SECONDS = 4.0, 14.0
_NO_GCS = (grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.DEADLINE_EXCEEDED, grpc.StatusCode.UNIMPLEMENTED)
_QUESTION = "/ray.rpc.NodeInfoGcsService/GetClusterId"


def check_reachable(address: str | None) -> None:
    """Find out whether a Ray cluster at ``HOST:PORT`` listens, and takes this user's token.

    Raises
    ------
    ClusterError
        If not. Of other addresses nothing is known.
    """
    host, separator, port = (address or "").removeprefix("ray://").rpartition(":")
    if separator and port.isdigit() and "://" not in host:
        otherwise = f"could not reach a Ray cluster at {address!r}: found no answer"
        within(_MOST_SECONDS, lambda: _check(str(address), host.strip("[]"), port), otherwise)


def within(seconds: float, act: Callable[[], None], otherwise: str) -> None:
    """Do something that may take for ever, such as to look up a name; in a thread, which is left behind then.

    Raises
    ------
    ClusterError
        If it takes longer; the message begins with ``otherwise``.
    """
    raised: list[BaseException] = []

    def do() -> None:
        try:
            act()
        except BaseException as error:  # noqa: BLE001 - raised below, where somebody waits for it
            raised.append(error)

    thread = threading.Thread(target=do, daemon=True, name="apel-reach")
    thread.start()
    thread.join(seconds)
    if thread.is_alive():
        message = f"{otherwise} within {seconds:.0f} s"
        raise ClusterError(message)
    for error in raised:
        raise error


def _check(address: str, host: str, port: str) -> None:
    _connect(host, int(port), f"could not reach a Ray cluster at {address!r}")
    if address.startswith("ray://"):
        return  # a proxy, which speaks another language
    if socket.gethostbyname(host).startswith("127."):
        # Ray puts this machine's address in the place of the loopback's, and tries that one until it is stopped.
        mine = _own_address()
        _connect(mine, int(port), f"found no cluster of {address!r} at {mine}, where Ray looks for it")
    answer = _answer(address, _token())
    if answer in _NO_GCS:
        message = f"could not reach a Ray cluster at {address!r}: no Ray cluster answers there ({answer.name})"
        raise ClusterError(message)
    if answer is grpc.StatusCode.UNAUTHENTICATED:
        message = (
            f"the Ray cluster at {address!r} refuses the token, expected its own in RAY_AUTH_TOKEN, in the file that "
            "RAY_AUTH_TOKEN_PATH names, or in ~/.ray/auth_token, and RAY_AUTH_MODE=token"
        )
        raise ClusterError(message)


def _connect(host: str, port: int, otherwise: str) -> None:
    try:
        socket.create_connection((host, port), timeout=_SECONDS).close()
    except OSError as error:
        message = f"{otherwise}: {error}"
        raise ClusterError(message) from error


def _own_address() -> str:
    """The address from which this machine would reach others; nothing is sent to find out."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
        except OSError:  # it reaches nobody
            return "127.0.0.1"
        return str(probe.getsockname()[0])


def _answer(address: str, token: str) -> grpc.StatusCode:
    """What the cluster says to the question for its id."""
    with grpc.insecure_channel(address) as channel:
        try:
            metadata = [("authorization", f"Bearer {token}")] if token else None
            channel.unary_unary(_QUESTION)(b"", metadata=metadata, timeout=_SECONDS)
        except grpc.RpcError as error:
            code: grpc.StatusCode = error.code()
            return code
    return grpc.StatusCode.OK


def _token() -> str:
    """What Ray will show: the first of the places where it looks."""
    if os.environ.get("RAY_AUTH_MODE") == "disabled":
        return ""
    if token := os.environ.get("RAY_AUTH_TOKEN"):
        return token.strip()
    path = os.environ.get("RAY_AUTH_TOKEN_PATH") or Path.home() / ".ray" / "auth_token"
    with suppress(OSError):
        return Path(path).read_text().strip()
    return ""
