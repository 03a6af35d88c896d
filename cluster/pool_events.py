"""What a pool's state is told, and what it answers: see `cluster.pool_state`.

*Events* say what happened, *instructions* what is to be done. Gangs have numbers, in the order of their hiring.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

from cluster.events import ShardDone, ShardEvent, ShardProgress, ShardReplayed, ShardStopped
from cluster.shard import Shard

Gpus = tuple[float, ...]
"""The share of GPUs of each learner; empty where none has any."""


@dataclass(frozen=True, slots=True)
class JobBegun:
    """The job's shards, to be begun in this order. Answered with `GiveUp` where one wants more GPUs than there are."""

    shards: tuple[Shard, ...]
    num_gpus: float
    """Of all nodes together, whoever uses them."""


@dataclass(frozen=True, slots=True)
class CpusCounted:
    """So many CPUs the nodes that are there now have together; nodes may join or leave at any time."""

    num_cpus: int


@dataclass(frozen=True, slots=True)
class Tick:
    """Time has passed. Answered with `Hire`, `Dismiss` and `Start`, then with a `Wait`."""


@dataclass(frozen=True, slots=True)
class StopAsked:
    """The job is to end early. Gangs in ``placed`` are asked to stop; the others, which have no process yet, go."""

    placed: frozenset[int]
    """Those gangs under way for which the cluster had room."""


@dataclass(frozen=True, slots=True)
class GangReported:
    """A gang says how far its shard has come, or how it ended."""

    gang: int
    report: ShardProgress | ShardReplayed | ShardDone | ShardStopped


@dataclass(frozen=True, slots=True)
class GangFreed:
    """A gang has said the last of its shard, and may take another one."""

    gang: int


@dataclass(frozen=True, slots=True)
class GangLost:
    """Processes of a gang died. Answered with `Dismiss`, and a shard that begins again later, or `GiveUp`."""

    gang: int
    reason: str
    """In one line."""
    cause: Exception | None = None


@dataclass(frozen=True, slots=True)
class GangFailed:
    """The code that a gang runs raised an error. It would do so again: answered with `GiveUp`."""

    gang: int
    error: Exception
    cause: Exception | None = None


PoolEvent = JobBegun | CpusCounted | Tick | StopAsked | GangReported | GangFreed | GangLost | GangFailed


@dataclass(frozen=True, slots=True)
class Hire:
    """Start the processes of a new gang."""

    gang: int
    gpus: Gpus


@dataclass(frozen=True, slots=True)
class Dismiss:
    """End a gang's processes, those that are left, and give back its CPU."""

    gang: int


@dataclass(frozen=True, slots=True)
class Start:
    """Let a gang play a shard, from its checkpoint if there is one."""

    gang: int
    shard: Shard


@dataclass(frozen=True, slots=True)
class AskToStop:
    """Let a gang write a checkpoint and end its shard."""

    gang: int


@dataclass(frozen=True, slots=True)
class Report:
    """Tell whoever watches the job."""

    shard: Shard
    event: ShardEvent


@dataclass(frozen=True, slots=True)
class Wait:
    """Wait until one of these gangs has something to say, at most so long; where there is none, so long."""

    gangs: tuple[int, ...]
    seconds: float


@dataclass(frozen=True, slots=True)
class GiveUp:
    """End the job with an error."""

    error: Exception
    cause: Exception | None = None


Instruction = Hire | Dismiss | Start | AskToStop | Report | Wait | GiveUp


def in_words(message: PoolEvent | Instruction) -> str:
    """In one short line: a shard is told by its label, since it holds the configuration of all its runs.

    >>> in_words(Hire(gang=3, gpus=(0.5, 0.0)))
    'Hire(gang=3, gpus=(0.5, 0.0))'
    """
    values = [f"{field.name}={_value(getattr(message, field.name))}" for field in fields(message)]
    return f"{type(message).__name__}({', '.join(values)})"


def _value(value: object) -> str:
    if isinstance(value, Shard):
        return value.label
    if isinstance(value, tuple) and value and isinstance(value[0], Shard):
        return f"{len(value)} shards"
    if isinstance(value, ShardProgress):
        return f"ShardProgress(episodes={value.episodes})"
    return repr(value)
