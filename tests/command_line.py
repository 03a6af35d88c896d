"""The program called in this process, since an interpreter of its own takes two seconds."""

from __future__ import annotations

import sys

import pytest

from jobs.cli import main


def call(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    """Exit code and standard error of a command."""
    capsys.readouterr()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["apel", *arguments])
        with pytest.raises(SystemExit) as caught:
            main()
    return int(caught.value.code or 0), capsys.readouterr().err
