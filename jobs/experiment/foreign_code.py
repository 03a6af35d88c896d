"""Which code that is not shipped an experiment names: what reading it may not run, as whoever wrote it may be anybody.

Shipped are the parts by their registry keys, and environments by the Gymnasium id under which an installed package has
registered them. Everything else that a file can name is an import path, ``module:Name``: it stands for a selector, a
learner, an environment or a performance measure, or somewhere in their options, as stable-baselines3's algorithms do.
"""

from __future__ import annotations

from collections.abc import Iterator

from apel.building.registry import LEARNERS, METRICS, SELECTORS, foreign_option, foreign_part
from jobs.experiment.spec import Experiment
from jobs.experiment.sweep import arm_points


def foreign_code(experiment: Experiment) -> list[str]:
    """``field: 'module:Name'`` of everything that an experiment names and that is not shipped, at any sweep point.

    >>> from jobs.experiment.spec_files import load_experiment
    >>> foreign_code(load_experiment("distractor-maze"))
    []
    >>> foreign_code(load_experiment("distractor-maze", ["performance=os:getcwd"]))
    ["performance: 'os:getcwd'"]
    """
    found: dict[str, None] = {}
    for one in arm_points(experiment):
        found |= dict.fromkeys(_named(one.point.experiment))
    return list(found)


def _named(experiment: Experiment) -> Iterator[str]:
    yield from foreign_part("environment.id", experiment.environment.id, ())
    yield from foreign_option("environment.options", experiment.environment.options)
    yield from foreign_part("performance", experiment.performance, METRICS)
    yield from foreign_option("variables", experiment.variables)
    for name, learner in experiment.learners.items():
        yield from foreign_part(f"learners.{name}.type", learner.type, LEARNERS)
        yield from foreign_option(f"learners.{name}", learner.options)
        yield from foreign_option(f"learners.{name}.representation", learner.representation)
    for name, arm in experiment.arms.items():
        if arm.selector is not None:
            yield from foreign_part(f"arms.{name}.selector.type", arm.selector.type, SELECTORS)
            yield from foreign_option(f"arms.{name}.selector", arm.selector.options)
