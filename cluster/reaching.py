"""Whether a cluster can be joined, asked in a moment: Ray itself goes on trying for a quarter of an hour where nothing
listens, and for twenty seconds, with as many warnings, where it is refused.
"""

from __future__ import annotations

import os
import socket
from contextlib import suppress
from pathlib import Path

import grpc

from cluster.errors import ClusterError

_SECONDS = 5.0
_QUESTION = "/ray.rpc.NodeInfoGcsService/GetClusterId"


def check_reachable(address: str | None) -> None:
    """Find out whether a Ray cluster at ``HOST:PORT`` listens, and takes this user's token.

    Raises
    ------
    ClusterError
        If not. Of other addresses, such as ``auto``, nothing is known.
    """
    host, separator, port = (address or "").rpartition(":")
    if not separator or not port.isdigit() or "://" in host:
        return
    _connect(host, int(port), f"could not reach a Ray cluster at {address!r}")
    if socket.gethostbyname(host).startswith("127."):
        # Ray puts this machine's address in the place of the loopback's, and tries that one until it is stopped.
        mine = _own_address()
        _connect(mine, int(port), f"found no cluster of {address!r} at {mine}, where Ray looks for it")
    if _refuses(str(address), _token()):
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


def _refuses(address: str, token: str) -> bool:
    """Whether the cluster says that the token is not its own; whatever else it says, Ray may find out."""
    with grpc.insecure_channel(address) as channel:
        try:
            metadata = [("authorization", f"Bearer {token}")] if token else None
            channel.unary_unary(_QUESTION)(b"", metadata=metadata, timeout=_SECONDS)
        except grpc.RpcError as error:
            return bool(error.code() is grpc.StatusCode.UNAUTHENTICATED)
    return False


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
