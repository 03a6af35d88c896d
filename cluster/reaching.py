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
    try:
        socket.create_connection((host, int(port)), timeout=_SECONDS).close()
    except OSError as error:
        message = f"could not reach a Ray cluster at {address!r}: {error}"
        raise ClusterError(message) from error
    if _refuses(str(address), _token()):
        message = (
            f"the Ray cluster at {address!r} refuses the token, expected its own in RAY_AUTH_TOKEN, in the file that "
            "RAY_AUTH_TOKEN_PATH names, or in ~/.ray/auth_token, and RAY_AUTH_MODE=token"
        )
        raise ClusterError(message)


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
