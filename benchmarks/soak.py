"""A job on three nodes that is disturbed at random moments, a hundred times and more.

Actors, coordinators, nodes and drivers are killed, and the storage fails. Every row must be that of an undisturbed job,
value for value; what is told is the time that faults cost. ``python -m benchmarks.soak --faults 100 --seed 1`` writes
it to benchmarks/results/ and ends with exit code 1 if anything is not as it should be.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from jobs.results.manifest import versions
from tests.soak.soak import Plan, Result, soak

RUNS_PER_FAULT, EPISODES, ROUND_SECONDS = 0.5, 600, 0.01


def record_of(plan: Plan, result: Result) -> dict[str, Any]:
    """What is written."""
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {"cores": os.cpu_count(), "processor": platform.processor() or platform.machine()},
        "versions": versions(),
        "seed": plan.seed,
        "runs_per_arm": plan.runs,
        "episodes": plan.episodes,
        "round_seconds": plan.round_seconds,
        **result.as_json(),
    }


def show(result: Result) -> None:
    """Print the table."""
    print(f"\n{'':26s} {'job, seconds':>16s} {'a shard, seconds':>18s}")
    print(f"{'fault':20s} {'count':>5s} {'median':>9s} {'max':>6s} {'median':>11s} {'max':>6s}")
    for kind, numbers in result.kinds().items():
        keys = ("median_lost", "max_lost", "median_waited", "max_waited")
        lost, most_lost, waited, most_waited = (f"{numbers[key]:.1f}" if key in numbers else "-" for key in keys)
        print(f"{kind:20s} {numbers['count']:5.0f} {lost:>9s} {most_lost:>6s} {waited:>11s} {most_waited:>6s}")
    sessions = f"{result.num_sessions} sessions, {result.num_restarts} shards begun again"
    print(f"\n{sessions}, in {result.disturbed_seconds:.0f} s")
    if (seconds := result.seconds_per_fault()) is not None:
        print(f"undisturbed {result.undisturbed_seconds:.0f} s: {seconds:.1f} s longer per fault")
    print(
        f"{result.temporary_files} temporary files and {result.unfinished_uploads} unfinished uploads before tidying up"
    )
    rows = f"{result.num_runs} runs and {result.num_episodes} episodes"
    print(f"{rows}: as undisturbed, value for value" if not result.problems else rows)
    for problem in result.problems:
        print(f"problem: {problem}")


def main() -> None:
    """Disturb, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--faults", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--runs", type=int, help="of each arm; default: in proportion to the faults")
    parser.add_argument("--episodes", type=int, default=EPISODES)
    parser.add_argument("--round-seconds", type=float, default=ROUND_SECONDS, help="the least that a round takes")
    parser.add_argument("--no-baseline", action="store_true", help="do not take the time of an undisturbed job")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "results" / "soak.json")
    parser.add_argument("--logs", type=Path, help="a folder for what the drivers write")
    arguments = parser.parse_args()
    if arguments.episodes <= arguments.faults:
        parser.error(f"--episodes: found {arguments.episodes}, expected more than the {arguments.faults} faults")
    runs = arguments.runs or max(6, round(RUNS_PER_FAULT * arguments.faults))
    plan = Plan(
        arguments.faults,
        arguments.seed,
        runs,
        arguments.episodes,
        arguments.round_seconds,
        baseline=not arguments.no_baseline,
    )
    result = soak(plan, lambda line: print(line, flush=True), arguments.logs)
    show(result)
    arguments.output.parent.mkdir(exist_ok=True)
    arguments.output.write_text(json.dumps(record_of(plan, result), indent=2) + "\n")
    print(arguments.output)
    if result.problems:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
