"""Which episode of stored results is to be watched, and whether a replay of it is the one that was stored."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from apel.numerics.near_names import did_you_mean
from apel.numerics.seeding import run_seeds
from cluster.run_replay import Replay
from cluster.shard import ArmPlan, RunPlan
from jobs.experiment.plan import Plan
from jobs.experiment.run_plans import OptionError, arm_plan, fresh_run_plan, with_starts
from jobs.experiment.spec import Experiment
from jobs.experiment.sweep import ArmPoint
from jobs.experiment.yaml_source import SpecError
from jobs.results.episodes import read_episodes
from jobs.results.store import ResultStore, StoreError

_ROW = ("arm", "sweep", "run_index", "episodes", "steps")


@dataclass(frozen=True)
class Wish:
    """What somebody wants to watch; None leaves the choice to `find_scene`."""

    arm: str | None = None
    sweep: str | None = None
    run: int = 0
    episode: int | None = None
    """Counted from the end where it is negative."""


@dataclass(frozen=True)
class Scene:
    """One episode of one run.

    Attributes
    ----------
    run:
        Without the agents that its learners began with: who plays it again needs them, see `to_play`.
    num_episodes, num_steps:
        Of the whole run, as stored.
    """

    arm_point: ArmPoint
    arm: ArmPlan
    run: RunPlan
    episode: int
    num_episodes: int
    num_steps: int

    @property
    def label(self) -> str:
        """For people."""
        sweep = f" [{self.arm.sweep}]" if self.arm.sweep else ""
        return f"{self.arm.arm}{sweep} · run {self.run.index}"

    def to_play(self) -> RunPlan:
        """The run with all that its learners began with.

        Raises
        ------
        SpecError
            If an agent that they began with is no longer where it was.
        """
        with _refused(self.arm_point.point.experiment):
            return with_starts(self.arm_point, self.run)


def find_scene(store: ResultStore, wish: Wish) -> Scene:
    """The wanted episode; by default the last one of run 0 of the first ensemble.

    Raises
    ------
    StoreError
        If these are no results.
    SpecError
        If they do not hold what is wanted.
    """
    experiment = store.experiment()
    rows = store.runs().select(_ROW).to_pylist()
    arm = _arm(experiment, {row["arm"] for row in rows}, wish.arm)
    rows = [row for row in rows if row["arm"] == arm]
    labels = {row["sweep"] for row in rows}
    points = {one.point.label: one for one in Plan.of(experiment).only([arm]).arm_points if one.point.label in labels}
    sweep = next(iter(points)) if wish.sweep is None else _one_of("--sweep", wish.sweep, list(points))
    row = _run(arm, [row for row in rows if row["sweep"] == sweep], wish.run)
    episode = _episode(wish.episode, row["episodes"])
    # Not the plan's seed: an earlier session may have stored more runs than the experiment has now.
    seed = run_seeds(experiment.seed, wish.run + 1)[wish.run]
    with _refused(experiment):
        run = fresh_run_plan(points[sweep], wish.run, seed)
    arm_of_point = replace(arm_plan(points[sweep]), identity=experiment.identity)
    return Scene(points[sweep], arm_of_point, run, episode, row["episodes"], row["steps"])


@contextmanager
def _refused(experiment: Experiment) -> Iterator[None]:
    """Options that cannot be filled in are bad input, like a field of an experiment file."""
    try:
        yield
    except OptionError as error:
        message = f"{experiment.where(*error.place)}: {error}"
        raise SpecError(message) from error


def _arm(experiment: Experiment, finished: set[str], wanted: str | None) -> str:
    arms = [arm for arm in experiment.arms if arm in finished]
    if wanted is not None:
        return _one_of("--arm", wanted, arms)
    ensembles = [arm for arm in arms if len(experiment.arms[arm].learner_names) > 1]
    return (ensembles or arms)[0]


def _one_of(option: str, wanted: str, present: Sequence[str]) -> str:
    if wanted not in present:
        expected = f"one of {', '.join(map(repr, present))}{did_you_mean(wanted, present)}"
        message = f"{option}: found {wanted!r}, expected {expected}"
        raise SpecError(message)
    return wanted


def _run(arm: str, rows: Sequence[dict[str, Any]], wanted: int) -> dict[str, Any]:
    by_index = {row["run_index"]: row for row in rows}
    if wanted not in by_index:
        message = (
            f"--run: found {wanted}, expected a finished run of {arm}: there are {len(by_index)}, "
            f"from {min(by_index)} to {max(by_index)}"
        )
        raise SpecError(message)
    return by_index[wanted]


def _episode(wanted: int | None, num_episodes: int) -> int:
    episode = num_episodes - 1 if wanted is None else wanted + (num_episodes if wanted < 0 else 0)
    if not 0 <= episode < num_episodes:
        message = f"--episode: found {wanted}, expected {-num_episodes} to {num_episodes - 1}: the run has no others"
        raise SpecError(message)
    return episode


def check_replay(store: ResultStore, scene: Scene, replay: Replay) -> int:
    """See that every episode that was recorded is the one that was played again; returns how many these are.

    Raises
    ------
    StoreError
        If one is not, or if the whole run took another number of steps.
    """
    stored = _recorded(store, scene)
    episodes = stored["episode"].to_numpy()
    columns = {"selected": replay.learner, "return": replay.episode_return, "length": replay.length}
    found = {name: column[episodes] for name, column in columns.items()}
    differs = np.any([found[name] != stored[name].to_numpy() for name in columns], axis=0)
    if differs.any():
        row = int(np.flatnonzero(differs)[0])
        played, expected = ({name: of[name][row] for name in columns} for of in (found, stored.to_pandas()))
        _refuse(store, f"episode {episodes[row]} of {scene.label}", _described(played), _described(expected))
    steps = int(replay.length.sum())
    if scene.episode + 1 == scene.num_episodes and steps != scene.num_steps:
        _refuse(store, scene.label, f"{steps} steps", f"{scene.num_steps}")
    return len(episodes)


def _described(row: dict[str, Any]) -> str:
    return ", ".join(f"{name} {value:g}" for name, value in row.items())


def _refuse(store: ResultStore, what: str, found: str, expected: str) -> None:
    message = (
        f"{store.folder.location()}: {what}, played again here: found {found}, expected what is stored, {expected}: "
        "this project, its libraries or your own code have another version than then, or it is another machine"
    )
    raise StoreError(message)


def _recorded(store: ResultStore, scene: Scene) -> pa.Table:
    """The rows of the run's recorded episodes, up to the scene's."""
    columns = ["episode", "selected", "return", "length"]
    # The replay shows what is true, and which episode differs.
    wanted = ["run_index", *columns]
    stored = read_episodes(store.folder, scene.arm.arm, wanted, scene.arm.sweep, is_verified=False)
    if stored is None:
        return pa.table({name: np.zeros(0, dtype=np.int64) for name in columns})
    is_run = pc.equal(stored["run_index"], scene.run.index)
    return stored.filter(pc.and_(is_run, pc.less_equal(stored["episode"], scene.episode))).select(columns)
