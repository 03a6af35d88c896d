"""Try everything that an experiment names before any process is started for it."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import replace

from apel.book import open_book
from apel.building import make_bank, make_performance, make_selector
from apel.configs import LearnerConfig
from apel.environments import World
from apel.seeding import run_seeds
from apel.selection import Selector, freezes_policies
from cluster.checkpoint import CheckpointError, pack, unpack
from cluster.learner_host import make_run_world
from cluster.shard import ArmPlan, RunPlan
from jobs.plan import SweepPoint, arm_plan, arm_points, draw_variables, run_plan
from jobs.plots import check_against_runs
from jobs.spec import Experiment
from jobs.yaml_source import SpecError

_GPU = re.compile(r"cuda(:\d+)?")
_MAX_RUNS_LOOKED_AT, _MAX_RUNS_BUILT = 1000, 20


def check(experiment: Experiment, arms: Collection[str] | None = None) -> None:
    """Build a run of every arm and sweep point, and throw it away.

    Where runs differ by the variables drawn for them, a run of each kind is built.

    Raises
    ------
    SpecError
        If something cannot be built; the message names the field.
    """
    for name in arms or ():
        if name not in experiment.arms:
            message = f"--arms: found {name!r}, expected some of {', '.join(experiment.arms)}"
            raise SpecError(message)
    _check_hindsight(experiment)
    _check_plots(experiment)
    for point, arm in arm_points(experiment, arms):
        for index, seed in _distinct_runs(point.experiment):
            _check_run(point, arm, index, seed)


def _check_hindsight(experiment: Experiment) -> None:
    """Arms of which the best is taken must be played at the same sweep points."""
    labels: dict[str, list[str]] = {}
    for point, arm in arm_points(experiment, None):
        labels.setdefault(arm, []).append(point.label)
    for name, sources in experiment.hindsight.items():
        if any(labels[source] != labels[sources[0]] for source in sources):
            found = ", ".join(f"{source} at {len(labels[source])}" for source in sources)
            place = experiment.where("hindsight", name)
            message = f"{place}: found {found} sweep points, expected arms that are played at the same ones"
            raise SpecError(message)


def _check_plots(experiment: Experiment) -> None:
    """Figures that need what an experiment does not record would be missed when all is played."""
    learners = {arm: spec.learner_names for arm, spec in experiment.arms.items()}
    try:
        check_against_runs(experiment.plots, learners, records_all=experiment.record == "all")
    except ValueError as error:
        message = f"{experiment.where('plots')}{str(error).removeprefix('plots')}"
        raise SpecError(message) from error


def _distinct_runs(experiment: Experiment) -> list[tuple[int, int]]:
    """Index and seed of the first run of each combination of variables, a bounded number of them."""
    seeds = run_seeds(experiment.seed, experiment.runs)
    kinds: dict[str, tuple[int, int]] = {}
    for index, seed in enumerate(seeds[:_MAX_RUNS_LOOKED_AT]):
        kinds.setdefault(repr(draw_variables(experiment, seed)), (index, seed))
    return list(kinds.values())[:_MAX_RUNS_BUILT]


def _check_run(point: SweepPoint, arm: str, index: int, seed: int) -> None:
    experiment = point.experiment
    place: tuple[str, ...] = ("arms", arm)
    try:
        run = run_plan(experiment, arm, index, seed)
        plan = arm_plan(point, arm)
        place = ("environment",)
        world = make_run_world(run)
        place = ("performance",)
        make_performance(plan.performance)
        place = ("arms", arm, "selector")
        selector = make_selector(plan.selector)
        for position, name in enumerate(experiment.arms[arm].learner_names):
            place = ("learners", name)
            _build_learner(run, world, position, plan, selector)
        place = ("arms", arm, "selector")
        selector.initial_state(len(run.learners), plan.num_episodes)
        place = ("criterion",)
        open_book(selector, len(run.learners), plan.num_episodes, plan.criterion, [seed], [world.info])
    except Exception as error:
        # Whatever a user's own class raises when it is made is bad input, and gets the same one line.
        kind = "" if isinstance(error, ValueError | CheckpointError) else f"{type(error).__name__}: "
        message = f"{experiment.where(*place)}: {kind}{error}"
        raise SpecError(message) from error


def _on_cpu(config: LearnerConfig) -> LearnerConfig:
    """The learner and its members without their GPUs, which the machine that submits a job need not have."""
    options = dict(config.options)
    if _GPU.fullmatch(str(options.get("device", ""))):
        options["device"] = "cpu"
    return replace(config, options=options, members=tuple(map(_on_cpu, config.members)))


def _build_learner(run: RunPlan, world: World, index: int, plan: ArmPlan, selector: Selector) -> None:
    bank = make_bank(
        [_on_cpu(run.learners[index])],
        [world],
        [run.seed],
        index,
        make_performance(plan.performance),
        with_probability=False,
        freezes=freezes_policies(selector),
        evaluates=plan.criterion is not None and plan.criterion.evaluation == "greedy",
    )
    # As a checkpoint does, which otherwise would find out half a minute after everything had begun.
    bank.restore(unpack(pack(bank.state())))
