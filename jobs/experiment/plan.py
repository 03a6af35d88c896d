"""What an experiment comes to: made once, before anything has an effect, and passed along to all who work on it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from apel.numerics.near_names import did_you_mean
from apel.numerics.seeding import run_seeds
from cluster.shard import Shard
from jobs.experiment.run_plans import arm_plan, run_plan
from jobs.experiment.spec import Experiment
from jobs.experiment.sweep import ArmPoint, arm_points
from jobs.experiment.yaml_source import SpecError

RunKey = tuple[str, str, int]
"""Arm, sweep label, run index."""
Runs = tuple[int, int]
"""The first and the last of a number of runs."""
_MAX_SHARD_SIZE = 100


@dataclass(frozen=True)
class Plan:
    """All runs of an experiment: arms × sweep points × seeds; see `Plan.of`.

    Attributes
    ----------
    arm_points:
        Every arm at every sweep point that concerns it, in the order of the file.
    seeds:
        Of each run; the same at every arm and sweep point.

    >>> from jobs.experiment.spec_files import load_experiment
    >>> plan = Plan.of(load_experiment("distractor-maze", ["runs=3"]))
    >>> plan.seeds, plan.num_episodes, len(list(plan.run_keys()))
    ((1892932127, 501869158, 32175636), 60000, 12)
    """

    experiment: Experiment
    arm_points: tuple[ArmPoint, ...]
    seeds: tuple[int, ...]

    @classmethod
    def of(cls, experiment: Experiment) -> Plan:
        """The plan of all arms.

        Raises
        ------
        SpecError
            If a combination of swept values is not a valid experiment.
        """
        return cls(experiment, arm_points(experiment), tuple(run_seeds(experiment.seed, experiment.runs)))

    def only(self, arms: Collection[str] | None) -> Plan:
        """The plan of some arms; None: of all.

        Raises
        ------
        SpecError
            If there is none of such a name.
        """
        if arms is None:
            return self
        for name in arms:
            if name not in self.experiment.arms:
                arms = self.experiment.arms
                message = f"--arms: found {name!r}, expected some of {', '.join(arms)}{did_you_mean(name, arms)}"
                raise SpecError(message)
        return replace(self, arm_points=tuple(one for one in self.arm_points if one.arm in arms))

    @property
    def num_episodes(self) -> int:
        """Episodes of all runs, each up to its cap."""
        return len(self.seeds) * sum(one.point.experiment.episodes for one in self.arm_points)

    @property
    def num_learner_episodes(self) -> int:
        """The same, an episode of an arm of several learners counted once for each: what a job costs, roughly."""
        return len(self.seeds) * sum(one.point.experiment.episodes * one.num_learners for one in self.arm_points)

    @property
    def selectors(self) -> set[str]:
        """The types of all selectors; that of a learner alone is ``fixed``."""
        return {"fixed", *(one.spec.selector.type for one in self.arm_points if one.spec.selector)}

    @property
    def compiled_parts(self) -> set[str]:
        """The types of all selectors, and of all learners that go by a name: what may have to be compiled."""
        named = {
            learner.type
            for one in self.arm_points
            for name, learner in one.point.experiment.learners.items()
            if name in one.spec.learners and isinstance(learner.type, str)
        }
        return self.selectors | named

    def run_keys(self) -> Iterator[RunKey]:
        """Every run."""
        for one in self.arm_points:
            for index in range(len(self.seeds)):
                yield one.arm, one.point.label, index

    def shards(
        self,
        *,
        num_cpus: int,
        shard_size: int | None = None,
        finished: Collection[RunKey] = (),
        begun: Callable[[str, str], Iterable[Runs]] = lambda _arm, _sweep: (),
    ) -> list[Shard]:
        """The shards of all runs that are not ``finished``: those of the arms with most learners first.

        Runs are cut at multiples of the shard size; without one see `default_shard_size`. Those of an arm at a sweep
        point that were ``begun`` together, and of which none is finished, stay together whatever the size is now, so
        that an interrupted job goes on from its checkpoints also with more runs, or on another machine.
        """
        shards, identity = [], self.experiment.identity
        num_ensembles = sum(one.num_learners > 1 for one in self.arm_points)
        for one in self.arm_points:
            size = shard_size or default_shard_size(len(self.seeds), num_cpus, one.num_learners, num_ensembles)
            missing = [i for i in range(len(self.seeds)) if (one.arm, one.point.label, i) not in finished]
            shared = replace(arm_plan(one), identity=identity)
            for group in _cut(missing, size, begun(one.arm, one.point.label)):
                shards.append(Shard(shared, tuple(run_plan(one, index, self.seeds[index]) for index in group)))
        return sorted(shards, key=lambda shard: -len(shard.arm.learner_names))


def _cut(missing: Sequence[int], size: int, begun: Iterable[Runs]) -> Iterator[list[int]]:
    """Groups of runs, in order: those that were begun together, and the others at multiples of a size.

    >>> list(_cut([0, 1, 2, 3, 4, 6, 7], 3, [(1, 2), (4, 6)]))
    [[0], [1, 2], [3, 4], [6, 7]]
    """
    group_of = {index: (index // size, -1) for index in missing}
    for first, last in sorted(begun):
        together = range(first, last + 1)
        if all(group_of.get(index, (0, 0))[1] < 0 for index in together):
            group_of |= dict.fromkeys(together, (first, first))
    for _, group in itertools.groupby(missing, key=group_of.__getitem__):
        yield list(group)


def default_shard_size(num_runs: int, num_cpus: int, num_learners: int, num_ensembles: int) -> int:
    """How many runs to play side by side; at most 100.

    The runs of an ensemble share the cost of its messages, so its shards are as large as can be with one for every
    CPU. A learner alone sends none: its shards are small, and fill up the CPUs towards the end of the job.
    """
    shards_per_arm = -(-num_cpus // num_ensembles) if num_learners > 1 else 2 * num_cpus
    return min(max(-(-num_runs // shards_per_arm), 1), _MAX_SHARD_SIZE)
