"""Whether an experiment can be gone on with exactly after an interruption."""

from __future__ import annotations

import warnings
from functools import partial

from apel.environments.probe import why_not_exact
from cluster.learner_host import make_run_world
from jobs.experiment.plan import Plan
from jobs.experiment.run_plans import run_plan

_MAX_ENVIRONMENTS = 5


def resumption_notes(plan: Plan) -> list[str]:
    """What people should know of the environments of a plan: those that carry something from one episode to the next
    that no checkpoint holds.
    """
    notes: dict[str, str | None] = {}
    for arm_point in plan.arm_points:
        run = run_plan(arm_point, 0, plan.seeds[0])
        key = repr(run.environment)
        if key in notes:
            continue
        if len(notes) == _MAX_ENVIRONMENTS:
            break
        with warnings.catch_warnings(action="ignore"):
            found = why_not_exact(partial(make_run_world, run))
        notes[key] = found and f"{run.environment.name}: {found}. Until then an interrupted shard starts over."
    return list(dict.fromkeys(note for note in notes.values() if note))
