"""Where an agent is exported to, in which form."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from apel.agents import Agent
from apel.agents.files import AGENT_FILE
from apel.agents.formats import write_onnx, write_sb3
from jobs.experiment.yaml_source import SpecError

Format = Literal["agent", "onnx", "sb3"]
_SUFFIXES = {"onnx": ".onnx", "sb3": ".zip"}


def check_destination(path: Path, form: Format) -> None:
    """See whether an agent can be written there, before anything long begins.

    Raises
    ------
    SpecError
        If it cannot.
    """
    if not path.parent.is_dir():
        message = (
            f"found the destination {str(path)!r}, expected a folder that exists: there is no {str(path.parent)!r}"
        )
        raise SpecError(message)
    if form == "agent":
        if path.exists() and not (path / AGENT_FILE).is_file() and not (path.is_dir() and not any(path.iterdir())):
            message = f"found the destination {str(path)!r}, expected a new folder, or one that holds an agent"
            raise SpecError(message)
    elif path.suffix != _SUFFIXES[form] or path.is_dir():
        message = f"found the destination {str(path)!r}, expected the name of a file that ends in {_SUFFIXES[form]}"
        raise SpecError(message)


def write_export(agent: Agent, path: Path, form: Format) -> None:
    """Write an agent in some form; one learner, the best, where that form has room for one.

    Raises
    ------
    ValueError
        If its learner has no such form.
    """
    if form == "agent":
        agent.save(path)
        return
    name = agent.best if len(agent.names) > 1 else agent.names[0]
    if form == "sb3":
        write_sb3(agent, name, path)
    else:
        write_onnx(agent, name, path)
