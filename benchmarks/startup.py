"""From ``apel submit`` to the first episode: where the seconds go. ``python -m benchmarks.startup [repetitions]``.

A real head on this machine, a user's command in another process. The clock of all parts is this machine's.
"""

from __future__ import annotations

import json
import statistics
import sys
import tempfile
import time
from datetime import datetime
from pathlib import Path
from typing import Any

from jobs.results.manifest import versions
from tests.ray_head import Head, ray_head

PARTS = (
    ("apel submit: read, check, send", "sent"),
    ("Ray starts the job's process", "process"),
    ("it reads and checks the experiment, joins Ray", "joined"),
    ("results are claimed, the plan is made", "planned"),
    ("actors start; the first episodes are played", "first_episode"),
)


def measure(head: Head, folder: Path, number: int) -> dict[str, float]:
    """Seconds that each part takes."""
    began = time.time()
    words = ("submit", "distractor-maze", "--runs", "100", "--results", str(folder / f"results-{number}"))
    job = head.apel(*words, cwd=folder).stdout.split()[0]
    sent = time.time() - began
    while True:
        status: dict[str, Any] = json.loads(head.apel("status", job, "--json", cwd=folder).stdout)
        if "first_episode" in ((status["progress"] or {}).get("phases", {})):
            break
        time.sleep(0.2)
    head.apel("stop", job, cwd=folder)
    progress = status["progress"]
    process = datetime.fromisoformat(progress["since"]).timestamp() - began
    marks = {"sent": sent, "process": process}
    marks |= {name: process + progress["phases"][name] for name in ("joined", "planned", "first_episode")}
    seconds, before = {}, 0.0
    for _, name in PARTS:
        seconds[name], before = marks[name] - before, marks[name]
    return {**seconds, "all": before}


def main() -> None:
    """Print and store the medians."""
    repetitions = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    with tempfile.TemporaryDirectory() as name, ray_head() as head:
        found = [measure(head, Path(name), number) for number in range(repetitions)]
    medians = {part: statistics.median(one[part] for one in found) for part in found[0]}
    for words, part in (*PARTS, ("from the command to the first episode", "all")):
        low, high = min(one[part] for one in found), max(one[part] for one in found)
        print(f"{words:50} {medians[part]:6.2f} s  ({low:.2f} to {high:.2f})")
    stored = {"versions": versions(), "repetitions": repetitions, "seconds": medians, "all": found}
    Path("benchmarks/results/startup.json").write_text(json.dumps(stored, indent=2) + "\n")


if __name__ == "__main__":
    main()
