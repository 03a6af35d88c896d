"""What cannot be submitted is refused on the user's own machine."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from tests.command_line import call, called


def unused() -> str:
    """The address of a port where nobody listens."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"http://127.0.0.1:{free.getsockname()[1]}"


@pytest.mark.parametrize(
    ("words", "code", "expected"),
    [
        ("resume no-such-job", 2, "found no record of the job 'no-such-job' on this machine"),
        ("submit SMALL --results relative", 2, "--results: found 'relative', expected an absolute path"),
        ("submit SMALL --results s3://key:hidden@bucket/x", 2, "--results: found credentials in s3://"),
        ("submit SMALL --module nowhere", 2, "--module: found no module 'nowhere' in"),
        ("submit SMALL --runs -1", 2, "runs: found -1"),
        ("submit SMALL --arms Nobody", 2, "--arms: found 'Nobody', expected some of Q_full, APEL, SSBAS"),
        ("submit nothing", 2, "found the experiment 'nothing', expected a file (*.yaml) or one of"),
        ("jobs --address 127.0.0.1:8265", 2, "--address: found '127.0.0.1:8265', expected that of a dashboard"),
        ("jobs", 1, "could not reach a dashboard at http://127.0.0.1:"),
        ("submit SMALL", 1, "could not reach a dashboard at http://127.0.0.1:"),
    ],
)
def test_bad_calls(
    small: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: str,
    code: int,
    expected: str,
) -> None:
    """One message, an exit code, no traceback, and no secret in it."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("RAY_API_SERVER_ADDRESS", unused())
    monkeypatch.chdir(tmp_path)
    refused = called(capsys, *(str(small) if word == "SMALL" else word for word in words.split()))
    assert refused.code == code, refused.err
    assert expected in refused.err
    assert "Traceback" not in refused.err
    assert "hidden" not in refused.out + refused.err


def test_given_address_wins(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """The address on the command line is the one that is asked, whatever the environment says."""
    given, other = unused(), unused()
    monkeypatch.setenv("RAY_API_SERVER_ADDRESS", other)
    _, error = call(capsys, "jobs", "--address", given)
    assert given in error
    assert other not in error
