"""What a GPU is worth to deep learners: ``python -m benchmarks.gpu --seconds 180``.

Needs PyTorch with CUDA, the extra minatar, and some cores. In this order: how far a GPU's numbers are from a
processor's, and from its own when it is asked otherwise for the same (`benchmarks.gpu_bits`); what the parts of an
update of the network for Atari take (`benchmarks.gpu_network`); steps with training per second
(`benchmarks.gpu_rates`), these two on one core of a CPU meanwhile, too; and whether jobs give the same rows
(`benchmarks.gpu_rows`). Each part is a process of its own with its share of the time, so that one that fails or hangs
costs no other. Written as it is found, a line of JSON each, and together to benchmarks/results/gpu.json, or to the
folder in ``--out``.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from jobs.results.manifest import versions

ROOT = Path(__file__).resolve().parents[1]
SHARES = {"bits": 0.2, "network": 0.2, "rates": 0.27, "rows": 0.33}
"""Of the time; what a part does not use, the next ones have."""
GRACE = 5.0
"""Seconds that a part has beyond what it was told, to load and to end."""


class Part:
    """A process that prints lines of JSON."""

    def __init__(self, name: str, arguments: Sequence[str]) -> None:
        self.name, self.found = name, list[dict[str, Any]]()
        threads = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        self._process = subprocess.Popen(
            [sys.executable, "-m", f"benchmarks.gpu_{name}", *arguments],
            env={**os.environ, **threads}, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        self._other_lines = list[str]()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in self._process.stdout or ():
            try:
                self.found.append(json.loads(line))
            except ValueError:
                self._other_lines.append(line.rstrip()[:300])
            else:
                print(line.rstrip(), flush=True)

    def end(self, seconds: float) -> list[dict[str, Any]]:
        """What it has found, after it has ended or has been made to."""
        code: int | None = None
        try:
            code = self._process.wait(max(seconds, 0.1))
        except subprocess.TimeoutExpired:
            self._process.kill()
        self._reader.join(2.0)
        if code != 0:
            told = {"part": self.name, "ended": code, "log": self._other_lines[-15:]}
            print(json.dumps(told), flush=True)
            return [*self.found, told]
        return self.found


def gpu() -> str:
    """Its name, memory and driver."""
    command = ["nvidia-smi", "--query-gpu=name,memory.total,driver_version", "--format=csv,noheader"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=30).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return "none"


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--seconds", type=float, default=180.0)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    parser.add_argument("--only", default=",".join(SHARES))
    chosen = parser.parse_args()
    until = time.perf_counter() + chosen.seconds
    record: dict[str, Any] = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {"gpu": gpu(), "cores": os.cpu_count()},
        "versions": versions(),
        "found": [],
    }
    print(json.dumps(record), flush=True)
    names = [name for name in SHARES if name in chosen.only.split(",")]
    # On cores that the GPU's process does not need.
    beside = {name: Part(name, ["cpu", str(0.4 * chosen.seconds)]) for name in ("network", "rates") if name in names}
    for i, name in enumerate(names):
        left = until - time.perf_counter()
        share = left * SHARES[name] / sum(SHARES[other] for other in names[i:])
        if name == "rows":
            record["found"] += [one for part in beside.values() for one in part.end(0.0)]
            beside = {}
        record["found"] += Part(name, [chosen.device, str(share - GRACE)]).end(share)
        chosen.out.mkdir(parents=True, exist_ok=True)
        (chosen.out / "gpu.json").write_text(json.dumps(record, indent=1) + "\n")
    record["found"] += [one for part in beside.values() for one in part.end(until - time.perf_counter())]
    (chosen.out / "gpu.json").write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
