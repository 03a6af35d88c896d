"""``apel run --debug``: play runs in this process until one fails, and leave a debugger where it did."""

from __future__ import annotations

import pdb
from collections.abc import Iterator
from contextlib import suppress

import typer

from apel.run.user_code import culprit_of, in_a_line, is_interruption, trace_of
from cluster.compiling import compile_for, not_compiled
from cluster.run_replay import play_run
from cluster.shard import Shard
from jobs.cli.consoles import OUT, print_error
from jobs.experiment.plan import Plan
from jobs.experiment.spec import Experiment
from jobs.experiment.validation import check
from jobs.precautions import refuse_shadowing
from jobs.results.failures import failed_runs
from jobs.results.store import ResultStore
from jobs.runner import Settings


def debug(experiment: Experiment, settings: Settings) -> None:
    """Play the runs that failed the last time, then those that are missing; nothing is stored.

    Raises
    ------
    typer.Exit
        With code 1, after a run has failed and the debugger was left.
    """
    plan = Plan.of(experiment)
    refuse_shadowing()
    check(plan, settings.arms)
    if not_compiled(plan.compiled_parts):
        compile_for(plan.compiled_parts)
    for shard in _runs(plan, settings):
        run = shard.runs[0]
        OUT.print(f"{shard.label} (seed {run.seed})", highlight=False, markup=False)
        try:
            failures = play_run(shard.arm, run)
        except BaseException as error:
            if is_interruption(error):
                raise
            _stop_at(culprit_of(error), f"{shard.label} (seed {run.seed})")
            raise typer.Exit(1) from None
        for failure in failures:
            print_error(f"{shard.label} (seed {run.seed}), episode {failure.episode}: {failure.error}")
        if failures:
            raise typer.Exit(1)
    OUT.print("no run failed", highlight=False)


def _runs(plan: Plan, settings: Settings) -> Iterator[Shard]:
    store = ResultStore.of(plan.experiment, settings.results)
    wanted = plan.only(settings.arms)
    finished = set() if settings.fresh else store.finished(plan)
    shards = {
        (shard.arm.arm, shard.arm.sweep, shard.runs[0].index): shard
        for shard in wanted.shards(num_cpus=1, shard_size=1, finished=finished)
    }
    for key in failed_runs(store.folder):
        with suppress(KeyError):
            yield shards.pop(key)
    yield from shards.values()


def _stop_at(error: BaseException, where: str) -> None:
    for line in trace_of(error).splitlines():
        print_error(line)
    print_error(f"{where}: {in_a_line(error)}; here is Python's debugger: w shows where, p NAME a value, q leaves it")
    pdb.post_mortem(error.__traceback__)
