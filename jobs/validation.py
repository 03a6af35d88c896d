"""Try everything that an experiment names before any process is started for it."""

from __future__ import annotations

from collections.abc import Collection

from apel.book import open_book
from apel.building import make_bank, make_performance, make_selector
from apel.environments import World
from apel.seeding import run_seeds
from cluster.learner_host import make_run_world
from cluster.shard import ArmPlan, RunPlan
from jobs.plan import SweepPoint, arm_plan, run_plan, sweep_points
from jobs.spec import Experiment
from jobs.yaml_source import SpecError


def check(experiment: Experiment, arms: Collection[str] | None = None) -> None:
    """Build the first run of every arm and sweep point, and throw it away.

    Raises
    ------
    SpecError
        If something cannot be built; the message names the field.
    """
    for name in arms or ():
        if name not in experiment.arms:
            message = f"--arms: found {name!r}, expected some of {', '.join(experiment.arms)}"
            raise SpecError(message)
    for point in sweep_points(experiment):
        for arm in point.experiment.arms:
            if arms is None or arm in arms:
                _check_arm(point, arm)


def _check_arm(point: SweepPoint, arm: str) -> None:
    seed = run_seeds(point.experiment.seed, 1)[0]
    prefix = f"[{point.label}] " if point.label else ""
    place = f"arms.{arm}"
    try:
        run = run_plan(point.experiment, arm, 0, seed)
        plan = arm_plan(point, arm)
        place = "environment"
        world = make_run_world(run)
        place = "performance"
        make_performance(plan.performance)
        for index, name in enumerate(point.experiment.arms[arm].learners):
            place = f"learners.{name}"
            _build_learner(run, world, index, plan)
        place = f"arms.{arm}.selector"
        selector = make_selector(plan.selector)
        selector.initial_state(len(run.learners), plan.num_episodes)
        place = "criterion"
        open_book(selector, len(run.learners), plan.num_episodes, plan.criterion, [seed], [world.info])
    except Exception as error:
        # Whatever a user's own class raises when it is made is bad input, and gets the same one line.
        kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
        message = f"{prefix}{place}: {kind}{error}"
        raise SpecError(message) from error


def _build_learner(run: RunPlan, world: World, index: int, plan: ArmPlan) -> None:
    performance = make_performance(plan.performance)
    make_bank([run.learners[index]], [world], [run.seed], index, performance, with_probability=False)
