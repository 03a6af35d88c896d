"""The connection to a cluster's dashboard: its Jobs API, and the files among the logs of its nodes."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from urllib.parse import urlencode

import requests
from ray.exceptions import AuthenticationError
from ray.job_submission import JobSubmissionClient
from requests.exceptions import RequestException

from cluster.errors import ClusterError
from cluster.reachability import within
from jobs.remote.places import dashboard_address

_CONNECT_SECONDS, _ANSWER_SECONDS = 5.0, 9.0


@contextmanager
def connected(address: str) -> Iterator[JobSubmissionClient]:
    """A connection to a dashboard; its errors in our words."""
    dashboard_address("--address", address)
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    # Ray lets this variable win over the address that it is given.
    os.environ["RAY_API_SERVER_ADDRESS"] = address
    for name in ("ray", "ray.dashboard.modules.dashboard_sdk"):  # which tell of every upload
        logging.getLogger(name).setLevel(logging.WARNING)
    try:
        _knock(address)
        yield JobSubmissionClient(address)
    except (ConnectionError, RequestException) as error:
        message = f"could not reach a dashboard at {address}: {error}"
        raise ClusterError(message) from error
    except AuthenticationError as error:
        message = (
            f"the cluster at {address} refuses the token, expected its own in RAY_AUTH_TOKEN, in the file that "
            "RAY_AUTH_TOKEN_PATH names, or in ~/.ray/auth_token"
        )
        raise ClusterError(message) from error
    except RuntimeError as error:
        message = f"the cluster at {address} refuses: {error}"
        raise ClusterError(message) from error


def _knock(address: str) -> None:
    """See in a few seconds that somebody answers, whatever it is: Ray's own client has no time-outs."""

    def ask() -> None:
        limits = (_CONNECT_SECONDS, _ANSWER_SECONDS)
        try:
            requests.get(f"{address.rstrip('/')}/api/version", timeout=limits, stream=True).close()
        except requests.ConnectionError as error:
            if isinstance(error, requests.Timeout):
                raise
            # Where it is refused Ray's client says so, as soon.

    within(_CONNECT_SECONDS + _ANSWER_SECONDS, ask, f"could not reach a dashboard at {address}: found no answer")


def read_log_file(client: JobSubmissionClient, node: str, name: str, timeout_seconds: int = 30) -> Iterator[bytes]:
    """The bytes of a file among a node's logs, piece by piece; none if it is not there."""
    query = urlencode({"node_id": node, "filename": name, "lines": -1, "timeout": timeout_seconds})
    # Ray's own `get_log` wants the address of the GCS, which is not to be reached from outside; this asks the same of
    # the dashboard, with the client's token and certificates.
    response = client._do_request("GET", f"/api/v0/logs/file?{query}", stream=True)
    with response:
        if response.status_code == 200:
            yield from response.iter_content(chunk_size=None)
