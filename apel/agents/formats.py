"""A learner of an agent in forms that other programs read."""

from __future__ import annotations

import importlib
import os
from typing import Any

from apel.agents.agent import Agent
from apel.agents.making import make_trained
from apel.building.registry import LEARNERS

_DEEP = ("dqn", "acer", "sac")


def write_sb3(agent: Agent, name: str, path: str | os.PathLike[str]) -> None:
    """Write an algorithm of stable-baselines3 as its own zip file, which its ``load`` reads.

    Raises
    ------
    ValueError
        If the learner is none.
    """
    learner: Any = agent.learner(name)
    kind = agent.content.learners[agent.names.index(name)].config.name
    if not hasattr(learner, "algorithm") or not hasattr(learner, "save"):
        message = f"--format sb3: found the learner {name!r} of the type {kind}, expected one of stable_baselines"
        raise ValueError(message)
    learner.save(os.fspath(path))


def write_onnx(agent: Agent, name: str, path: str | os.PathLike[str]) -> None:
    """Write the network of a deep learner as ONNX, and see that onnxruntime gives the same actions as the learner.

    It takes ``observation`` ``[batch, …]``, which is what the learner sees (its representation), and gives ``values``
    ``float32[batch, actions]`` and ``action`` ``int64[batch]``, the first of the best ones.

    Raises
    ------
    ValueError
        If the learner is no network, or the packages of the extra ``onnx`` are not installed.
    """
    one = agent.content.learners[agent.names.index(name)]
    if one.config.type not in _DEEP or one.config.name not in LEARNERS:
        wanted = ", ".join(_DEEP)
        message = f"--format onnx: found the learner {name!r} of the type {one.config.name}, expected one of {wanted}"
        raise ValueError(message)
    try:
        for package in ("onnx", "onnxruntime"):
            importlib.import_module(package)
    except ImportError as error:
        message = f'--format onnx: found no {error.name}, expected it to be installed: pip install "apel[onnx]"'
        raise ValueError(message) from error
    from apel.agents.onnx_form import checked_model

    learner, view = make_trained(agent.content, agent.names.index(name))
    stored = checked_model(learner, view.space, int(agent.content.spaces.action.start))
    with open(path, "wb") as file:  # noqa: PTH123 - whatever is a path
        file.write(stored)
