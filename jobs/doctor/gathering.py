"""The facts as they are here: everything that looks at the machine, and nothing that judges."""

from __future__ import annotations

import os
import platform
import shutil
import stat
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

from packaging.requirements import Requirement

from jobs.doctor.facts import Answer, Facts, Gpus, Machine, Token, Versions

_OURS = "apel"
_SERVICE = "service"
_EXTRAS = (
    "deep", "sb3", "atari", "minatar", "box2d", "minigrid", "highway", "onnx", "video", "tensorboard", "mlflow",
    "wandb",
)  # fmt: skip
_CONSTRAINTS = Path(__file__).resolve().parents[2] / "constraints.txt"
_CGROUP_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def gather(results: str, address: str, *, address_is_given: bool) -> Facts:
    """All facts. Takes up to half a minute where something does not answer, else about three seconds."""
    return Facts(
        machine=_machine(),
        versions=_versions(),
        ray=_ray_error(),
        gpus=_gpus(),
        cache=_cache(),
        storage=Answer(results, _storage_error(results)),
        cluster=Answer(address, _cluster_error(address), address_is_given),
        token=found_token(os.environ, Path.home()),
    )


def _machine() -> Machine:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    shared = shutil.disk_usage("/dev/shm").free if Path("/dev/shm").is_dir() else None
    return Machine(platform.system(), sys.version_info[:3], cores, _memory(), shared)


def _memory() -> int | None:
    """That of the machine, or of the container, whichever is less."""
    limits = []
    with suppress(ValueError, OSError, AttributeError):
        limits.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    for file in _CGROUP_LIMITS:
        with suppress(ValueError, OSError):
            limits.append(int(Path(file).read_text()))
    return min(limits, default=None)


def _versions() -> Versions:
    required = [Requirement(text) for text in requires(_OURS) or []]
    extras = {name: not unmet(required, name) for name in _EXTRAS}
    pinned = None if not _CONSTRAINTS.is_file() else differing(_CONSTRAINTS.read_text())
    return Versions(version(_OURS), unmet(required, "") | unmet(required, _SERVICE), pinned, extras)


def unmet(required: list[Requirement], extra: str) -> dict[str, str | None]:
    """What an extra, or without one the core, needs and does not find: requirement → the version that is there."""
    found: dict[str, str | None] = {}
    for one in _needed(required, extra):
        there = _installed(one.name)
        if there is None or not one.specifier.contains(there, prereleases=True):
            found[f"{one.name}{one.specifier}"] = there
    return found


def _needed(required: list[Requirement], extra: str) -> Iterator[Requirement]:
    for one in required:
        is_core = one.marker is None or one.marker.evaluate({"extra": ""})
        if is_core if not extra else not is_core and one.marker is not None and one.marker.evaluate({"extra": extra}):
            if one.name == _OURS:
                for inner in one.extras:
                    yield from _needed(required, inner)
            else:
                yield one


def differing(constraints: str) -> dict[str, tuple[str, str]]:
    """Package → pinned and installed version, of what is installed in another one. A local part (``+cpu``) is none."""
    pins = (line.split("#")[0].strip().split("==") for line in constraints.splitlines() if "==" in line)
    found = ((name, pinned, _installed(name)) for name, pinned in pins)
    return {name: (pinned, there) for name, pinned, there in found if there and there.split("+")[0] != pinned}


def _installed(name: str) -> str | None:
    with suppress(PackageNotFoundError):
        return version(name)
    return None


def _ray_error() -> str:
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    try:
        import ray  # noqa: F401
    except Exception as error:  # noqa: BLE001 - whatever a broken installation raises
        return f"{type(error).__name__}: {error}"
    return ""


def _gpus() -> Gpus:
    """PyTorch, which takes seconds to import, is asked only where there is a card."""
    cards = Path("/proc/driver/nvidia/gpus")
    seen = len(list(cards.iterdir())) if cards.is_dir() else 0
    torch_version, usable = _installed("torch"), 0
    if seen and torch_version is not None:
        with suppress(Exception):
            import torch

            usable = torch.cuda.device_count()
    return Gpus(seen, torch_version, usable)


def _cache() -> Path | None:
    from apel.numerics.caching import cache_root

    return cache_root()


def _storage_error(results: str) -> str:
    """Why nothing can be written there; a folder is not made for that, but the nearest one that is there is asked."""
    from jobs.results.storage import reached

    try:
        reached(results)
        if "://" not in results:
            folder = Path(results).absolute()
            nearest = next(one for one in (folder, *folder.parents) if one.exists())
            if not (nearest.is_dir() and os.access(nearest, os.W_OK)):
                return f"{nearest} cannot be written to"
    except Exception as error:  # noqa: BLE001 - whatever a store says
        return str(error)
    return ""


def _cluster_error(address: str) -> str:
    try:
        from jobs.remote.connection import connected

        with connected(address) as client:
            client.list_jobs()
    except Exception as error:  # noqa: BLE001 - also of a Ray that cannot be imported
        return str(error)
    return ""


def found_token(environment: Mapping[str, str], home: Path) -> Token:
    """The token that Ray would show, by where it looks for one."""
    mode = environment.get("RAY_AUTH_MODE", "")
    if environment.get("RAY_AUTH_TOKEN"):
        return Token(mode, "RAY_AUTH_TOKEN")
    path = Path(environment.get("RAY_AUTH_TOKEN_PATH") or home / ".ray" / "auth_token")
    with suppress(OSError):
        return Token(mode, str(path), bool(path.stat().st_mode & (stat.S_IRGRP | stat.S_IROTH)))
    return Token(mode)
