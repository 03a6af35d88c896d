"""A head that has just started has no agent yet, which starts jobs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from jobs.remote import submission
from jobs.remote.records import Draft, Record

DRAFT = Draft(Record("small-0-1", "http://127.0.0.1:1", "small", "0", ()), Path("nowhere"))


class Starting:
    """A dashboard that knows no agent for the first few times."""

    def __init__(self, refusals: list[str]) -> None:
        self.refusals = refusals

    def submit_job(self, **_: object) -> None:
        if self.refusals:
            raise RuntimeError(self.refusals.pop())


@pytest.fixture(autouse=True)
def _at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(submission, "_PAUSE_SECONDS", 0.0)


def test_an_agent_is_waited_for() -> None:
    """The same is submitted again until there is one; other refusals are no reason to wait."""
    client: Any = Starting(["No available agent to submit job, please try again later."] * 3)
    assert submission._is_accepted(client, DRAFT)
    taken: Any = Starting(["a job of this id already exists"])
    assert not submission._is_accepted(taken, DRAFT)
    refusing: Any = Starting(["no such working_dir"])
    with pytest.raises(RuntimeError, match="no such working_dir"):
        submission._is_accepted(refusing, DRAFT)


def test_not_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    """A head that never has one says so itself in the end."""
    monkeypatch.setattr(submission, "_AGENT_SECONDS", 0.0)
    client: Any = Starting(["No available agent to submit job, please try again later."])
    with pytest.raises(RuntimeError, match="No available agent"):
        submission._is_accepted(client, DRAFT)
