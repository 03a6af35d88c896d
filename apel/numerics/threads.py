"""On how many threads PyTorch computes: on one, unless somebody says otherwise.

Left alone it takes all cores for each product. The networks here are small, so that threads wait for each other most of
the time, and several processes on one machine for those of the others: 129 s where one thread takes 28, with the same
rows. Who wants more says so before the first deep learner is made: with ``OMP_NUM_THREADS`` (or ``MKL_NUM_THREADS``)
in the environment, or by a call of ``torch.set_num_threads``; or afterwards, by such a call.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path

VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS")
_SIBLINGS = "/sys/devices/system/cpu/cpu{}/topology/thread_siblings_list"
_is_settled = False


def settle() -> None:
    """Settle it once in this process, if PyTorch is loaded: to be called where a learner is made that may use it."""
    global _is_settled  # noqa: PLW0603 - of a process, and nobody else's
    if _is_settled or "torch" not in sys.modules:
        return
    import torch

    _is_settled = True
    # A library that was loaded before a variable was set (by Ray, for one) has not heard of it.
    if torch.get_num_threads() in _untouched():
        torch.set_num_threads(_wanted())


def _wanted() -> int:
    for name in VARIABLES:
        # OMP_NUM_THREADS may be a list, for nested regions.
        with suppress(ValueError):
            return max(int(os.environ.get(name, "").split(",")[0]), 1)
    return 1


def _untouched() -> set[int]:
    """What PyTorch begins with where nobody has set anything: the cores that this process may use, or their threads."""
    count = os.cpu_count() or 1
    if not hasattr(os, "sched_getaffinity"):
        return {count}
    usable = os.sched_getaffinity(0)
    cores = set()
    for cpu in usable:
        with suppress(OSError):
            cores.add(Path(_SIBLINGS.format(cpu)).read_text())
    return {count, len(usable), len(cores) or count}
