"""The connection to a cluster's dashboard: its Jobs API, and the files among the logs of its nodes."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager

from ray.exceptions import AuthenticationError
from ray.job_submission import JobSubmissionClient
from requests.exceptions import RequestException

from cluster.errors import ClusterError
from jobs.remote import DEFAULT_ADDRESS
from jobs.yaml_source import SpecError


@contextmanager
def connected(address: str) -> Iterator[JobSubmissionClient]:
    """A connection to a dashboard; its errors in our words."""
    if not address.startswith(("http://", "https://")):
        message = f"--address: found {address!r}, expected that of a dashboard, such as {DEFAULT_ADDRESS}"
        raise SpecError(message)
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    # Ray lets this variable win over the address that it is given.
    os.environ["RAY_API_SERVER_ADDRESS"] = address
    for name in ("ray", "ray.dashboard.modules.dashboard_sdk"):  # which tell of every upload
        logging.getLogger(name).setLevel(logging.WARNING)
    try:
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


def read_log_file(client: JobSubmissionClient, node: str, name: str, timeout_seconds: int = 30) -> Iterator[bytes]:
    """The bytes of a file among a node's logs, piece by piece; none if it is not there."""
    query = f"node_id={node}&filename={name}&lines=-1&timeout={timeout_seconds}"
    # Ray's own `get_log` wants the address of the GCS, which is not to be reached from outside; this asks the same of
    # the dashboard, with the client's token and certificates.
    response = client._do_request("GET", f"/api/v0/logs/file?{query}", stream=True)
    with response:
        if response.status_code == 200:
            yield from response.iter_content(chunk_size=None)
