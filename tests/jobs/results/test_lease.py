"""One job at a time computes into the same results, whatever dies, pauses, or asks at the same moment."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from jobs.experiment.spec_files import load_experiment
from jobs.results.lease import BusyError, Lease, Owner, Timing, is_gone, lease, this_owner
from jobs.results.storage import Folder
from jobs.runner import Settings, run_experiment

FAST = Timing(renew_seconds=0.05, dead_seconds=0.4, look_seconds=0.02)
# Where nobody is dead, and nobody may be taken for it because a thread had to wait for a CPU.
PATIENT = replace(FAST, dead_seconds=60.0)
ELSEWHERE = Owner("another machine", 7, "123", "job-1")


def no_wait(message: str) -> None:
    """Nothing should have to wait."""
    pytest.fail(message)


def write_lease(folder: Folder, name: str, state: str, count: int, owner: Owner = ELSEWHERE) -> None:
    """A lease as another job writes it."""
    content = {"state": state, "count": count, "since": "2026-01-01T00:00:00+00:00", "owner": asdict(owner)}
    folder.write(f"claims/{name}.json", json.dumps(content).encode())


def test_held_by_this_process(tmp_path: Path) -> None:
    """Results that are held are refused, with who holds them; released ones are free at once, and no lease is left."""
    folder = Folder(str(tmp_path))
    me = this_owner("job-9")
    with (
        lease(folder, me, no_wait, FAST),
        pytest.raises(BusyError, match=rf"job job-9, process {me.process} on .* expected none at work on them"),
        lease(folder, me, no_wait, FAST),
    ):
        pass
    with lease(folder, me, no_wait, FAST) as held:
        assert not held.is_lost
    assert folder.names("claims") == []


def test_lease_of_a_dead_process_of_this_machine(tmp_path: Path) -> None:
    """A process that was killed on this machine holds nothing: nobody has to wait for it."""
    program = (
        "import sys, os; from jobs.results.storage import Folder; from jobs.results.lease import *; "
        "l = lease(Folder(sys.argv[1]), this_owner(), print); l.__enter__(); os._exit(9)"
    )
    subprocess.run([sys.executable, "-c", program, str(tmp_path)], check=False)
    folder = Folder(str(tmp_path))
    assert len(folder.names("claims")) == 1
    with lease(folder, this_owner(), no_wait, FAST):
        assert len(folder.names("claims")) == 1


def test_process_numbers_that_come_again(tmp_path: Path) -> None:
    """A process is told from a later one of the same number; of another machine's nothing is known."""
    me = this_owner()
    assert not is_gone(me, me)
    assert is_gone(replace(me, started="1"), me)
    assert not is_gone(replace(me, started="1", machine="another"), me)
    assert not is_gone(replace(me, started=""), me)


def test_half_written_leases(tmp_path: Path) -> None:
    """What a dead job was writing of its lease goes with the lease; what another one is writing now stays."""
    folder = Folder(str(tmp_path))
    write_lease(folder, "0", "holding", 5, replace(this_owner(), started="1"))
    (tmp_path / "claims" / ".0.json.0123abcd.tmp").touch()
    (tmp_path / "claims" / ".1.json.0123abcd.tmp").touch()
    with lease(folder, this_owner(), no_wait, FAST):
        assert folder.temporary_names() == ["claims/.1.json.0123abcd.tmp"]


@pytest.mark.parametrize("state", ["holding", "wanting"])
def test_silent_lease_of_another_machine(tmp_path: Path, state: str) -> None:
    """A lease that gives no sign of life is waited out by this process's own watch, said once, and taken away."""
    folder = Folder(str(tmp_path))
    write_lease(folder, "0", state, 5)
    said: list[str] = []
    began = time.monotonic()
    with lease(folder, this_owner(), said.append, FAST):
        assert time.monotonic() - began >= FAST.dead_seconds
        assert folder.names("claims") != ["0.json"]
        assert len(folder.names("claims")) == 1
    assert said == [
        "waiting up to 0 s to see whether job job-1, process 7 on another machine is still computing these results"
    ]


def test_living_lease_of_another_machine(tmp_path: Path) -> None:
    """A lease whose counter grows is alive, however wrong its clock is."""
    folder = Folder(str(tmp_path))
    write_lease(folder, "0", "holding", 1)
    over = threading.Event()

    def live() -> None:
        count = 1
        while not over.wait(0.1):
            count += 1
            write_lease(folder, "0", "holding", count)

    thread = threading.Thread(target=live)
    thread.start()
    try:
        with pytest.raises(BusyError, match="job job-1"), lease(folder, this_owner(), lambda _: None, PATIENT):
            pass
    finally:
        over.set()
        thread.join()
    assert folder.names("claims") == ["0.json"]


def test_many_at_once(tmp_path: Path) -> None:
    """Of many that ask at the same moment at most one holds at any time, and one gets through."""
    folder = Folder(str(tmp_path))
    holding, most, got = [0], [0], [0]
    lock = threading.Lock()
    start = threading.Barrier(8)

    def ask(number: int) -> None:
        # Machines of their own: nothing is known of each other but what the folder says.
        start.wait()
        try:
            with lease(folder, Owner(f"machine {number}", 1, "1", ""), lambda _: None, PATIENT):
                with lock:
                    holding[0] += 1
                    got[0] += 1
                    most[0] = max(most[0], holding[0])
                time.sleep(0.2)
                with lock:
                    holding[0] -= 1
        except BusyError:
            pass

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most[0] == 1
    assert got[0] >= 1
    assert folder.names("claims") == []


def test_taken_over_after_a_pause(tmp_path: Path) -> None:
    """A job that stood still for so long that another one took over learns of it, and stops writing."""
    folder = Folder(str(tmp_path))
    with ExitStack() as stack:
        held = stack.enter_context(lease(folder, this_owner(), no_wait, FAST))
        for name in folder.names("claims"):
            folder.delete(f"claims/{name}")
        deadline = time.monotonic() + 300
        while not held.is_lost and time.monotonic() < deadline:
            time.sleep(0.01)
        assert held.is_lost


def test_second_job_is_refused_and_harms_nothing(small: Path, tmp_path: Path) -> None:
    """A second job on the same results is refused before it touches anything, `--fresh` or not."""
    experiment = load_experiment(str(small))
    settings = Settings(results=str(tmp_path), placement="local")
    folder = Path(run_experiment(experiment, settings).store.folder.path())
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    with lease(Folder(str(folder)), this_owner(), no_wait), pytest.raises(BusyError):
        run_experiment(experiment, replace(settings, fresh=True))
    after: dict[Path, Any] = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert after == before


def test_job_that_lost_its_results_ends(small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Once its lease is taken a job ends with an error, and does not store what it has under way."""
    mine: list[Lease] = []

    @contextmanager
    def watched(*arguments: Any) -> Iterator[Lease]:
        with lease(*arguments, PATIENT) as held:
            mine.append(held)
            yield held

    def steal() -> bool:
        """Take the lease away, and wait until the job has noticed."""
        for path in tmp_path.rglob("claims/*.json"):
            path.unlink()
            deadline = time.monotonic() + 300
            while not mine[0].is_lost and time.monotonic() < deadline:
                time.sleep(0.01)
        return False

    monkeypatch.setattr("jobs.runner.lease", watched)
    experiment, settings = load_experiment(str(small)), Settings(results=str(tmp_path), placement="local")
    with pytest.raises(BusyError, match="another job has taken these results over"):
        run_experiment(experiment, settings, stopping=steal)
    assert mine[0].is_lost
    assert len(list(tmp_path.rglob("parts/*/*.parquet"))) < 3


FOREIGN: dict[str, Any] = {
    "a field more": {
        "state": "holding",
        "count": 3,
        "since": "x",
        "owner": {**asdict(ELSEWHERE), "pod": "9"},
        "more": 1,
    },
    "no owner": {"state": "holding", "count": 3},
    "an owner of another form": {"state": "holding", "count": 3, "since": "x", "owner": "somebody"},
    "nothing": {},
    "values of other types": {"state": 7, "count": [], "since": None, "owner": {"machine": 1, "process": "x"}},
}


@pytest.mark.parametrize("kind", FOREIGN)
def test_lease_of_another_form(tmp_path: Path, kind: str) -> None:
    """What another version, or somebody else, wrote is waited out like any lease, and told without what it lacks."""
    folder = Folder(str(tmp_path))
    folder.write("claims/0.json", json.dumps(FOREIGN[kind]).encode())
    for name, content in (("1", b""), ("2", b"[1]"), ("3", b"\xff"), ("4", b"[" * 100_000)):
        folder.write(f"claims/{name}.json", content)
    told: list[str] = []
    with lease(folder, this_owner(), told.append, FAST):
        assert "claims/0.json" not in [f"claims/{name}" for name in folder.names("claims")]
    assert len(told) == 1
    assert "to see whether " in told[0]
    assert "is still computing these results" in told[0]
