"""How fast deep learners are, beside others': ``python -m benchmarks.deep_engine``.

Environment steps with training per second of processor time, on one core: of this project alone and side by side, of
stable-baselines3, of code in one file in the manner of CleanRL, of rejax (JAX) where ``--rejax`` names a Python that
has it, and of an earlier version of this project where ``--before`` names a checkout of it. Each is measured from after
the first updates on, in a process of its own, one after the other and several times over, and told as medians and
ratios; processor time, so that other work beside moves the figures little and the ratios less. Then where the time
goes, and the arithmetic beside a bare product of the same sizes. Written to benchmarks/results/.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PYTORCH = {"network": {"activation": "relu", "initialisation": "pytorch"}}
LEARNERS: dict[str, tuple[str, dict[str, Any]]] = {
    "DQN 64-64": ("dqn", {**PYTORCH, "dueling": False, "head_hidden": []}),
    "DQN dueling 256": ("dqn", PYTORCH),
    "ACER 256": ("acer", {}),
    "SAC 64-64": ("sac", {}),
}
RUNS = (1, 32)
PEERS = ("stable-baselines3", "single file", "rejax")
ENSEMBLES = {"apel/CartPole-v0": {}, "apel/Maze-v0": {"size": 5, "distractors": [3], "max_steps": 250}}


def measured(python: str, root: Path, module: str, *arguments: str) -> float:
    """Steps per second of processor time, as a process of its own says in its last line; NaN if it cannot."""
    variables = {"PYTHONPATH": str(root), "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    flags = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    # Not with this folder on the path, in which `statistics` would be another module than Python's.
    command = [python, "-P", str(Path(__file__).with_name(module)), *arguments]
    environment = {**os.environ, **variables, "XLA_FLAGS": flags}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, cwd=root)
    try:
        return float(done.stdout.split()[-1])
    except (IndexError, ValueError):
        print(f"{arguments}: {done.stderr.strip().splitlines()[-1:]}", file=sys.stderr)
        return float("nan")


def cases(before: Path | None, rejax: str | None) -> dict[str, tuple[str, Path, str, tuple[str, ...]]]:
    """What is measured, by name."""
    found: dict[str, tuple[str, Path, str, tuple[str, ...]]] = {}
    for version, root in (("now", ROOT), ("before", before)):
        if root is None:
            continue
        for name, (learner, options) in LEARNERS.items():
            for runs in RUNS:
                arguments = "bank", learner, json.dumps(options), str(runs)
                found[f"{name}, {runs}, {version}"] = sys.executable, root, "deep_rates.py", arguments
        for environment, options in ENSEMBLES.items():
            arguments = "ensemble", environment, json.dumps(options), "10"
            found[f"Q + DQN + ACER, {environment}, {version}"] = sys.executable, root, "deep_rates.py", arguments
    for peer in PEERS:
        python = rejax if peer == "rejax" else sys.executable
        for name in list(LEARNERS)[: 1 if peer == "rejax" else 2]:
            if python is not None:
                found[f"{name}, {peer}"] = python, ROOT, "deep_rates.py", (peer, name)
    return found


def ratios(rates: dict[str, float]) -> dict[str, float]:
    """Of this version to each of the others."""
    found = {}
    for name, rate in rates.items():
        if not name.endswith(", now"):
            continue
        subject, _, runs = name.removesuffix(", now").rpartition(", ")
        others = {"before": rates.get(name.replace(", now", ", before"))}
        others |= {peer: rates.get(f"{subject}, {peer}") for peer in PEERS}
        for other, theirs in others.items():
            if theirs:
                found[f"{subject}, {runs} / {other}"] = round(rate / theirs, 2)
    return found


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--rejax")
    parser.add_argument("--only", default="")
    arguments = parser.parse_args()
    rates: dict[str, list[float]] = {}
    for repeat in range(arguments.repeats):
        for name, case in cases(arguments.before, arguments.rejax).items():
            # The ensembles of before take minutes: once is enough.
            is_slow = name.startswith("Q + DQN") and name.endswith("before")
            if arguments.only in name and not (is_slow and repeat):
                python, root, module, rest = case
                rates.setdefault(name, []).append(measured(python, root, module, *rest))
    medians = {name: round(statistics.median(values), 1) for name, values in rates.items()}
    from benchmarks.deep_parts import parts
    from jobs.results.manifest import versions

    record = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {"cores": os.cpu_count(), "processor": platform.processor() or platform.machine()},
        "versions": versions(),
        "repeats": arguments.repeats,
        "steps_per_processor_second": medians,
        "ratios": ratios(medians),
        "parts": parts(),
    }
    print(json.dumps({name: record[name] for name in ("steps_per_processor_second", "ratios", "parts")}, indent=2))
    path = Path(__file__).parent / "results" / "deep_engine.json"
    path.write_text(json.dumps(record, indent=2) + "\n")


if __name__ == "__main__":
    main()
