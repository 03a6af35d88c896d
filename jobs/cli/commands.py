"""Which commands there are, and in which module each of them is, which is imported when the command is called.

So ``apel --help`` and shell completion need none of what commands compute with, which takes a second to import.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

COMMANDS: dict[str, dict[str, str]] = {
    "experiment_commands": {
        "list": "List the shipped experiments.",
        "validate": "Check an experiment by building everything it names once, and say how it will be played.",
        "init": "Write a commented experiment for an environment, with the shipped learners that suit its spaces.",
        "schema": "Print the JSON schema of an experiment file, for editors: its fields, and the options of every "
        "learner and selector.",
    },
    "run_commands": {
        "run": "Run an experiment, or resume it where it stopped.",
        "reproduce": "Run or resume all experiments of a group, then draw the figures, check the claims, and "
        "write one report.",
    },
    "job_commands": {
        "submit": "Run an experiment as a job on a cluster. The spec and those of your modules that it names are "
        "sent along.",
        "jobs": "List APEL's jobs on a cluster, latest first.",
        "status": "Show the progress of a job, arm by arm, as the job reports it.",
        "logs": "Show the output of a job.",
        "stop": "Stop a job once it has written checkpoints; `apel resume` continues it.",
        "resume": "Resubmit a job from this machine: it resumes where it stopped, even on a cluster that has "
        "forgotten it.",
        "fetch": "Copy the results that a job has so far into a folder on this machine.",
    },
    "result_commands": {
        "show": "Show the table of results, from the files alone.",
        "compare": "Say which arm to use, and how sure that is, from the files alone.",
        "figures": "Draw the figures and write the report, from the files alone; or draw a gallery below results/.",
        "claims": "Check the dissertation's claims against the results, from the files alone.",
        "design": "Find APEL's decay ν for one of four goals, and what to expect from it.",
        "watch": "Film one episode of a trained ensemble, from results, or played now by an exported agent.",
    },
    "agent_commands": {
        "export": "Export the trained learners of a run, as a folder of arrays and JSON that `apel.load` reads.",
        "evaluate": "Play episodes with each learner of an agent and with their ensemble, both greedily and as in "
        "training.",
    },
    "doctor_command": {
        "doctor": "Check this installation, this machine and the cluster: what is fine, what is not, and what to do.",
    },
}
"""Module → name of a command → the first paragraph of its help."""
HIDDEN = {"pack": "job_commands"}
"""What only other commands call, and its module."""


class LazyGroup(TyperGroup):
    """The commands, each of them empty until it is the one that was called."""

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self._modules = dict(HIDDEN)
        for module, summaries in COMMANDS.items():
            for name, summary in summaries.items():
                self._modules[name] = module
                self.add_command(TyperCommand(name, help=summary), name)
        for name in HIDDEN:
            self.add_command(TyperCommand(name, hidden=True), name)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Import the command's module first."""
        if args and args[0] in self._modules:
            self.add_command(loaded(args[0], self._modules[args[0]]), args[0])
        return super().resolve_command(ctx, args)


def loaded(name: str, module: str) -> Any:
    """A command, from its module."""
    app = typer.Typer(pretty_exceptions_enable=False, add_completion=False)
    import_module(f"jobs.cli.{module}").add_to(app)
    app.callback()(_nothing)  # else a module with a single command would be that command
    return get_command(app).commands[name]  # type: ignore[attr-defined]


def _nothing() -> None:
    return
