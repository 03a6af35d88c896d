"""A thousand runs of the main job as one submitted job: time and memory against a hundred.

``python -m benchmarks.thousand_runs``. Memory is the sum of what the processes of the cluster have for themselves.
"""

from __future__ import annotations

import json
import tempfile
import threading
from pathlib import Path
from typing import Any

import psutil

from jobs.results.manifest import versions
from tests.ray_head import Head, ray_head


class MemoryWatch:
    """Samples the unique memory of all processes of a cluster, by the folder of its session."""

    def __init__(self, head: Head) -> None:
        self._head = head
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._work)
        self.peak_bytes = 0

    def __enter__(self) -> MemoryWatch:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _work(self) -> None:
        while not self._over.wait(1.0):
            self.peak_bytes = max(self.peak_bytes, sum(map(_unique, self._head.processes())))


def _unique(process: psutil.Process) -> int:
    try:
        return int(process.memory_full_info().uss)
    except psutil.Error:
        return 0


def measure(head: Head, folder: Path, runs: int) -> dict[str, float]:
    """Seconds of the job, and the most memory that the cluster had meanwhile."""
    with MemoryWatch(head) as watch:
        words = ("submit", "distractor-maze", "--runs", str(runs), "--results", str(folder / str(runs)), "--follow")
        job = head.apel(*words, cwd=folder, timeout=3600).stdout.split()[0]
    status: dict[str, Any] = json.loads(head.apel("status", job, "--json", cwd=folder).stdout)
    if status["state"] != "done":
        message = f"the job of {runs} runs ended as {status['state']}"
        raise RuntimeError(message)
    phases = status["progress"]["phases"]
    return {"runs": runs, "seconds": phases["ended"], "playing": phases["ended"] - phases["planned"],
            "peak_bytes": watch.peak_bytes}  # fmt: skip


def main() -> None:
    """Print and store both, and their ratios."""
    with tempfile.TemporaryDirectory() as name, ray_head() as head:
        found = [measure(head, Path(name), runs) for runs in (100, 1000)]
    for one in found:
        print(f"{one['runs']:5.0f} runs: {one['seconds']:7.1f} s, at most {one['peak_bytes'] / 1e6:,.0f} MB")
    small, large = found
    ratios = [large[name] / small[name] for name in ("seconds", "peak_bytes")]
    print(f"time × {ratios[0]:.2f}, memory × {ratios[1]:.2f}")
    stored = {"versions": versions(), "measured": found}
    Path("benchmarks/results/thousand_runs.json").write_text(json.dumps(stored, indent=2) + "\n")


if __name__ == "__main__":
    main()
