"""A machine within this one, with mounts, a network and processes of its own: nothing that it does is seen outside.

All that is started in it dies with its first process, which dies with the one that started it; its mounts and its
network go with the last of its processes.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

INIT = Path(__file__).with_name("init.py")
_TOOLS = ("ip", "mount", "nsenter", "pivot_root", "prlimit", "setpriv", "ss", "unshare")
_UNSHARE = ("unshare", "--mount", "--net", "--pid", "--fork", "--kill-child", "--mount-proc")
NETWORK = "10.89.0"


def why_not() -> str | None:
    """Why this machine cannot hold others, if so."""
    if sys.platform != "linux":
        return "namespaces are Linux's"
    if os.geteuid() != 0:
        return "namespaces with a network of their own need root"
    if missing := [tool for tool in _TOOLS if shutil.which(tool) is None]:
        return f"missing: {', '.join(missing)}"
    tried = subprocess.run([*_UNSHARE, "sh", "-c", _TRIAL], capture_output=True, text=True, check=False)
    return f"not allowed here: {tried.stderr.strip()}" if tried.returncode else None


_TRIAL = """
set -e
ip link add bridge type bridge
ip link add one type veth peer name other
mount -t tmpfs tmpfs /mnt
mkdir /mnt/upper /mnt/work /mnt/root
mount -t overlay overlay -o lowerdir=/,upperdir=/mnt/upper,workdir=/mnt/work /mnt/root
"""


@dataclass(frozen=True)
class Machine:
    """Its first process, as this machine numbers it, and a folder on a disk that only it sees."""

    pid: int
    disk: Path

    def inside(self, *words: str) -> list[str]:
        """The command that runs another one in there."""
        return ["nsenter", f"--target={self.pid}", "--mount", "--net", "--pid", "--", *words]

    def do(self, *words: str) -> str:
        """Run a command in there, which must succeed; what it prints."""
        return checked(self.inside(*words))

    def ip(self, words: str) -> None:
        """Change its network. Processes are named as this machine numbers them."""
        checked(["nsenter", f"--target={self.pid}", "--net", "--", "ip", *words.split()])

    def path(self, path: Path) -> Path:
        """Where a file of its own is to be found from outside."""
        return Path(f"/proc/{self.pid}/root{path}")


@contextmanager
def machine(folder: Path) -> Iterator[Machine]:
    """Start one with a bridge; in ``folder`` it has its disk, in memory."""
    folder.mkdir()
    command = ["setpriv", "--pdeathsig=KILL", *_UNSHARE, sys.executable, str(INIT), "sleep", "infinity"]
    with subprocess.Popen(command) as process:
        try:
            started = Machine(first_of(process, sys.executable), folder)
            started.do("mount", "-t", "tmpfs", "tmpfs", str(folder))
            started.ip("link set lo up")
            started.ip("link add bridge type bridge")
            started.ip(f"addr add {NETWORK}.1/24 dev bridge")
            started.ip("link set bridge up")
            yield started
        finally:
            process.kill()


def first_of(process: subprocess.Popen[Any], program: str) -> int:
    """The first process of the namespace that a command makes, once it runs ``program``."""
    while process.poll() is None:
        for child in psutil.Process(process.pid).children(recursive=True):
            with suppress(psutil.Error):
                if child.cmdline()[:1] == [program]:
                    return child.pid
        time.sleep(0.01)
    message = f"{process.args!r} ended with {process.returncode} before {program} had begun"
    raise AssertionError(message)


def checked(command: Sequence[str], timeout: float = 60.0) -> str:
    """Run a command that must succeed; what it prints."""
    run = subprocess.run(command, capture_output=True, text=True, check=False, timeout=timeout)
    assert run.returncode == 0, f"{' '.join(command)}: exit code {run.returncode}\n{run.stdout}{run.stderr}"
    return run.stdout
