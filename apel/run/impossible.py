"""An impossible state tells its story: where it was found, and what came before."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

Facts = Mapping[str, int | str]


class ImpossibleStateError(RuntimeError):
    """A bug of this program, never a user's mistake. Survives pickling, and may be told more on its way up.

    >>> error = ImpossibleStateError("found a gap", {"expected episode": 5, "found episode": 7})
    >>> print(error.told_more({"run": 3, "seed": 17}, ["round 1: Q_full plays run 3 from episode 0"]))
    found a gap: run 3, seed 17, expected episode 5, found episode 7
    This is a bug of the program, not of the experiment. What came before:
      round 1: Q_full plays run 3 from episode 0

    Parameters
    ----------
    what:
        What is impossible, in one line.
    facts:
        Where, and what was expected and found, by name; in the order in which they are to be told.
    story:
        What came before, one line each, the oldest first.
    """

    def __init__(self, what: str, facts: Facts | None = None, story: Sequence[str] = ()) -> None:
        # As its arguments, since an exception is unpickled by calling its class with them.
        super().__init__(what, dict(facts or {}), tuple(story))
        self.what = what
        self.facts: dict[str, int | str] = dict(facts or {})
        self.story = tuple(story)

    def __str__(self) -> str:
        facts = ", ".join(f"{name} {value}" for name, value in self.facts.items())
        lines = [f"{self.what}: {facts}" if facts else self.what]
        lines.append("This is a bug of the program, not of the experiment.")
        if self.story:
            lines[-1] += " What came before:"
        return "\n".join([*lines, *(f"  {line}" for line in self.story)])

    def told_more(self, facts: Facts, story: Sequence[str] = ()) -> ImpossibleStateError:
        """The same error with more facts, before its own, and with what came before its own story."""
        return ImpossibleStateError(self.what, {**facts, **self.facts}, (*story, *self.story))
