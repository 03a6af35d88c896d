"""The judgements: from facts to findings, without effects."""

from __future__ import annotations

from jobs.doctor.facts import Answer, Facts, Finding, Gpus, Machine, Token, Versions

_GIB = 2**30
_LEAST_MEMORY, _LEAST_SHARED = 2 * _GIB, 200 * 2**20
_OLDEST, _NEWEST = (3, 11), (3, 13)
_SHOWN = 5


def findings(facts: Facts) -> list[Finding]:
    """Everything that was looked at, in the order in which it matters."""
    return [
        python(facts.machine),
        requirements(facts.versions),
        constraints(facts.versions),
        extras(facts.versions),
        cores(facts.machine),
        memory(facts.machine),
        shared_memory(facts.machine),
        ray(facts.ray),
        gpu(facts.gpus),
        cache(facts),
        storage(facts.storage),
        cluster(facts.cluster),
        token(facts.token, facts.cluster),
    ]


def python(machine: Machine) -> Finding:
    """Versions with which the tests pass."""
    found = f"Python {'.'.join(map(str, machine.python))} on {machine.system}"
    if machine.python[:2] < _OLDEST:
        return Finding("Python", "problem", found, "install Python 3.11 or newer")
    if machine.python[:2] > _NEWEST:
        return Finding("Python", "note", found, "newer than what was tested: 3.11 to 3.13")
    if machine.system != "Linux":
        return Finding("Python", "note", found, "tested on Linux alone")
    return Finding("Python", "fine", found)


def requirements(versions: Versions) -> Finding:
    """What this program says that it needs."""
    found = f"apel {versions.ours}"
    if not versions.unmet:
        return Finding("packages", "fine", f"{found} with all that it needs")
    wrong = [f"{wanted} (found {there or 'none'})" for wanted, there in versions.unmet.items()]
    return Finding("packages", "problem", f"{found} without {_some(wrong)}", "pip install --upgrade 'apel[service]'")


def constraints(versions: Versions) -> Finding:
    """The versions with which the documented numbers were measured."""
    if versions.pinned is None:
        return Finding("constraints", "fine", "no constraints.txt here to compare with")
    if not versions.pinned:
        return Finding("constraints", "fine", "versions as in constraints.txt")
    other = [f"{name} {there} instead of {pinned}" for name, (pinned, there) in versions.pinned.items()]
    advice = "pip install -c constraints.txt -e '.[dev]' for the versions that were tested"
    return Finding("constraints", "note", _some(other), advice)


def extras(versions: Versions) -> Finding:
    """What could be installed besides; nobody needs all of it."""
    there = [name for name, complete in versions.extras.items() if complete]
    missing = ", ".join(name for name, complete in versions.extras.items() if not complete)
    found = (", ".join(there) or "none") + (f"; not installed: {missing}" if missing else "")
    return Finding("extras", "fine", found)


def cores(machine: Machine) -> Finding:
    """Cores that may be used."""
    if machine.cores == 1:
        return Finding("cores", "note", "1", "--placement packed, or local without Ray, costs less with a single core")
    return Finding("cores", "fine", str(machine.cores))


def memory(machine: Machine) -> Finding:
    """Memory, which Ray and an actor per learner and core want."""
    if machine.memory is None:
        return Finding("memory", "note", "unknown", "Ray wants 2 GB and more")
    found = f"{machine.memory / _GIB:.1f} GB"
    if machine.memory < _LEAST_MEMORY:
        return Finding("memory", "note", found, "Ray wants 2 GB and more: --placement local does without it")
    return Finding("memory", "fine", found)


def shared_memory(machine: Machine) -> Finding:
    """Where Ray keeps its object store; with too little of it, it takes the disk."""
    if machine.shared_memory is None:
        return Finding("/dev/shm", "note", "none", "Ray puts its objects on the disk")
    found = f"{machine.shared_memory / _GIB:.1f} GB free"
    if machine.shared_memory < _LEAST_SHARED:
        return Finding("/dev/shm", "note", found, "Ray puts its objects on the disk: docker run --shm-size=1g")
    return Finding("/dev/shm", "fine", found)


def ray(error: str) -> Finding:
    """Whether Ray can be had."""
    if error:
        advice = "pip install 'apel[service]'; until then --placement local"
        return Finding("Ray", "problem", f"cannot be imported: {error}", advice)
    return Finding("Ray", "fine", "can be imported")


def gpu(gpus: Gpus) -> Finding:
    """Whether PyTorch uses the cards that are there."""
    if not gpus.seen and not gpus.usable:
        return Finding("GPU", "fine", "none; tables and the networks compiled for the CPU do not need one")
    found = f"{gpus.seen or gpus.usable} seen"
    if gpus.torch is None:
        return Finding("GPU", "note", f"{found}, no PyTorch", "pip install 'apel[deep]' to use it")
    if not gpus.usable:
        advice = "install a build of PyTorch for this GPU's driver: https://pytorch.org/get-started"
        return Finding("GPU", "note", f"{found}, of which PyTorch {gpus.torch} can use none", advice)
    return Finding("GPU", "fine", f"{gpus.usable}, PyTorch {gpus.torch}")


def cache(facts: Facts) -> Finding:
    """Where compiled code is kept."""
    if facts.cache is None:
        advice = "set NUMBA_CACHE_DIR to a folder that can be written to"
        return Finding("compiled code", "problem", "no folder to keep it: every process compiles for minutes", advice)
    return Finding("compiled code", "fine", str(facts.cache))


def storage(answer: Answer) -> Finding:
    """Whether results can be written."""
    if answer.error:
        advice = "name another place with --results, or see to its rights and credentials"
        return Finding("results", "problem", f"{answer.place}: {answer.error}", advice)
    return Finding("results", "fine", answer.place)


def cluster(answer: Answer) -> Finding:
    """Whether a dashboard answers; nobody needs one who names none."""
    if not answer.error:
        return Finding("cluster", "fine", answer.place)
    if not answer.asked:
        return Finding("cluster", "fine", f"none at {answer.place}; apel run starts a Ray of its own")
    return Finding("cluster", "problem", answer.error, "start it, open a tunnel to it, or name it with --address")


def token(found: Token, cluster: Answer) -> Finding:
    """Whether Ray has a token to show, and keeps it to itself."""
    if found.mode == "disabled":
        return Finding("token", "note", "RAY_AUTH_MODE=disabled", "anyone who reaches the cluster can run code on it")
    if not found.source:
        if found.mode == "token":
            advice = "put the cluster's token into RAY_AUTH_TOKEN, or into ~/.ray/auth_token"
            return Finding("token", "problem", "RAY_AUTH_MODE=token, but no token is set", advice)
        if cluster.asked and not cluster.error:
            return Finding("token", "note", "none, and the cluster asks for none", "fence it in: docs/security.md")
        return Finding("token", "fine", "none")
    if found.readable_by_others:
        return Finding("token", "problem", f"{found.source} can be read by others", f"chmod 600 {found.source}")
    return Finding("token", "fine", f"from {found.source}")


def _some(texts: list[str]) -> str:
    more = f" and {len(texts) - _SHOWN} more" if len(texts) > _SHOWN else ""
    return ", ".join(texts[:_SHOWN]) + more
