"""An agent as a folder: ``agent.json`` to read, ``arrays.npz`` with all arrays. Neither holds code."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from apel.agents.content import AgentContent, agent_digest, agent_tree, content_of
from apel.numerics.state_trees import StateError, arrays_from, bytes_of_arrays, flatten, restore

AGENT_FILE, ARRAYS_FILE = "agent.json", "arrays.npz"


def agent_files(content: AgentContent) -> dict[str, bytes]:
    """Name → bytes of the files of an agent.

    Raises
    ------
    StateError
        If a learner's state cannot be stored.
    """
    skeleton, arrays = flatten(agent_tree(content))
    told = {"digest": agent_digest(content), **skeleton}
    return {AGENT_FILE: json.dumps(told, indent=1).encode(), ARRAYS_FILE: bytes_of_arrays(arrays)}


def content_of_files(text: bytes, arrays: bytes) -> tuple[AgentContent, str]:
    """The agent of these files, and its digest.

    Raises
    ------
    StateError
        If they are none of this version, or damaged.
    """
    try:
        skeleton: dict[str, Any] = json.loads(text)
        told = skeleton.pop("digest")
    except (ValueError, KeyError, AttributeError, TypeError, UnicodeDecodeError) as error:
        message = f"found no agent ({type(error).__name__}: {error}), expected one that `apel export` wrote"
        raise StateError(message) from error
    content = content_of(restore(skeleton, arrays_from(arrays)))
    if agent_digest(content) != told:
        message = f"found another agent than the one whose digest {str(told)[:12]!r} is noted: it is damaged, or mixed"
        raise StateError(message)
    return content, told


def write_agent(content: AgentContent, folder: str | os.PathLike[str]) -> None:
    """Write the files into a folder, which is made where it is not there.

    Raises
    ------
    ValueError
        If there is something else than an agent, or a learner's state cannot be stored.
    OSError
        If it cannot be written.
    """
    path = Path(folder)
    files = agent_files(content)
    unfinished = {name: path / f".{name}.unfinished" for name in files}
    ours = {*files, *(one.name for one in unfinished.values())}  # a process may have died between the two
    if path.exists() and not (path.is_dir() and {one.name for one in path.iterdir()} <= ours):
        message = f"{path}: found something that is no agent, expected a new folder, or that of an agent"
        raise ValueError(message)
    path.mkdir(parents=True, exist_ok=True)
    for name, stored in files.items():
        unfinished[name].write_bytes(stored)
        unfinished[name].replace(path / name)


def read_agent(folder: str | os.PathLike[str]) -> tuple[AgentContent, str]:
    """The agent in a folder, and its digest.

    Raises
    ------
    ValueError
        If there is none; the message says what was found.
    """
    path = Path(folder)
    if not (path / AGENT_FILE).is_file() or not (path / ARRAYS_FILE).is_file():
        message = f"{path}: found no {AGENT_FILE} and {ARRAYS_FILE}, expected the folder of an agent"
        raise ValueError(message)
    try:
        return content_of_files((path / AGENT_FILE).read_bytes(), (path / ARRAYS_FILE).read_bytes())
    except StateError as error:
        message = f"{path}: {error}"
        raise ValueError(message) from error
