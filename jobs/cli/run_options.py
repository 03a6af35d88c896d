"""The options that `run`, `submit` and `reproduce` share, each written once, and what they mean.

They mean settings of a job of this process, or words for the `apel run` that a submitted job consists of.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Annotated, get_args

import typer

from apel.numerics.near_names import did_you_mean
from cluster.shard import Execution
from jobs.analysis.answer import DEFAULT_ERROR
from jobs.cli.this_job import results_root
from jobs.experiment.spec import Experiment
from jobs.experiment.spec_files import load_experiment, shortcuts
from jobs.experiment.yaml_source import SpecError
from jobs.precautions import refuse_shadowing_beside
from jobs.progress.loggers import check_words, own_module
from jobs.remote.places import place_on_cluster, ray_address
from jobs.runner import Placement, Settings

Reference = Annotated[
    str, typer.Argument(metavar="SPEC|NAME", help="An experiment file, or the name of a shipped one.")
]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="Override any field of the spec.")
]


@dataclass(frozen=True)
class ExperimentOptions:
    """Which experiment: of `run` and `submit`."""

    spec: Reference
    runs: Annotated[int | None, typer.Option(help="Number of runs.")] = None
    seed: Annotated[int | None, typer.Option(help="Seed from which those of all runs are derived.")] = None
    overrides: Overrides = None

    def load(self, max_runs: int | None = None) -> Experiment:
        """The experiment, overrides included; see `jobs.experiment.spec_files.load_experiment`.

        Raises
        ------
        SpecError
            If there is no such experiment, or its number of runs is given twice.
        """
        if self.runs is not None and max_runs is not None:
            message = "--max-runs: found it beside --runs, expected one of them: how many runs there may be"
            raise SpecError(message)
        refuse_shadowing_beside(self.spec)
        runs = self.runs if max_runs is None else max_runs
        return load_experiment(self.spec, [*shortcuts(runs, self.seed), *(self.overrides or [])])


@dataclass(frozen=True)
class HereOptions:
    """Where a job of this process computes and writes: of `run` and `reproduce`.

    Raises
    ------
    SpecError
        If there can be no such address.
    """

    results: Annotated[
        str | None,
        typer.Option(envvar="APEL_RESULTS", help="Folder or URI for the results.", show_default="results"),
    ] = None
    address: Annotated[
        str | None, typer.Option(help="A Ray cluster: auto or HOST:PORT. Default: start one here; in a job, its own.")
    ] = None
    cpus: Annotated[int | None, typer.Option(min=1, max=10_000, help="CPUs of the Ray started here.")] = None

    def __post_init__(self) -> None:
        if self.address is not None:
            ray_address("--address", self.address)


@dataclass(frozen=True)
class RunOptions:
    """How to run: of `run`, and of `submit`, which hands them on to the `run` of the job.

    Raises
    ------
    SpecError
        If there is no such placement, no arm is named, a time is no number, or what goes with --until does not fit.
    """

    arms: Annotated[str | None, typer.Option(help="Only these arms, separated by commas.")] = None
    placement: Annotated[str, typer.Option(help="actors, packed or local.")] = Settings.placement
    shard_size: Annotated[int | None, typer.Option(min=1, help="Number of runs that one shard plays side by side.")] = (
        None
    )
    fresh: Annotated[bool, typer.Option("--fresh", help="Discard these results and start over.")] = False
    checkpoint_seconds: Annotated[
        float, typer.Option(min=0.0, help="Seconds between checkpoints, which take at most 5 % of the time.")
    ] = Execution.checkpoint_seconds
    checkpoint_episodes: Annotated[
        int | None, typer.Option(min=1, help="Also write a checkpoint after this many episodes of a shard.")
    ] = None
    log: Annotated[
        list[str] | None,
        typer.Option(
            metavar="LOGGER",
            help="Log returns, shares and more: tensorboard[:DIR], mlflow[:URI], wandb, or your own "
            "package.module:Observer. May be repeated.",
        ),
    ] = None
    until: Annotated[
        str | None, typer.Option(metavar="decided", help="Add runs in rounds until the best arm is decided.")
    ] = None
    max_runs: Annotated[
        int | None, typer.Option(min=1, help="With --until: at most this many runs. Default: --runs.")
    ] = None
    error: Annotated[
        float | None,
        typer.Option(help="With --until: probability of naming a wrong arm as the best.", show_default="0.05"),
    ] = None

    def __post_init__(self) -> None:
        if self.placement not in get_args(Placement):
            meant = did_you_mean(self.placement, get_args(Placement))
            message = f"--placement: found {self.placement!r}, expected actors, packed or local{meant}"
            raise SpecError(message)
        if not math.isfinite(self.checkpoint_seconds):
            message = f"--checkpoint-seconds: found {self.checkpoint_seconds}, expected a finite number"
            raise SpecError(message)
        if self.arms is not None and not all(self.arms.split(",")):
            message = f"--arms: found {self.arms!r}, expected names separated by commas"
            raise SpecError(message)
        check_words(self.log or [])
        self._check_until()

    def _check_until(self) -> None:
        if self.until is None:
            for option in ("max_runs", "error"):
                if getattr(self, option) is not None:
                    message = f"--{option.replace('_', '-')}: found it alone, expected it with --until decided"
                    raise SpecError(message)
        elif self.until != "decided":
            message = f"--until: found {self.until!r}, expected decided"
            raise SpecError(message)
        if self.error is not None and not 0.0001 <= self.error <= 0.5:
            message = f"--error: found {self.error}, expected a probability from 0.0001 to 0.5"
            raise SpecError(message)

    @property
    def chosen_arms(self) -> tuple[str, ...] | None:
        """Their names; None for all."""
        return tuple(self.arms.split(",")) if self.arms else None

    @property
    def chosen_error(self) -> float:
        """With which probability a wrong arm may be named."""
        return DEFAULT_ERROR if self.error is None else self.error

    def settings(self, here: HereOptions, job: str) -> Settings:
        """The settings of a job of this process, which may be the driver of the submitted one with the id ``job``.

        Raises
        ------
        SpecError
            If the place for the results holds a secret.
        """
        return Settings(
            results=results_root(here.results, job),
            arms=self.chosen_arms,
            placement=self.placement,  # type: ignore[arg-type]
            shard_size=self.shard_size,
            address=here.address or ("auto" if job else None),
            num_cpus=here.cpus,
            fresh=self.fresh,
            execution=Execution(
                checkpoint_seconds=self.checkpoint_seconds, checkpoint_episodes=self.checkpoint_episodes
            ),
            job=job,
            error=None if self.until is None else self.chosen_error,
        )

    def words(self) -> list[str]:
        """The same as words for `apel run`, on a cluster; what is as it would be anyway goes without saying.

        Raises
        ------
        SpecError
            If a logger would write to a place that only this machine knows.

        >>> RunOptions(arms="APEL", fresh=True, checkpoint_seconds=0.0).words()
        ['--arms', 'APEL', '--fresh', '--checkpoint-seconds', '0.0']
        """
        for log in self.log or []:
            _check_on_cluster(log)
        words = []
        for field in fields(self):
            option, value = f"--{field.name.replace('_', '-')}", getattr(self, field.name)
            if value is True:
                words.append(option)
            elif value != field.default:
                words += [
                    word for one in (value if isinstance(value, list) else [value]) for word in (option, str(one))
                ]
        return words

    @property
    def log_modules(self) -> list[str]:
        """The top-level modules of observers of one's own."""
        return [module for log in self.log or [] if (module := own_module(log)) is not None]


def _check_on_cluster(log: str) -> None:
    """See that a logger writes where every node understands it."""
    name, _, target = log.partition(":")
    if name == "tensorboard" and target:
        place_on_cluster("--log tensorboard", target)
    relative = target.removeprefix("sqlite:///")
    if name == "mlflow" and relative != target and not relative.startswith("/"):
        message = f"--log mlflow: found {target!r}, expected an absolute path on the cluster's nodes: sqlite:////…"
        raise SpecError(message)
