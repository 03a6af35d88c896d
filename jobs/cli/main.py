"""The command line, ``apel``. Exit codes: 0 done; 1 a run failed; 2 bad input; 130 interrupted."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Annotated, Any, NoReturn

import typer

from jobs.cli.commands import LazyGroup
from jobs.cli.consoles import print_error
from jobs.cli.stopping import InterruptedJobError
from jobs.cli.user_modules import leave_working_directory

app = typer.Typer(cls=LazyGroup, no_args_is_help=True, pretty_exceptions_enable=False)


def _show_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        typer.echo(f"apel {version('apel')}")
        raise typer.Exit


@app.callback()
def _program(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Ensembles of different reinforcement learners, over a hundred seeds, on Ray."""


def main() -> None:
    """Entry point."""
    leave_working_directory()
    signal.signal(signal.SIGTERM, _interrupt)
    with _exit_codes():
        _require_text(sys.argv)
        app(prog_name="apel")


def _require_text(arguments: Sequence[str]) -> None:
    """See that every argument is text: bytes that are none could be written to no file and shown to nobody."""
    for argument in arguments:
        if not argument.isascii() and argument.encode("utf-8", "replace").decode() != argument:
            _fail(f"found the argument {argument!r}, expected text in UTF-8", 2)


@contextmanager
def _exit_codes() -> Iterator[None]:
    """Expected errors become one message and an exit code; anything else is a bug and keeps its traceback."""
    try:
        yield
    except (KeyboardInterrupt, InterruptedJobError):
        _fail("interrupted; finished work is stored, and the same command resumes from here", 130)
    except Exception as error:
        code = _code_of(error)
        if code is None:
            raise
        _fail(str(error), code)


def _code_of(error: Exception) -> int | None:
    """The exit code of an expected error; None for a bug. What is raised by a module that is imported by now."""
    from cluster.checkpoint import CheckpointError
    from cluster.errors import ClusterError
    from jobs.experiment.yaml_source import SpecError
    from jobs.results.lease import BusyError
    from jobs.results.storage_faults import LinkError
    from jobs.results.store import StoreError

    if isinstance(error, SpecError | StoreError | BusyError | LinkError):
        return 2
    return 1 if isinstance(error, ClusterError | CheckpointError | OSError) else None


def _fail(message: str, code: int) -> NoReturn:
    for line in message.splitlines():
        print_error(line)
    raise SystemExit(code)


def _interrupt(*_: Any) -> None:
    raise KeyboardInterrupt
