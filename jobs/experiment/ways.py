"""How an experiment will be played: which of its environments by their tables, which learners compiled, and why not."""

from __future__ import annotations

from apel.building import way_of_learning
from apel.environments import World, close_environments, way_of_play
from cluster.learner_host import make_run_world
from jobs.experiment.plan import Plan
from jobs.experiment.run_plans import run_plan

_MAX_ENVIRONMENTS = 20
"""That are looked at, where variables or a sweep make many of them."""


def ways_of(plan: Plan) -> list[str]:
    """A line for every environment and learner of a plan that can be built, as its first run has them; where sweep
    points differ, a line for each way.
    """
    worlds: dict[str, World] = {}
    try:
        return _lines(plan, worlds)
    finally:
        close_environments([world.environment for world in worlds.values()])


def _lines(plan: Plan, worlds: dict[str, World]) -> list[str]:
    lines: dict[str, None] = {}
    for arm_point in plan.arm_points:
        run = run_plan(arm_point, 0, plan.seeds[0])
        key = repr(run.environment)
        if key not in worlds:
            if len(worlds) == _MAX_ENVIRONMENTS:
                break
            worlds[key] = make_run_world(run)
        lines[f"environment {run.environment.name}: {way_of_play(worlds[key])}"] = None
        for name, config in zip(arm_point.spec.learner_names, run.learners, strict=True):
            lines[f"learner {name}: {way_of_learning(config, worlds[key])}"] = None
    return sorted(lines)  # environments first
