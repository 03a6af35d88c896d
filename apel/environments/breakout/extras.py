"""Packages that only some install."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from gymnasium.error import DependencyNotInstalled


def import_extra(name: str, extra: str) -> Any:
    """Import the module ``name`` of an optional package.

    Raises
    ------
    DependencyNotInstalled
        If it cannot be imported, saying which ``extra`` of this project brings it.
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise missing(name, extra, error) from error


def missing(name: str, extra: str, reason: object) -> DependencyNotInstalled:
    """What is raised where ``name`` cannot be imported."""
    return DependencyNotInstalled(f"{name} cannot be imported ({reason}): pip install 'apel[{extra}]'")
