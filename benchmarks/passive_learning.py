"""Ensembles whose learners spoil each other, and remedies: ``python -m benchmarks.passive_learning [SPEC]``.

Plays the arms of an experiment file (by default ``benchmarks/selectors/passive.yaml``) in processes of their own,
without Ray, some runs at a time, and writes a line of JSON for each run as it ends: its train time, and of every tenth
of its environment steps the number of episodes that each learner played, and the sum of their returns. ``--table``
prints what they come to. A run follows from its seed alone, so it does not matter where, or in which order, runs are
played; those that are there already are not played again.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from apel.run.state import EpisodeRows
from cluster.compiling import Nowhere, compile_for
from cluster.local import run_shards
from cluster.protocols import NO_RUN_ROWS, RunRows
from cluster.shard import Execution, Shard
from jobs.experiment.plan import Plan
from jobs.experiment.spec_files import load_experiment
from jobs.experiment.validation import check

SPEC = "benchmarks/selectors/passive.yaml"
RESULTS = Path("benchmarks/results/passive_learning.jsonl")
TENTHS = 10


def main() -> None:
    """Play, or print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("spec", nargs="?", default=SPEC)
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--arms", help="Some of them, with commas between.")
    parser.add_argument("--set", action="append", default=[], metavar="PATH=VALUE")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--shard", type=int, default=2, help="Runs that are played side by side.")
    parser.add_argument("--seconds", type=float, default=np.inf, help="After these whatever is not done is dropped.")
    parser.add_argument("--table", action="store_true")
    given = parser.parse_args()
    if given.table:
        print("\n".join(table(read(given.out))))
        return
    end = time.monotonic() + given.seconds
    plan = Plan.of(load_experiment(given.spec, given.set)).only(given.arms.split(",") if given.arms else None)
    check(plan)
    compile_for(plan.compiled_parts)
    done = {(one["arm"], one["sweep"], one["run"]) for one in read(given.out)}
    shards = plan.shards(num_cpus=given.processes, shard_size=given.shard, finished=done)
    # First the first runs of everything: what is done when the time is up is then of use.
    play(sorted(shards, key=_order), given.processes, end, given.out)


def _order(shard: Shard) -> tuple[int, int]:
    return shard.runs[0].index, len(shard.arm.learner_names)


def play(shards: Sequence[Shard], processes: int, end: float, out: Path) -> None:
    """Play shards until all are done, or the time is up."""
    out.parent.mkdir(parents=True, exist_ok=True)
    pool = ProcessPoolExecutor(processes, multiprocessing.get_context("spawn"))
    waiting = [pool.submit(played, shard) for shard in shards]
    try:
        with out.open("a") as file:
            for done in as_completed(waiting, timeout=max(0.0, end - time.monotonic()) if end < np.inf else None):
                file.write("".join(json.dumps(one) + "\n" for one in done.result()))
                file.flush()
    except TimeoutError:
        print(f"{sum(one.done() for one in waiting)} of {len(waiting)} shards were done in time")
        for process in list(pool._processes.values()):
            process.kill()
    pool.shutdown(cancel_futures=True)


@dataclass
class _InMemory(Nowhere):
    """Takes a shard's rows, and has no checkpoint."""

    runs: RunRows = NO_RUN_ROWS
    rows: list[EpisodeRows] = field(default_factory=list)
    parts: dict[int, list[EpisodeRows]] = field(default_factory=dict)

    def spill(self, _: Shard, part: int, rows: Sequence[EpisodeRows]) -> str:
        self.parts[part] = list(rows)
        return str(part)

    def commit(self, _: Shard, runs: RunRows, parts: Sequence[str], rows: Sequence[EpisodeRows]) -> None:
        self.runs = runs
        self.rows = [one for part in parts for one in self.parts[int(part)]] + list(rows)


def played(shard: Shard) -> list[dict[str, Any]]:
    """What each run of a shard comes to."""
    sink, began = _InMemory(), time.process_time()
    for _ in run_shards([shard], sink, sink, Execution(checkpoint_seconds=np.inf, raises=True)):
        pass
    took = time.process_time() - began
    rows = EpisodeRows(*(np.concatenate(column) for column in zip(*sink.rows, strict=True)))
    names = shard.arm.learner_names
    return [
        {
            "arm": shard.arm.arm,
            "sweep": shard.arm.sweep,
            **shard.arm.sweep_values,
            "run": run.index,
            "seed": run.seed,
            "learners": list(names),
            "train_time": int(sink.runs.train_time[at]),
            "censored": bool(sink.runs.censored[at]),
            **tenths(rows, position, len(names), shard.arm.num_steps),
            "cpu_seconds": round(took / len(shard.runs), 1),
        }
        for at, position in enumerate(sink.runs.position.tolist())
        for run in [shard.runs[position]]
    ]


def tenths(rows: EpisodeRows, position: int, num_learners: int, steps: int | None) -> dict[str, Any]:
    """Episodes ``[10][learners]``, their returns, summed, and their steps, by the tenth in which they end."""
    of_run = np.flatnonzero(rows.run == position)
    of_run = of_run[np.argsort(rows.episode[of_run], kind="stable")]
    length, selected = rows.length[of_run], rows.selected[of_run]
    ends = np.cumsum(length)
    tenth = np.minimum(TENTHS * (ends - 1) // (steps or ends[-1]), TENTHS - 1)
    count, total, made = (np.zeros((TENTHS, num_learners)) for _ in range(3))
    np.add.at(count, (tenth, selected), 1)
    np.add.at(total, (tenth, selected), rows.episode_return[of_run])
    np.add.at(made, (tenth, selected), length)
    return {"episodes": count.astype(int).tolist(), "returns": total.tolist(), "steps": made.astype(int).tolist()}


def read(path: Path) -> list[dict[str, Any]]:
    """All lines."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def table(runs: Sequence[dict[str, Any]]) -> list[str]:
    """A row for each arm at each sweep point, the best ensembles first: means over the runs. The worse half is relative
    to the best learner alone in it.
    """
    points: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for one in runs:
        points.setdefault((one["arm"], one["sweep"]), []).append(one)
    halves = {point: _halves(ones) for point, ones in points.items()}
    alone = np.array([halves[point] for point, ones in points.items() if len(ones[0]["learners"]) == 1]).max(axis=0)
    worse = {point: (both / alone).min() for point, both in halves.items()}
    header = (
        "arm",
        "",
        "runs",
        "first half",
        "second half",
        "worse half",
        "last tenth",
        "by the last learner",
        "its own",
    )
    lines = ["| " + " | ".join(header) + " |", "|---" * len(header) + "|"]
    for point in sorted(points, key=lambda point: -worse[point]):
        ones = points[point]
        count, total = (np.array([one[name] for one in ones])[:, -1] for name in ("episodes", "returns"))
        own = total[:, -1].sum() / max(count[:, -1].sum(), 1)
        numbers = [*halves[point], worse[point], (total.sum(1) / count.sum(1)).mean()]
        share = (count[:, -1] / count.sum(1)).mean()
        cells = [*point, str(len(ones)), *(f"{number:.2f}" for number in numbers), f"{share:.0%}", f"{own:.2f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _halves(ones: Sequence[dict[str, Any]]) -> np.ndarray:
    """Mean return of the episodes of each half, mean over the runs."""
    count, total = (np.array([one[name] for one in ones]).sum(axis=2) for name in ("episodes", "returns"))
    half = TENTHS // 2
    parts = (slice(half), slice(half, None))
    return np.array([(total[:, part].sum(1) / count[:, part].sum(1)).mean() for part in parts])


if __name__ == "__main__":
    main()
