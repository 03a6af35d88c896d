"""What is known of an installation, a machine and a cluster: plain values, from which everything is judged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

State = Literal["fine", "note", "problem"]
"""``note``: works, but not as well as it could, or not everything; ``problem``: something will fail."""


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes
    ----------
    subject:
        What was looked at.
    state:
        How it is.
    found:
        In a few words.
    advice:
        What to do; empty where there is nothing to do.
    """

    subject: str
    state: State
    found: str
    advice: str = ""


@dataclass(frozen=True)
class Machine:
    """Memory in bytes; None where this system does not tell.

    Attributes
    ----------
    cores:
        That this process may use.
    memory, shared_memory:
        In all; of ``/dev/shm``, where Ray's object store lies, what is free.
    """

    system: str
    python: tuple[int, int, int]
    cores: int
    memory: int | None
    shared_memory: int | None


@dataclass(frozen=True)
class Gpus:
    """Graphics cards, and whether PyTorch can use them.

    Attributes
    ----------
    seen:
        Number of cards that the system shows.
    torch:
        Its version; None where it is not installed.
    usable:
        Number of cards that PyTorch finds.
    """

    seen: int = 0
    torch: str | None = None
    usable: int = 0


@dataclass(frozen=True)
class Versions:
    """What is installed.

    Attributes
    ----------
    ours:
        That of this program.
    unmet:
        Requirement of this program → the version that is installed, None for none.
    pinned:
        Package → pinned and installed version, where they differ; None where no ``constraints.txt`` is at hand.
    extras:
        Extra → whether all that it needs is installed.
    """

    ours: str
    unmet: Mapping[str, str | None] = field(default_factory=dict)
    pinned: Mapping[str, tuple[str, str]] | None = None
    extras: Mapping[str, bool] = field(default_factory=dict)


@dataclass(frozen=True)
class Answer:
    """What came of asking something for which one may have to wait.

    Attributes
    ----------
    place:
        What was asked.
    error:
        Empty where all went well.
    asked:
        Whether the user has named it, or it is a default.
    """

    place: str
    error: str = ""
    asked: bool = True


@dataclass(frozen=True)
class Token:
    """What Ray will show to a cluster.

    Attributes
    ----------
    mode:
        Of ``RAY_AUTH_MODE``; empty where it is not set.
    source:
        Where a token was found; empty for none.
    readable_by_others:
        Whether its file is.
    """

    mode: str = ""
    source: str = ""
    readable_by_others: bool = False


@dataclass(frozen=True)
class Facts:
    """All of it.

    Attributes
    ----------
    ray:
        Why Ray cannot be imported; empty where it can.
    cache:
        Folder of what is compiled; None where none can be written to.
    """

    machine: Machine
    versions: Versions
    ray: str
    gpus: Gpus
    cache: Path | None
    storage: Answer
    cluster: Answer
    token: Token
