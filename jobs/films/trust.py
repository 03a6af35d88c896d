"""Whose code a film or a replay runs: that of this program and of installed packages, and no other's without being told
so.
"""

from __future__ import annotations

from jobs.experiment.foreign_code import foreign_code
from jobs.experiment.yaml_source import SpecError
from jobs.results.sinks import SPEC_FILE
from jobs.results.store import ResultStore


def refuse_foreign_code(store: ResultStore) -> None:
    """See that playing these results again runs nothing but what is shipped.

    Raises
    ------
    SpecError
        If the experiment names other code; the message says which.
    """
    found = foreign_code(store.experiment())
    if found:
        named = "".join(f"\n  {name}" for name in found)
        message = (
            f"{store.folder.location(SPEC_FILE)}: found code that is not shipped, which would be run:{named}\n"
            "if you know whose it is, and trust it: say --trust"
        )
        raise SpecError(message)
