"""Hosts on a machine: each with its own root, network, processes and shared memory, all on one bridge."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from tests.hosts.compose import HealthCheck, Service
from tests.hosts.image import SOURCES, as_user, build, mounted
from tests.hosts.machine import INIT, NETWORK, Machine, first_of

_ENTER = Path(__file__).with_name("enter.sh")
_INIT = str(SOURCES / "init.py")


class Host:
    """One host; what it has written stays when it ends, as a container's files do."""

    def __init__(self, machine: Machine, name: str, number: int, service: Service, root: Path, log: Path) -> None:
        self.name, self.address = name, f"{NETWORK}.{number}"
        self._machine, self._number, self._service = machine, number, service
        self._root, self._log = root, log
        self._starts = itertools.count(1)
        self._cable = ""
        self._process: subprocess.Popen[bytes] | None = None
        self._pid = 0

    def start(self) -> None:
        """Start its command; also once it has ended."""
        self.kill()
        command = as_user(self._service.environment, self._service.num_files, "python", _INIT, *self._service.command)
        unshare = ["unshare", "--mount", "--net", "--pid", "--uts", "--ipc", "--fork", "--kill-child"]
        enter = ["sh", str(_ENTER), str(self._root), self.name, self._service.shm_size, *command]
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                self._machine.inside(*unshare, *enter), stdin=subprocess.PIPE, stdout=log, stderr=log
            )
        self._pid = first_of(self._process, "sh")
        self._connect()
        assert self._process.stdin
        self._process.stdin.write(b"\n")
        self._process.stdin.close()

    def _connect(self) -> None:
        self._cable = f"{self.name}.{next(self._starts)}"
        address = f"02:42:0a:59:00:{self._number:02x}"  # the same as ever, as Docker has it
        self._machine.ip(f"link add {self._cable} type veth peer name eth0 address {address} netns {self._pid}")
        self._machine.ip(f"link set {self._cable} master bridge up")
        for words in (
            "link set lo up", f"addr add {self.address}/24 dev eth0", "link set eth0 up",
            f"route add default via {NETWORK}.1",
        ):  # fmt: skip
            subprocess.run(["nsenter", f"--target={self._pid}", "--net", "ip", *words.split()], check=True)

    def lose(self) -> None:
        """It loses its power: nobody is told, not even by its connections."""
        self._machine.ip(f"link set {self._cable} down")
        self.kill()

    def kill(self) -> None:
        """Kill all its processes at once; the connections are closed."""
        if self._process is None:
            return
        if self._process.poll() is None:
            os.kill(self._pid, signal.SIGKILL)
        self._process.wait(timeout=60)

    def stop(self) -> float:
        """Ask it to end, as ``docker stop`` does; the seconds that it took, which may be no more than it is given."""
        assert self._process
        began = time.monotonic()
        os.kill(self._pid, signal.SIGTERM)
        self._process.wait(timeout=self._service.grace)
        return time.monotonic() - began

    def has_ended(self) -> bool:
        """Whether its command is over."""
        return self._process is None or self._process.poll() is not None

    def run(
        self, *command: str, env: Mapping[str, str] | None = None, check: bool = True, timeout: float = 400.0
    ) -> subprocess.CompletedProcess[str]:
        """Run a command in it, as its user and with its environment, as ``docker exec`` does."""
        variables = {**self._service.environment, **(env or {})}
        inside = ["nsenter", f"--target={self._pid}", "--mount", "--net", "--pid", "--uts", "--ipc", "--"]
        words = [*inside, *as_user(variables, self._service.num_files, *command)]
        run = subprocess.run(words, capture_output=True, text=True, check=False, timeout=timeout)
        assert not check or run.returncode == 0, f"{self.name}: {command}: {run.returncode}\n{run.stdout}{run.stderr}"
        return run

    def is_well(self) -> bool:
        """What its health check says now."""
        health = self._health
        return not self.has_ended() and self.run(*health.command, check=False, timeout=60).returncode == 0

    def wait_until_well(self) -> float:
        """Ask until it is well; the seconds that it took.

        The compose file has patience with hosts that have cores to themselves; here they have three times as long.

        What ends before is started again, once: on a busy machine Ray may give up its start.
        """
        began, restarts = time.monotonic(), 0
        while not self.is_well():
            if self.has_ended():
                assert not restarts, f"{self.name} has ended:\n{self.said()}"
                self.start()
                began, restarts = time.monotonic(), restarts + 1
            waited = time.monotonic() - began
            assert waited < 3 * self._health.patience, f"{self.name} is not well after {waited:.0f} s:\n{self.said()}"
            time.sleep(1.0)
        return time.monotonic() - began

    @property
    def _health(self) -> HealthCheck:
        assert self._service.health
        return self._service.health

    def listening(self) -> list[str]:
        """Its listening TCP sockets, one a line, with the processes that have them."""
        command = ["nsenter", f"--target={self._pid}", "--net", "--", "ss", "-tlnpH"]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()

    def path(self, path: Path | str) -> Path:
        """Where a file of its own is to be found from outside."""
        return self._machine.path(self._root) / str(path).lstrip("/")

    def said(self) -> str:
        """What its command has printed."""
        return self._log.read_text(errors="replace")


@contextmanager
def hosts(machine: Machine, services: Mapping[str, Service], logs: Path, token: str) -> Iterator[dict[str, Host]]:
    """Hosts of these names, none of which has started yet."""
    layer = build(machine)
    machine.path(layer / _INIT.lstrip("/")).write_text(INIT.read_text())
    numbers = dict(zip(services, itertools.count(2), strict=False))
    with ExitStack() as stack:
        found = {}
        for name, service in services.items():
            root = mounted(machine, name, machine.disk / name, (layer, Path("/")))
            found[name] = Host(machine, name, numbers[name], service, root, logs / f"{name}.log")
            _write_own_files(found[name], numbers, service, token)
            stack.callback(found[name].kill)
        yield found


def _write_own_files(host: Host, numbers: Mapping[str, int], service: Service, token: str) -> None:
    """What differs from the image: the names of all hosts, and the secrets."""
    names = [f"{NETWORK}.{number} {name}" for name, number in numbers.items()]
    host.path("etc/hosts").write_text("\n".join(["127.0.0.1 localhost", "::1 localhost", *names, ""]))
    # Ray asks the name servers in any case, and one that does not answer would keep the workers from joining.
    host.path("etc/resolv.conf").write_text("")
    host.path("etc/hostname").write_text(f"{host.name}\n")
    for secret, mode in service.secrets.items():
        file = host.path(f"run/secrets/{secret}")
        file.parent.mkdir(exist_ok=True)
        file.write_text(token)
        file.chmod(mode)
