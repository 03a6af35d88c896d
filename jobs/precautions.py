"""What is looked at before a job begins: what would go wrong in its processes, and what its user should know."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from numbers import Integral
from pathlib import Path
from typing import Any

from apel.numerics.near_names import did_you_mean
from jobs.experiment.plan import Plan
from jobs.experiment.user_modules import OURS
from jobs.experiment.yaml_source import SpecError

_DEPENDENCIES = (
    "gymnasium", "llvmlite", "numba", "numpy", "pandas", "pyarrow", "pydantic", "ray", "rich", "scipy", "torch",
    "typer", "yaml",
)  # fmt: skip
_ROOT = Path(__file__).resolve().parent.parent
_GPU = re.compile(r"cuda(:\d+)?")
_PROCESS_BYTES = 130 * 2**20
"""Of an actor that holds a tabular learner; PyTorch takes more."""
_MOST_PROCESSES_PER_CPU = 12


def refuse_shadowing(folders: Sequence[Path] | None = None) -> None:
    """Find modules of a user's that processes of a job would load in the place of ours, or of what ours rest on.

    Without folders: in the current one and in the script's, which Ray puts first on the path of every process.

    Raises
    ------
    SpecError
        If there is one.
    """
    places = dict.fromkeys(folders or (Path.cwd(), Path(sys.argv[0] or ".").resolve().parent))
    found = [_module_in(folder, name) for folder in places for name in (*OURS, *_DEPENDENCIES)]
    hiding = [str(path) for path in found if path is not None and not _is_the_real_one(path)]
    if clones := [folder for folder in places if all(str(folder / one / "__init__.py") in hiding for one in OURS)]:
        message = (
            f"{clones[0]}: found a clone of this program, which a job's processes would load in place of the installed "
            f"copy, expected them to be the same: pip install -e {clones[0]}, or run the command elsewhere"
        )
        raise SpecError(message)
    if hiding:
        message = (
            f"{', '.join(hiding)}: found {'a module' if len(hiding) == 1 else 'modules'} of yours with the name of a "
            "package that a job needs, and whose processes would confuse the two, expected other names: rename what "
            "stands in the way"
        )
        raise SpecError(message)


def refuse_shadowing_beside(spec: str) -> None:
    """The same, and in the folder of an experiment file."""
    refuse_shadowing()
    if Path(spec).is_file():
        refuse_shadowing([Path(spec).resolve().parent])


def _module_in(folder: Path, name: str) -> Path | None:
    for path in (folder / f"{name}.py", folder / name / "__init__.py"):
        if path.is_file():
            return path
    return None


def _is_the_real_one(path: Path) -> bool:
    return any(path.resolve() == _ROOT / name / "__init__.py" for name in OURS) or "site-packages" in path.parts


def refuse_missing_gpus(plan: Plan, *, counts_shares: bool) -> None:
    """Find learners for GPUs that this machine has not; ``counts_shares``: also of those that get shares of them.

    Raises
    ------
    SpecError
        If there are some.
    """
    asked = [place for one in plan.arm_points for place in _gpu_fields(one, counts_shares=counts_shares)]
    if not asked:
        return
    field, found, wanted = max(asked, key=lambda each: each[2])
    num_gpus = _num_gpus()
    if wanted > num_gpus:
        there = "no GPU" if not num_gpus else f"{num_gpus} GPU(s)"
        message = (
            f"{plan.experiment.where(*field)}: found {found}, but this machine has {there}: leave it out to compute on "
            "CPUs, or name a cluster that has them with --address"
        )
        raise SpecError(message)


def _gpu_fields(arm_point: Any, *, counts_shares: bool) -> Iterator[tuple[tuple[str, ...], str, float]]:
    """Field, what stands there, and how many GPUs that takes."""
    experiment = arm_point.point.experiment
    names = arm_point.spec.learner_names
    for name in dict.fromkeys(names):
        learner = experiment.learners[name]
        device = str(learner.options.get("device", ""))
        if _GPU.fullmatch(device):
            yield ("learners", name, "device"), device, float(device.partition(":")[2] or 0) + 1
        if counts_shares and learner.num_gpus:
            total = sum(experiment.learners[each].num_gpus for each in names)
            yield ("learners", name, "num_gpus"), str(learner.num_gpus), total


def _num_gpus() -> int:
    try:
        import torch
    except ImportError:
        return 0
    return torch.cuda.device_count()


def of_many_processes(plan: Plan, num_cpus: int | None) -> list[str]:
    """A word where so many learners would be a process each that the machine may not bear it."""
    num_learners = max((one.num_learners for one in plan.arm_points), default=1)
    num_gangs = min(num_cpus or os.cpu_count() or 1, len(plan.seeds) * len(plan.arm_points))
    num_processes = num_gangs * (num_learners + 1)
    nbytes = num_processes * _PROCESS_BYTES
    if num_learners < _MOST_PROCESSES_PER_CPU and nbytes < _available_bytes() / 2:
        return []
    message = (
        f"{num_learners} learners of an arm are {num_learners + 1} processes for each CPU, {num_processes} in all, "
        f"which take about {nbytes / 1e9:.0f} GB of memory: --placement packed plays an arm in one process, with the "
        "same results"
    )
    return [message]


def _available_bytes() -> float:
    try:
        return float(os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (ValueError, OSError):
        return float("inf")


def of_this_machine(wanted: Plan, placement: str, num_cpus: int | None, say: Callable[[str], None]) -> None:
    """Refuse what this machine cannot play, and warn of what it may not bear; a cluster is asked when it is joined."""
    if _has_joined():
        return
    refuse_missing_gpus(wanted, counts_shares=placement != "local")
    if placement == "actors":
        for message in of_many_processes(wanted, num_cpus):
            say(message)


def refuse_settings(placement: str, known: Sequence[str], **counts: Any) -> None:
    """Refuse a placement that is none of the known ones, and counts that are none; None is a count of its own.

    Raises
    ------
    SpecError
        If there is one.
    """
    if placement not in known:
        meant = did_you_mean(placement, known)
        message = f"placement: found {placement!r}, expected {', '.join(known[:-1])} or {known[-1]}{meant}"
        raise SpecError(message)
    for name, count in counts.items():
        if count is not None and (isinstance(count, bool) or not isinstance(count, Integral) or count < 1):
            message = f"{name}: found {count!r}, expected a whole number, at least 1"
            raise SpecError(message)


def _has_joined() -> bool:
    """Whether this process is connected to a cluster already; without importing Ray where nobody has."""
    ray = sys.modules.get("ray")
    return ray is not None and bool(ray.is_initialized())
