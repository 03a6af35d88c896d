"""Processes as users start them, which do not outlast the test that started them, whatever becomes of it."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from tests.forks import BIN


def apel(
    *words: str, cwd: Path, env: Mapping[str, str], check: bool = True, timeout: float = 150.0
) -> subprocess.CompletedProcess[str]:
    """Call ``apel``, with what it prints captured."""
    command = [str(BIN / "apel"), *words]
    return subprocess.run(command, cwd=cwd, env=dict(env), check=check, timeout=timeout, capture_output=True, text=True)


@contextmanager
def started(
    command: Sequence[str],
    *,
    cwd: Path | None = None,
    env: Mapping[str, str] | None = None,
    stdout: int | None = None,
    stderr: int | None = None,
) -> Iterator[subprocess.Popen[str]]:
    """A process that is killed, with signal 9, where the body ends before it does."""
    with subprocess.Popen(command, cwd=cwd, env=env, stdout=stdout, stderr=stderr, text=True) as process:
        try:
            yield process
        finally:
            process.kill()
