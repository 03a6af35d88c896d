"""The command that looks whether all is as it should be: doctor."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from jobs.cli.consoles import OUT, AsJson, print_for_programs
from jobs.remote import DEFAULT_ADDRESS

_MARKS = {"fine": "ok  ", "note": "note", "problem": "BAD "}
_COLOURS = {"fine": "green", "note": "yellow", "problem": "red"}


def add_to(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command()(doctor)


def doctor(
    results: Annotated[
        str, typer.Option(envvar="APEL_RESULTS", help="Folder or URI of the results to check.")
    ] = "results",
    address: Annotated[
        str | None,
        typer.Option(
            envvar="RAY_API_SERVER_ADDRESS",
            metavar="URL",
            help="Dashboard of the cluster to check.",
            show_default=DEFAULT_ADDRESS,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Check this installation, this machine and the cluster: what is fine, what is not, and what to do.

    Nothing is changed. The exit code is 1 where something will fail.
    """
    from jobs.doctor.checks import findings
    from jobs.doctor.gathering import gather

    found = findings(gather(results, address or DEFAULT_ADDRESS, address_is_given=address is not None))
    if as_json:
        print_for_programs([asdict(one) for one in found])
    else:
        for one in found:
            OUT.print(f"{_MARKS[one.state]} {one.subject}: {one.found}", style=_COLOURS[one.state], soft_wrap=True)
            if one.advice:
                OUT.print(f"     → {one.advice}", soft_wrap=True)
    if any(one.state == "problem" for one in found):
        raise typer.Exit(1)
