"""Files among the logs of a cluster's nodes, asked of its dashboard."""

from __future__ import annotations

from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest

from jobs.remote.connection import read_log_file


@pytest.mark.parametrize("name", ["apel-DQN+SAC-3f4c-1.json", "apel-50 %&x=1.json"])
def test_any_name(name: str) -> None:
    """The dashboard is asked for the file of this very name, whatever is in it."""
    asked: list[str] = []

    def request(method: str, address: str, *, stream: bool) -> Any:
        asked.append(address)
        return nullcontext_of(SimpleNamespace(status_code=200, iter_content=lambda chunk_size: [b"all"]))

    client: Any = SimpleNamespace(_do_request=request)
    assert b"".join(read_log_file(client, "node-1", name)) == b"all"
    query = parse_qs(urlsplit(asked[0]).query)
    assert (query["filename"], query["node_id"], query["lines"]) == ([name], ["node-1"], ["-1"])


def nullcontext_of(response: SimpleNamespace) -> Any:
    """A response that may be used as a context, as those of `requests`."""

    class Response(nullcontext[Any]):
        status_code, iter_content = response.status_code, staticmethod(response.iter_content)

    return Response()
