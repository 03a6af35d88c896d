"""The program called in this process, since an interpreter of its own takes seconds."""

from __future__ import annotations

import sys
from dataclasses import dataclass

import pytest

from jobs.cli.main import main


@dataclass(frozen=True)
class Called:
    """What came of a command."""

    code: int
    out: str
    err: str


def called(capsys: pytest.CaptureFixture[str], *arguments: str) -> Called:
    """Call ``apel``, and catch what it prints."""
    capsys.readouterr()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["apel", *arguments])
        with pytest.raises(SystemExit) as caught:
            main()
    out, err = capsys.readouterr()
    return Called(int(caught.value.code or 0), out, err)


def call(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    """Exit code and standard error of a command."""
    ended = called(capsys, *arguments)
    return ended.code, ended.err


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Standard output of a command that succeeds."""
    ended = called(capsys, *arguments)
    assert ended.code == 0, ended.err
    return ended.out
