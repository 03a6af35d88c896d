"""What the hosts start from: this system's files below those of an image, made as the Dockerfile says."""

from __future__ import annotations

import os
import re
import resource
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path

from tests.hosts.compose import ROOT
from tests.hosts.machine import Machine, checked

USER, UID, GID = "ray", 1000, 100
HOME, SOURCES = Path("/home/ray"), Path("/opt/apel")
# What this machine has there is no part of any image.
_HIDDEN = {"tmp": 0o1777, "run": 0o755, "home": 0o755, "opt": 0o755, "mnt": 0o755}
_DOCKERFILE = (ROOT / "Dockerfile").read_text()
# As in the image, where the project is installed; what is installed here may be another checkout.
_ENVIRONMENT = {
    "PATH": f"{Path(sys.executable).parent}:/usr/local/bin:/usr/bin:/bin",
    "HOME": str(HOME),
    "PYTHONPATH": str(SOURCES),
    "LANG": "C.UTF-8",
}


def build(machine: Machine) -> Path:
    """The layer of the image, within the machine's disk."""
    layer = machine.disk / "image"
    _write(machine.path(layer))
    root = mounted(machine, "build", layer.with_name("build-root"), (Path("/"),), upper=layer)
    _let_anyone_pass(machine.path(root))
    machine.do("chroot", str(root), "sh", "-c", _run_line("install -d"))
    machine.do("mount", "--bind", "/dev", str(root / "dev"))
    compile_all = _run_line("python -c")
    checked(machine.inside("chroot", str(root), *as_user({}, 4096, "sh", "-c", compile_all)), timeout=600.0)
    machine.do("umount", str(root / "dev"), str(root))
    return layer


def mounted(machine: Machine, name: str, root: Path, lower: tuple[Path, ...], upper: Path | None = None) -> Path:
    """A folder that shows the lower layers, the first on top, with an upper one of its own, which takes what is
    written.
    """
    upper = upper or machine.disk / f"{name}-upper"
    work = machine.disk / f"{name}-work"
    machine.do("mkdir", "-p", str(root), str(upper), str(work))
    layers = f"lowerdir={':'.join(str(path) for path in lower)},upperdir={upper},workdir={work}"
    machine.do("mount", "-t", "overlay", "overlay", "-o", layers, str(root))
    return root


def as_user(variables: Mapping[str, str], num_files: int, *command: str) -> list[str]:
    """The command that runs another one as the image's user, with no rights beyond, and with this environment only."""
    environment = [f"{key}={value}" for key, value in {**_ENVIRONMENT, **variables}.items()]
    # More than this machine allows cannot be had without the right to.
    most = min(num_files, resource.getrlimit(resource.RLIMIT_NOFILE)[1])
    confined = ["--no-new-privs", "--inh-caps=-all", "--bounding-set=-all"]
    return [
        "prlimit", f"--nofile={most}:{most}",
        "setpriv", f"--reuid={UID}", f"--regid={GID}", "--clear-groups", *confined,
        "env", "--ignore-environment", f"--chdir={HOME}", *environment, *command,
    ]  # fmt: skip


def _write(layer: Path) -> None:
    """The files of the image."""
    layer.mkdir()
    layer.chmod(0o755)
    for name, mode in _HIDDEN.items():
        (layer / name).mkdir()
        (layer / name).chmod(mode)
        os.setxattr(layer / name, "trusted.overlay.opaque", b"y")
    (layer / "etc").mkdir()
    (layer / "etc/passwd").write_text(f"root:x:0:0::/root:/bin/sh\n{USER}:x:{UID}:{GID}::{HOME}:/bin/sh\n")
    (layer / "etc/group").write_text(f"root:x:0:\nusers:x:{GID}:\n")
    _own(layer / HOME.relative_to("/"))
    sources = layer / SOURCES.relative_to("/")
    for package in ("apel", "cluster", "jobs"):
        shutil.copytree(ROOT / package, sources / package, ignore=shutil.ignore_patterns("__pycache__"))
    _own(sources)


def _own(folder: Path) -> None:
    """Make it the user's, with all that is in it."""
    folder.mkdir(exist_ok=True)
    for path in (folder, *folder.rglob("*")):
        os.chown(path, UID, GID)


def _let_anyone_pass(root: Path) -> None:
    """Python may lie in a folder that is closed to others than root; in the image it is the user's."""
    for file in {sys.executable, sys.base_exec_prefix, str(Path(sys.executable).resolve())}:
        for parent in Path(file).parents:
            folder = root / parent.relative_to("/")
            folder.chmod(folder.stat().st_mode | 0o011)


def _run_line(beginning: str) -> str:
    (line,) = re.findall(rf"^RUN ({re.escape(beginning)}.*)$", _DOCKERFILE, flags=re.MULTILINE)
    return str(line)
