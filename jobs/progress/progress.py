"""How far a job has come, arm by arm: one pure state that terminal, status file, Prometheus and TensorBoard show."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from cluster.events import ShardDone, ShardEvent, ShardProgress, ShardRestarted
from cluster.shard import Shard

ShardKey = tuple[str, str, int]
_NOTHING = ShardProgress(0, 0, 0)


@dataclass(frozen=True)
class ArmProgress:
    """How far an arm has come, all its sweep points taken together.

    Attributes
    ----------
    runs_done:
        Runs that are over, those of earlier sessions and failed ones included.
    episodes, steps:
        Played so far, runs of earlier sessions not counted; a run that is over counts with its cap of episodes.
    episodes_planned:
        What ``episodes`` will be in the end.
    episodes_per_run, steps_per_run:
        Played so far by the runs of this session, on average: those that there were.
    selection_share:
        Share of the latest episodes that each learner played.
    concentration:
        Mean Dirichlet concentration of each learner, over the runs under way; empty where there is none.
    mean_return:
        Mean undiscounted return of the latest episodes; None before the first.
    mean_train_time:
        Mean train time in episodes over the runs finished in this session; None without one, or without a criterion.
    """

    runs_planned: int = 0
    runs_done: int = 0
    runs_failed: int = 0
    episodes: int = 0
    episodes_planned: int = 0
    episodes_per_run: float = 0.0
    steps_per_run: float = 0.0
    steps: int = 0
    rounds: int = 0
    round_seconds: float = 0.0
    checkpoint_seconds: float = 0.0
    selection_share: Mapping[str, float] = field(default_factory=dict)
    concentration: Mapping[str, float] = field(default_factory=dict)
    mean_return: float | None = None
    mean_train_time: float | None = None


class JobProgress:
    """The state of a job: what was planned, and the last that was heard of every shard."""

    def __init__(self) -> None:
        self._planned: dict[str, list[Shard]] = {}
        self._finished_before: Counter[str] = Counter()
        self._last: dict[ShardKey, ShardProgress] = {}
        self._has_criterion: dict[str, bool] = {}
        self.num_restarts = 0

    def planned(self, shards: Sequence[Shard], finished: Collection[tuple[str, str, int]]) -> None:
        """What is to be played, beside what was planned before; the runs (arm, sweep point, index) that were finished
        in earlier sessions.
        """
        self._finished_before = Counter(arm for arm, _, _ in finished)
        for shard in shards:
            self._planned.setdefault(shard.arm.arm, []).append(shard)
            self._has_criterion[shard.arm.arm] = shard.arm.criterion is not None

    @property
    def num_shards(self) -> int:
        """Those that were planned so far."""
        return sum(map(len, self._planned.values()))

    def progressed(self, shard: Shard, event: ShardEvent) -> None:
        """Take in what is told of a shard."""
        if isinstance(event, ShardProgress):
            self._last[shard.key] = _with_latest_episodes(event, self._last.get(shard.key, _NOTHING))
        elif isinstance(event, ShardDone):
            self._last[shard.key] = _completed(shard, event, self._last.get(shard.key, _NOTHING))
        elif isinstance(event, ShardRestarted):
            self.num_restarts += 1

    def arms(self) -> dict[str, ArmProgress]:
        """By name: first those with something to do, in the order of the plan, then those that were complete."""
        names = dict.fromkeys([*self._planned, *self._finished_before])
        return {name: self._arm(name) for name in names}

    def as_json(self) -> dict[str, Any]:
        """As plain values."""
        return {"restarts": self.num_restarts, "arms": {name: asdict(arm) for name, arm in self.arms().items()}}

    def _arm(self, name: str) -> ArmProgress:
        shards, before = self._planned.get(name, []), self._finished_before[name]
        heard = [(shard, self._last[shard.key]) for shard in shards if shard.key in self._last]
        reports = [report for _, report in heard]
        over = sum(report.num_finished for report in reports)
        failed = sum(report.num_failed for report in reports)
        played = Counter[str]()
        for shard, report in heard:
            played.update(dict(zip(shard.arm.learner_names, report.played, strict=False)))
        num_played = played.total()
        num_runs = sum(len(shard.runs) for shard in shards)
        episodes, steps = (sum(getattr(report, name) for report in reports) for name in ("episodes", "steps"))
        trained = over - failed if self._has_criterion.get(name) else 0
        return ArmProgress(
            runs_planned=before + num_runs,
            runs_done=before + over,
            runs_failed=failed,
            episodes=episodes,
            episodes_planned=sum(len(shard.runs) * shard.arm.num_episodes for shard in shards),
            episodes_per_run=sum(report.episodes_played for report in reports) / num_runs if num_runs else 0.0,
            steps_per_run=steps / num_runs if num_runs else 0.0,
            steps=steps,
            rounds=sum(report.rounds for report in reports),
            round_seconds=sum(report.round_seconds for report in reports),
            checkpoint_seconds=sum(report.checkpoint_seconds for report in reports),
            selection_share={learner: count / num_played for learner, count in played.items() if num_played},
            concentration=_mean_by_learner(heard),
            mean_return=_ratio(sum(report.episode_return for report in reports), num_played),
            mean_train_time=_ratio(sum(report.train_time for report in reports), trained),
        )


def _with_latest_episodes(report: ShardProgress, last: ShardProgress) -> ShardProgress:
    """The report; where nothing was played since the one before, with its episodes, still the latest."""
    return report if any(report.played) else replace(report, played=last.played, episode_return=last.episode_return)


def _completed(shard: Shard, done: ShardDone, last: ShardProgress) -> ShardProgress:
    """The last progress of a shard that is over; runs whose environment could not be built never reported any."""
    count = len(shard.runs)
    return replace(
        last,
        num_finished=count,
        num_failed=len(done.failures),
        episodes=count * shard.arm.num_episodes,
        steps=done.steps,
        episodes_played=done.episodes_played,
    )


def _mean_by_learner(heard: Iterable[tuple[Shard, ShardProgress]]) -> dict[str, float]:
    """Mean over shards, each weighted by its runs under way."""
    sums: dict[str, float] = defaultdict(float)
    weights: dict[str, int] = defaultdict(int)
    for shard, report in heard:
        weight = len(shard.runs) - report.num_finished
        for learner, value in zip(shard.arm.learner_names, report.concentration, strict=False):
            sums[learner] += value * weight
            weights[learner] += weight
    return {learner: sums[learner] / weight for learner, weight in weights.items() if weight}


def _ratio(total: float, count: int) -> float | None:
    """The mean; None where there is none, or none that is a number."""
    return total / count if count and math.isfinite(total) else None
