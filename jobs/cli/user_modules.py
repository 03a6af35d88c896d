"""Where the modules of a user's own are found: in the working directory, but only by commands that have to run them.

Commands that read may stand in a folder that came from somewhere else: a file there that is called ``matplotlib.py``
must not be run in the place of what is installed. This module imports nothing that such a file could stand for.
"""

# pathlib may not have been imported yet
# ruff: noqa: PTH100, PTH109, PTH119, PTH120
from __future__ import annotations

import os
import sys

_INSTALLED = ("site-packages", "dist-packages")


def leave_working_directory() -> None:
    """Take the working directory off the path, where Python puts it for ``python -m jobs``.

    It stays where this program itself, or what is installed, lies in it.
    """
    here, ours = _working_directory(), os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    if here in ("", os.path.realpath(ours)) or os.path.basename(here) in _INSTALLED:
        return
    sys.path[:] = [entry for entry in sys.path if os.path.realpath(entry or os.curdir) != here]


def find_user_modules() -> None:
    """From now on modules in the working directory are found, behind everything that is installed."""
    here = _working_directory()
    if here and here not in map(os.path.realpath, sys.path):
        sys.path.append(here)


def _working_directory() -> str:
    """Its path; empty where it has been deleted."""
    try:
        return os.path.realpath(os.getcwd())
    except FileNotFoundError:
        return ""
