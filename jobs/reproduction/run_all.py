"""All shipped experiments of a group, one after the other, on one cluster; what is finished is not played again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Literal

from jobs.experiment.plan import Plan
from jobs.experiment.spec import Experiment
from jobs.experiment.spec_files import Group, load_experiment, shipped_experiments
from jobs.progress.observers import Observer
from jobs.runner import Outcome, Settings, Stopping, run_planned

Scale = Literal["smoke", "tenth", "full"]
_SMOKE_RUNS = 2


def scaled(experiment: Experiment, scale: Scale) -> Experiment:
    """The experiment with all its runs, a tenth of them, or two; its rows are the same as far as they go."""
    runs = {"smoke": min(_SMOKE_RUNS, experiment.runs), "tenth": -(-experiment.runs // 10), "full": experiment.runs}
    return experiment.model_copy(update={"runs": runs[scale]})


def reproduced_plans(scale: Scale, group: Group) -> list[Plan]:
    """The plans of a group's shipped experiments, small ones first, so that most of them are there early."""
    plans = [Plan.of(scaled(load_experiment(name), scale)) for name in shipped_experiments(group)]
    return sorted(plans, key=lambda plan: plan.num_learner_episodes)


def reproduce(
    scale: Scale,
    group: Group,
    settings: Settings,
    observer_for: Callable[[Experiment], Observer],
    stopping: Stopping = lambda: False,
) -> Iterator[tuple[Experiment, Outcome]]:
    """Run every experiment of a group, or go on where an earlier call stopped; yields each with what came of it.

    Raises
    ------
    SpecError, StoreError, ClusterError
        See `jobs.runner.run_experiment`.
    """
    with _cluster(settings):
        for plan in reproduced_plans(scale, group):
            yield plan.experiment, run_planned(plan, settings, observer_for(plan.experiment), stopping)


@contextmanager
def _cluster(settings: Settings) -> Iterator[None]:
    """One Ray for all experiments: each of them stays with the one it finds."""
    if settings.placement == "local":
        yield
        return
    from cluster.launch import ray_cluster

    with ray_cluster(settings.address, settings.num_cpus, dashboard=settings.dashboard):
        yield
