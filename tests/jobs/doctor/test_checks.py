"""Every judgement of ``apel doctor``, on facts that are made up."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from jobs.doctor import checks
from jobs.doctor.facts import Answer, Facts, Gpus, Machine, Token, Versions

MACHINE = Machine("Linux", (3, 12, 1), cores=4, memory=8 * 2**30, shared_memory=4 * 2**30)
VERSIONS = Versions("0.2.0", {}, {}, {"deep": True, "sb3": False})
HERE, AWAY = Answer("http://127.0.0.1:8265"), Answer("http://127.0.0.1:8265", "could not reach a dashboard")
TOKEN = Token("token", "RAY_AUTH_TOKEN")
FACTS = Facts(MACHINE, VERSIONS, "", Gpus(), Path("/cache"), Answer("results"), HERE, TOKEN)


def test_all_is_well() -> None:
    """Every subject once, and nothing to do."""
    found = checks.findings(FACTS)
    assert {one.state for one in found} == {"fine"}
    assert not any(one.advice for one in found)
    assert len({one.subject for one in found}) == len(found) == 13


@pytest.mark.parametrize(
    ("machine", "subject", "state", "said"),
    [
        ({"python": (3, 10, 9)}, "Python", "problem", "3.11 or newer"),
        ({"python": (3, 14, 0)}, "Python", "note", "3.11 to 3.13"),
        ({"system": "Darwin"}, "Python", "note", "Linux alone"),
        ({"cores": 1}, "cores", "note", "--placement packed"),
        ({"memory": 2**30}, "memory", "note", "--placement local"),
        ({"memory": None}, "memory", "note", "2 GB"),
        ({"shared_memory": 64 * 2**20}, "/dev/shm", "note", "--shm-size"),
        ({"shared_memory": None}, "/dev/shm", "note", "on the disk"),
    ],
)
def test_machine(machine: dict[str, object], subject: str, state: str, said: str) -> None:
    """What a machine lacks is said with what to do, and nothing else is found wrong for it."""
    found = checks.findings(replace(FACTS, machine=replace(MACHINE, **machine)))  # type: ignore[arg-type]
    (wrong,) = [one for one in found if one.state != "fine"]
    assert (wrong.subject, wrong.state) == (subject, state)
    assert said in wrong.advice


def test_versions() -> None:
    """Requirements must be met; pins are those of the documented numbers; extras are nobody's duty."""
    unmet = replace(VERSIONS, unmet={"ray>=2.54": "2.40.0", "pandas>=2": None})
    found = checks.requirements(unmet)
    assert found.state == "problem"
    assert "ray>=2.54 (found 2.40.0), pandas>=2 (found none)" in found.found
    assert "apel[service]" in found.advice
    other = checks.constraints(replace(VERSIONS, pinned={f"p{i}": ("1.0", "2.0") for i in range(7)}))
    assert other.state == "note"
    assert "p0 2.0 instead of 1.0" in other.found
    assert other.found.endswith("and 2 more")
    assert checks.constraints(replace(VERSIONS, pinned=None)).state == "fine"
    assert checks.extras(VERSIONS).found == "deep; not installed: sb3"
    assert checks.extras(replace(VERSIONS, extras={})).found == "none"


def test_ray() -> None:
    """Without Ray one can still play here."""
    found = checks.ray("ImportError: no such file")
    assert found.state == "problem"
    assert "no such file" in found.found
    assert "--placement local" in found.advice


@pytest.mark.parametrize(
    ("gpus", "state", "said"),
    [
        (Gpus(0, "2.13.0+cpu", 0), "fine", "none"),
        (Gpus(2, "2.13.0", 2), "fine", "2, PyTorch 2.13.0"),
        (Gpus(1, None, 0), "note", "no PyTorch"),
        (Gpus(1, "2.13.0+cpu", 0), "note", "can use none"),
    ],
)
def test_gpu(gpus: Gpus, state: str, said: str) -> None:
    """A card that PyTorch does not use is told of; that there is none is no fault."""
    found = checks.gpu(gpus)
    assert found.state == state
    assert said in found.found


def test_cache_and_storage() -> None:
    """Where nothing can be written, all takes minutes, or is lost."""
    assert "NUMBA_CACHE_DIR" in checks.cache(replace(FACTS, cache=None)).advice
    found = checks.storage(Answer("s3://bucket/results", "access denied"))
    assert (found.state, found.found) == ("problem", "s3://bucket/results: access denied")


def test_cluster() -> None:
    """A cluster that was named must answer; that nobody started one is no fault."""
    assert checks.cluster(HERE).state == "fine"
    assert checks.cluster(AWAY).state == "problem"
    assert checks.cluster(replace(AWAY, asked=False)).state == "fine"


@pytest.mark.parametrize(
    ("token", "cluster", "state"),
    [
        (TOKEN, HERE, "fine"),
        (Token("token", "/home/me/.ray/auth_token", readable_by_others=True), HERE, "problem"),
        (Token("token"), HERE, "problem"),
        (Token("disabled"), HERE, "note"),
        (Token(), HERE, "note"),
        (Token(), AWAY, "fine"),
        (Token(), replace(HERE, asked=False), "fine"),
    ],
)
def test_token(token: Token, cluster: Answer, state: str) -> None:
    """A token is to be there where it is asked for, and to be nobody else's."""
    found = checks.token(token, cluster)
    assert found.state == state
    assert bool(found.advice) == (state != "fine")
