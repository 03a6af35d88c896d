"""What the compose file says of the nodes, as data: commands, environment, health checks, limits."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[2]
_COMPOSE: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text())


@dataclass(frozen=True)
class HealthCheck:
    """How a host is asked whether it is well."""

    command: tuple[str, ...]
    patience: float
    """After so many seconds without an answer the compose file calls the host unhealthy."""


@dataclass(frozen=True)
class Service:
    """What runs on a host."""

    command: tuple[str, ...]
    environment: Mapping[str, str]
    shm_size: str = "64m"  # Docker's own
    num_files: int = 1024
    secrets: Mapping[str, int] = field(default_factory=dict)
    """Names with modes."""
    grace: float = 10.0
    """So many seconds after it was asked to end it is killed."""
    health: HealthCheck | None = None


def node(name: str, extra: Mapping[str, str]) -> Service:
    """A service of the compose file, with no variable set; ``extra`` is what an ``env_file`` would add."""
    found = _COMPOSE["services"][name]
    assert found["cap_drop"] == ["ALL"]
    assert found["init"] is True
    assert found["restart"] == "unless-stopped"
    assert found["security_opt"] == ["no-new-privileges:true"]
    return Service(
        command=tuple(_filled(word) for word in found["command"]),
        environment={**extra, **{key: _filled(value) for key, value in found["environment"].items()}},
        shm_size=found["shm_size"],
        num_files=found["ulimits"]["nofile"],
        secrets={secret["source"]: secret["mode"] for secret in found["secrets"]},
        grace=_seconds(found["stop_grace_period"]),
        health=_health(found["healthcheck"]),
    )


def named_ports(name: str) -> set[int]:
    """The TCP ports that a service's command and environment name."""
    service = node(name, {})
    said = re.findall(r"--[\w-]*port=(\d+)", " ".join(service.command))
    said += [value for key, value in service.environment.items() if key.endswith("_METRIC_PORT")]
    return {int(port) for port in said}


def _filled(text: object) -> str:
    return re.sub(r"\$\{\w+:-(.*?)\}", r"\1", str(text))


def _health(check: Mapping[str, Any]) -> HealthCheck:
    kind, *command = check["test"]
    assert kind == "CMD"
    patience = _seconds(check["start_period"]) + check["retries"] * _seconds(check["interval"])
    return HealthCheck(tuple(command), patience)


def _seconds(duration: str) -> float:
    assert duration.endswith("s")
    return float(duration.removesuffix("s"))
