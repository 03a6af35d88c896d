"""What a command has to know where it is the driver of a submitted job."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from pathlib import Path

from jobs.remote.places import refuse_credentials


def current_job() -> str:
    """The id of the submitted job that this process is the driver of; empty for none."""
    with suppress(ValueError):
        config = json.loads(os.environ.get("RAY_JOB_CONFIG_JSON_ENV_VAR", "{}"))
        return str(config.get("metadata", {}).get("job_submission_id", ""))
    return ""


def results_root(given: str | None, job: str) -> str:
    """Where results go; if nobody says, beside the user's files, but not into a job's folder, which Ray deletes.

    Raises
    ------
    SpecError
        If it holds a secret.
    """
    if given is None:
        return str(Path.home() / "apel-results") if job else "results"
    refuse_credentials("--results", given)
    return given
