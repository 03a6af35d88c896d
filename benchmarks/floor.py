"""The floor: bare compiled kernels and selectors, one process per core, no Ray, no rows, no files."""

from __future__ import annotations

import multiprocessing
import time

import numpy as np

from apel.building import make_bank, make_selector
from apel.learners.base import StreakLimit
from apel.run.state import RUNNING, Book
from cluster.learner_host import make_run_world, open_shard_book
from cluster.shard import Shard
from jobs.experiment.plan import Plan
from jobs.experiment.spec import Experiment
from jobs.experiment.spec_files import load_experiment


def play_shard(shard: Shard) -> int:
    """Play all runs of a shard to their end; returns the number of environment steps."""
    worlds = [make_run_world(run) for run in shard.runs]
    seeds = [run.seed for run in shard.runs]
    selector = make_selector(shard.arm.selector)
    columns = list(zip(*(run.learners for run in shard.runs), strict=True))
    banks = [make_bank(column, worlds, seeds, i, "return", with_probability=False) for i, column in enumerate(columns)]
    book: Book = open_shard_book(shard, worlds, selector)
    limit = StreakLimit(200, 1_000_000)
    while np.any(book.status == RUNNING):
        learner, running = book.learner.copy(), book.status == RUNNING
        played = []
        for me, bank in enumerate(banks):
            runs = np.flatnonzero(running & (learner == me)).tolist()
            if runs:
                played.append((me, bank.play(runs, book, selector, me, limit, record=len(banks) > 1).batch))
        for me, batch in played:
            for other, bank in enumerate(banks):
                if other != me and batch is not None:
                    bank.learn(batch)
    return int(book.steps.sum())


def shards_of(experiment: Experiment, part: int, num_parts: int) -> list[Shard]:
    """Every ``num_parts``-th run of each arm."""
    shards = Plan.of(experiment).shards(num_cpus=1, shard_size=experiment.runs)
    return [Shard(shard.arm, shard.runs[part::num_parts]) for shard in shards]


def _work(part: int, num_parts: int, runs: int, ready: object, go: object, answers: object) -> None:
    experiment = load_experiment("distractor-maze", [f"runs={runs}"])
    for shard in shards_of(load_experiment("distractor-maze", ["runs=2", "episodes=20"]), part, num_parts):
        play_shard(shard)  # loads the compiled functions
    ready.wait()  # type: ignore[attr-defined]
    go.wait()  # type: ignore[attr-defined]
    began = time.perf_counter()
    times, steps = {}, {}
    for shard in shards_of(experiment, part, num_parts):
        start = time.perf_counter()
        steps[shard.arm.arm] = play_shard(shard)
        times[shard.arm.arm] = time.perf_counter() - start
    answers.put((time.perf_counter() - began, times, steps))  # type: ignore[attr-defined]


def measure(runs: int, num_processes: int) -> tuple[float, dict[str, float], dict[str, int]]:
    """Wall seconds of the main job, processor seconds per arm, and steps per arm; the processes' start apart."""
    context = multiprocessing.get_context("spawn")
    ready, go, answers = context.Barrier(num_processes + 1), context.Event(), context.Queue()
    workers = [
        context.Process(target=_work, args=(part, num_processes, runs, ready, go, answers))
        for part in range(num_processes)
    ]
    for worker in workers:
        worker.start()
    ready.wait()
    go.set()
    results = [answers.get() for _ in workers]
    for worker in workers:
        worker.join()
    arms = results[0][1]
    seconds = {arm: sum(times[arm] for _, times, _ in results) for arm in arms}
    steps = {arm: sum(counts[arm] for _, _, counts in results) for arm in arms}
    return max(wall for wall, _, _ in results), seconds, steps
