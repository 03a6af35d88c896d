"""What is built of an experiment to see whether it can be, and how long that may take."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from apel.environments import World, close_environments
from cluster.learner_host import make_run_world
from cluster.shard import RunPlan

_CPU_SECONDS = 0.75
"""That more parts of kinds that were built before may take."""
_MAX_WORLDS_KEPT = 20


@dataclass
class Trial:
    """Builds each different part once: the first of a kind always, others of that kind while time lasts.

    Attributes
    ----------
    num_built, num_left:
        How many parts (environments, learners, selectors of so many learners) were built, and how many are left for
        when their turn comes.
    """

    num_built: int = 0
    num_left: int = 0
    _seconds: float = _CPU_SECONDS
    _parts: set[str] = field(default_factory=set)
    _kinds: set[str] = field(default_factory=set)
    _worlds: dict[str, World] = field(default_factory=dict)

    @property
    def has_time(self) -> bool:
        """Whether there is time for more than what is new."""
        return self._seconds > 0.0

    def wants(self, kind: str, *part: Any) -> bool:
        """Whether this part is to be built now."""
        key = repr((kind, part))
        if key in self._parts:
            return False
        self._parts.add(key)
        is_wanted = self.has_time or kind not in self._kinds
        self.num_built += is_wanted
        self.num_left += not is_wanted
        return is_wanted

    @contextmanager
    def building(self, kind: str) -> Iterator[None]:
        """Counts the time, but for the first of a kind, which has to be imported and compiled."""
        began = time.process_time()
        yield
        if kind in self._kinds:
            self._seconds -= time.process_time() - began
        self._kinds.add(kind)

    def world(self, run: RunPlan) -> World | None:
        """The environment of a run; None where it is left for later.

        Raises
        ------
        ValueError
            If it cannot be built.
        """
        key, kind = repr((run.environment, run.seed)), f"environment {run.environment.id}"
        if key not in self._worlds and (self.wants(kind, run.environment, run.seed) or self.has_time):
            if len(self._worlds) >= _MAX_WORLDS_KEPT:
                self.close()
            with self.building(kind):
                self._worlds[key] = make_run_world(run)
        return self._worlds.get(key)

    def close(self) -> None:
        """Close the environments that were built, which may hold processes and windows."""
        close_environments([world.environment for world in self._worlds.values()])
        self._worlds.clear()
