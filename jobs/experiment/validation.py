"""Try everything that an experiment names before any process is started for it."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Sequence
from dataclasses import replace

from apel.building import make_bank, make_performance, make_selector
from apel.building.registry import LEARNERS
from apel.configs import LearnerConfig
from apel.environments import World
from apel.run.opening import check_floor, open_book
from apel.run.selection import Selector, freezes_policies
from apel.run.user_code import culprit_of, fault_of, in_a_line, place_of
from cluster.checkpoint import CheckpointError, pack, unpack
from cluster.shard import ArmPlan, RunPlan
from jobs.experiment.figures import check_against_runs
from jobs.experiment.names import shadows
from jobs.experiment.plan import Plan
from jobs.experiment.run_plans import OptionError, arm_plan, draw_variables, run_plan
from jobs.experiment.spec import Experiment
from jobs.experiment.sweep import ArmPoint
from jobs.experiment.trial import Trial
from jobs.experiment.yaml_source import SpecError

_GPU = re.compile(r"cuda(:\d+)?")
_MEMORIES = ("replay_size", "buffer_size")
"""Options of our learners that say how much they remember."""
_MEMORY_BUILT, _MAX_MEMORY = 100_000, 10_000_000
"""What is larger is built so large; but the largest are left as they are, to be refused."""
_MAX_DRAWS_LOOKED_AT, _MAX_RUNS_BUILT = 1000, 20


def check(plan: Plan, arms: Collection[str] | None = None) -> Trial:
    """Build what a run of every arm (of ``arms``; None: of all) and sweep point needs, and throw it away.

    Where runs differ by the variables drawn for them, a run of each kind is looked at. Of very many parts only some are
    built, see `Trial`.

    Raises
    ------
    SpecError
        If something cannot be built; the message names the field.
    """
    wanted = plan.only(arms)
    _check_hindsight(plan)
    _check_plots(plan.experiment)
    trial = Trial()
    played: set[str] = set()
    try:
        for arm_point, index, seed in _runs(wanted):
            if trial.has_time or arm_point.arm not in played:
                _check_run(trial, arm_point, index, seed)
            else:
                trial.num_left += 1
            played.add(arm_point.arm)
    finally:
        trial.close()
    return trial


def _runs(plan: Plan) -> list[tuple[ArmPoint, int, int]]:
    """Of every arm and sweep point a run of each kind: a first one of all of them before a second one of any."""
    kinds: dict[str, Sequence[tuple[int, int]]] = {}
    ranked = []
    for arm_point in plan.arm_points:
        experiment = arm_point.point.experiment
        key = repr(experiment.variables)
        if key not in kinds:
            kinds[key] = _distinct_runs(experiment, plan.seeds)
        ranked += [(rank, arm_point, index, seed) for rank, (index, seed) in enumerate(kinds[key])]
    return [one[1:] for one in sorted(ranked, key=lambda one: one[0])]


def _check_hindsight(plan: Plan) -> None:
    """Arms of which the best is taken must be played at the same sweep points."""
    labels: dict[str, list[str]] = {}
    for one in plan.arm_points:
        labels.setdefault(one.arm, []).append(one.point.label)
    for name, sources in plan.experiment.hindsight.items():
        if any(labels[source] != labels[sources[0]] for source in sources):
            found = ", ".join(f"{source} at {len(labels[source])}" for source in sources)
            place = plan.experiment.where("hindsight", name)
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


def _distinct_runs(experiment: Experiment, seeds: Sequence[int]) -> Sequence[tuple[int, int]]:
    """Index and seed of the first run of each combination of variables, a bounded number of them."""
    looked_at = max(_MAX_DRAWS_LOOKED_AT // max(len(experiment.variables), 1), _MAX_RUNS_BUILT)
    most = min(math.prod(len(values) for values in experiment.variables.values()), _MAX_RUNS_BUILT)
    kinds: dict[str, tuple[int, int]] = {}
    for index, seed in enumerate(seeds[:looked_at]):
        kinds.setdefault(repr(draw_variables(experiment, seed)), (index, seed))
        if len(kinds) == most:
            break
    return list(kinds.values())


def _check_run(trial: Trial, arm_point: ArmPoint, index: int, seed: int) -> None:
    experiment, arm = arm_point.point.experiment, arm_point.arm
    place: tuple[str, ...] = ("arms", arm)
    try:
        run, plan = run_plan(arm_point, index, seed), arm_plan(arm_point)
        place = ("environment",)
        world = trial.world(run)
        if world is None:
            return
        if shadowing := shadows(world.info, experiment.variables, arm_point.point.values):
            place = shadowing[0]
            message = "found the name of a number that the environment reports, expected another one"
            raise ValueError(message)
        place = ("performance",)
        make_performance(plan.performance)
        place = ("arms", arm, "selector")
        selector = make_selector(plan.selector)
        for position, name in enumerate(experiment.arms[arm].learner_names):
            place = ("learners", name)
            _try_learner(trial, run, world, position, plan, selector)
        place = ("arms", arm, "selector")
        _try_selector(trial, run, plan, selector)
        check_floor(plan.selector.acting_floor, len(run.learners), plan.num_steps)
        place = ("criterion",)
        _try_book(trial, run, world, plan, selector)
    except BaseException as error:
        # Whatever a user's own class raises when it is made, SystemExit too, is bad input, and gets the same one line.
        place = error.place if isinstance(error, OptionError) else place
        found = in_a_line(fault_of("", error))
        if isinstance(error, ValueError | CheckpointError):
            found = str(error)
        message = f"{experiment.where(*place)}: {found}{_in_user_code(error)}"
        raise SpecError(message) from error


def _in_user_code(error: BaseException) -> str:
    place = place_of(error) if culprit_of(error) is not error or not isinstance(error, ValueError) else ""
    return f" ({place})" if place else ""


def _try_learner(trial: Trial, run: RunPlan, world: World, position: int, plan: ArmPlan, selector: Selector) -> None:
    config, kind = run.learners[position], f"learner {run.learners[position].type}"
    evaluates = plan.criterion is not None and plan.criterion.evaluation == "greedy"
    if not trial.wants(kind, config, run.environment, plan.performance, freezes_policies(selector), evaluates):
        return
    with trial.building(kind):
        bank = make_bank(
            [_cheap(config)],
            [world],
            [run.seed],
            position,
            make_performance(plan.performance),
            with_probability=False,
            freezes=freezes_policies(selector),
            evaluates=evaluates,
        )
        # As a checkpoint does, which otherwise would find out half a minute after everything had begun.
        bank.restore(unpack(pack(bank.state())))


def _try_selector(trial: Trial, run: RunPlan, plan: ArmPlan, selector: Selector) -> None:
    kind = f"selector {plan.selector.type}"
    if trial.wants(kind, plan.selector, len(run.learners), plan.num_episodes):
        with trial.building(kind):
            selector.initial_state(len(run.learners), plan.num_episodes)


def _try_book(trial: Trial, run: RunPlan, world: World, plan: ArmPlan, selector: Selector) -> None:
    kind = f"criterion of {plan.selector.type}"
    criterion = plan.criterion and plan.criterion.of_run(run.variables)
    if trial.wants(kind, criterion, plan.selector, len(run.learners), plan.num_episodes, sorted(world.info)):
        with trial.building(kind):
            open_book(selector, len(run.learners), plan.num_episodes, criterion, [run.seed], [world.info])


def _cheap(config: LearnerConfig) -> LearnerConfig:
    """The learner and its members without their GPUs, which the machine that submits a job need not have, and without
    the room for experience that it will have when it plays.
    """
    if config.start is not None:
        return config  # whose memory has to fit
    options = dict(config.options)
    if _GPU.fullmatch(str(options.get("device", ""))):
        options["device"] = "cpu"
    for name in _MEMORIES if config.type in LEARNERS else ():
        if isinstance(options.get(name), int) and _MEMORY_BUILT < options[name] <= _MAX_MEMORY:
            options[name] = _MEMORY_BUILT
    return replace(config, options=options, members=tuple(map(_cheap, config.members)))
