"""Which candidate to use, and how sure that is: all that the rows say, as plain values."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from jobs.analysis.answer.contests import Candidate, Contest, contests
from jobs.analysis.answer.measures import Kind, Measure, Measures, measures, run_rows
from jobs.analysis.answer.played import PlayedRuns, played_runs
from jobs.analysis.statistics.bootstrap import Estimate, Floats, bootstrap_interval
from jobs.analysis.statistics.ranking import standing
from jobs.analysis.statistics.sequential import Decision, decide
from jobs.results.store import ResultStore, StoreError

_NEEDED = ("run_index", "train_time", "censored", "episodes", "steps")


@dataclass(frozen=True)
class Placed:
    """How a candidate, or a learner, does by one measure.

    Attributes
    ----------
    estimate:
        Mean over its runs, and 95 % interval.
    probability_best, probability_near:
        Of being the best, and within 5 % of it: shares of bootstrap resamples of the runs.
    num_at_cap:
        Runs that did not meet the criterion, and count with what they played: the mean is too small.
    """

    name: str
    estimate: Estimate[float]
    probability_best: float
    probability_near: float
    num_runs: int
    num_at_cap: int = 0


@dataclass(frozen=True)
class Ranking:
    """Candidates by one measure, the best first."""

    kind: Kind
    smaller_is_better: bool
    places: tuple[Placed, ...]


@dataclass(frozen=True)
class LateLearner:
    """What a learner inside an ensemble returned in the last tenth of the runs, in the episodes that it played."""

    place: Placed
    num_episodes: int


@dataclass(frozen=True)
class Inside:
    """The learners of an ensemble, the best first."""

    ensemble: str
    learners: tuple[LateLearner, ...]


@dataclass(frozen=True)
class Cost:
    """Environment steps that a candidate's answer took.

    Attributes
    ----------
    steps:
        Of all its runs.
    alone:
        Of an ensemble: those of each of its learners alone, as often; None of a learner alone.
    is_measured:
        Whether these were played here; else each is taken to need as many as the ensemble.
    """

    name: str
    num_runs: int
    num_learners: int
    steps: int
    alone: int | None
    is_measured: bool


@dataclass(frozen=True)
class Verdict:
    """What the test says; see `jobs.analysis.statistics.sequential`.

    Attributes
    ----------
    best:
        Better than all others; None where that is undecided.
    left:
        Those that no other one has beaten, the best first.
    gap:
        How much the first of ``left`` is better than each other one, run by run, with 95 % interval; positive.
    """

    best: str | None
    left: tuple[str, ...]
    num_runs: int
    error: float
    gap: dict[str, Estimate[float]]
    deviation: dict[str, float]


@dataclass(frozen=True)
class Answer:
    """One task's; ``rankings`` begin with the measure that decides, and are none where nothing can be compared."""

    task: str
    verdict: Verdict | None
    rankings: tuple[Ranking, ...]
    inside: tuple[Inside, ...]
    costs: tuple[Cost, ...]
    notes: tuple[str, ...]


def compare(store: ResultStore, error: float, arms: Collection[str] | None = None) -> list[Answer]:
    """The answers that results give, one per task: several where a sweep changes more than arms and learners.

    Of ``arms`` alone, if these are given: the error is shared among comparisons of theirs, whatever else there is.

    Raises
    ------
    StoreError
        If there are no results, or they are damaged.
    """
    experiment, runs = store.experiment(), store.runs()
    if missing := [name for name in _NEEDED if name not in runs.column_names]:
        place = store.folder.location("runs.parquet")
        message = f"{place}: found no column {', '.join(missing)}, expected the rows that `apel run` stores"
        raise StoreError(message)
    chosen = [contest.only(arms) for contest in contests(experiment)]
    found = [_answer(store, contest, run_rows(runs, contest.candidates), error) for contest in chosen]
    return [answer for answer in found if answer.costs]


def _answer(store: ResultStore, contest: Contest, rows: Sequence[pd.DataFrame], error: float) -> Answer:
    there = [place for place, part in enumerate(rows) if len(part)]
    candidates, rows = [contest.candidates[place] for place in there], [rows[place] for place in there]
    if not candidates:
        return Answer(contest.task, None, (), (), (), ())
    played = [_played(store, one, part) for one, part in zip(candidates, rows, strict=True)]
    found = measures(candidates[0].point.point.experiment, rows, played)
    names = [one.name for one in candidates]
    inside = [_inside(one, facts) for one, facts in zip(candidates, played, strict=True) if one.point.num_learners > 1]
    seed = candidates[0].point.point.experiment.seed
    return Answer(
        contest.task,
        _verdict(names, found, error, seed) if found.known else None,
        tuple(_ranking(names, measure) for measure in found.known),
        tuple(one for one in inside if one is not None),
        _costs(candidates, rows),
        (*found.notes, *_unseen(candidates, played)),
    )


def _played(store: ResultStore, candidate: Candidate, rows: pd.DataFrame) -> PlayedRuns:
    known = rows[["episodes", "train_time"]].astype(float)
    by_run = {int(index): row for index, row in known.to_dict("index").items()}
    point = candidate.point
    return played_runs(store.folder, point.point.experiment, point.arm, point.point.label, by_run, point.num_learners)


def _ranking(names: Sequence[str], measure: Measure) -> Ranking:
    places = _placed(names, measure.values, smaller_is_better=measure.smaller_is_better, num_at_cap=measure.num_at_cap)
    return Ranking(measure.kind, measure.smaller_is_better, tuple(places))


def _placed(
    names: Sequence[str], values: Floats, *, smaller_is_better: bool, num_at_cap: Sequence[int]
) -> list[Placed]:
    """Of each candidate with any value, the best first."""
    shares = standing(values, smaller_is_better=smaller_is_better)
    found = []
    for place, name in enumerate(names):
        known = values[np.isfinite(values[:, place]), place]
        if len(known):
            estimate = Estimate(float(known.mean()), *bootstrap_interval(known))
            share = float(shares.best[place]), float(shares.near[place])
            found.append(Placed(name, estimate, *share, len(known), num_at_cap[place]))
    sign = 1.0 if smaller_is_better else -1.0
    return sorted(found, key=lambda one: sign * one.estimate.value)


def _verdict(names: Sequence[str], found: Measures, error: float, seed: int) -> Verdict:
    measure = found.known[0]
    decision: Decision = decide(measure.values, smaller_is_better=measure.smaller_is_better, error=error, seed=seed)
    costs = measure.values if measure.smaller_is_better else -measure.values
    left = sorted(decision.left, key=lambda place: float(np.nanmean(costs[:, place])))
    gap, deviation = {}, {}
    for other in range(len(names)):
        differences = costs[:, other] - costs[:, left[0]]
        differences = differences[np.isfinite(differences)]
        if other != left[0] and len(differences):
            gap[names[other]] = Estimate(float(differences.mean()), *bootstrap_interval(differences))
            deviation[names[other]] = float(differences.std(ddof=1)) if len(differences) > 1 else 0.0
    best = names[decision.best] if decision.best is not None else None
    return Verdict(best, tuple(names[place] for place in left), decision.num_runs, error, gap, deviation)


def _inside(candidate: Candidate, played: PlayedRuns) -> Inside | None:
    if not played.late_return:
        return None
    values = np.stack(list(played.late_return.values()))
    episodes = np.sum(list(played.late_episodes.values()), axis=0)
    names, nobody = candidate.learners, [0] * values.shape[1]
    placed = _placed(names, values, smaller_is_better=False, num_at_cap=nobody)
    learners = tuple(LateLearner(one, int(episodes[names.index(one.name)])) for one in placed)
    return Inside(candidate.name, learners) if learners else None


def _unseen(candidates: Sequence[Candidate], played: Sequence[PlayedRuns]) -> list[str]:
    names = [
        one.name
        for one, facts in zip(candidates, played, strict=True)
        if one.point.num_learners > 1 and not any(number.any() for number in facts.late_episodes.values())
    ]
    if not names:
        return []
    return [f"of the learners inside {' and '.join(names)} no late episode was recorded; record: all keeps them"]


def _costs(candidates: Sequence[Candidate], rows: Sequence[pd.DataFrame]) -> tuple[Cost, ...]:
    singles = [
        (one.point, int(part["steps"].sum()), len(part))
        for one, part in zip(candidates, rows, strict=True)
        if one.point.num_learners == 1
    ]
    found = []
    for one, part in zip(candidates, rows, strict=True):
        steps, count = int(part["steps"].sum()), one.point.num_learners
        # A learner that an axis does not touch was played once for all of its points.
        alone = {
            point.spec.learner_names[0]: played
            for point, *played in singles
            if point.point.values.items() <= one.point.point.values.items()
        }
        pairs = [alone.get(name) for name in one.point.spec.learner_names]
        # A learner that was run less, or more, often is counted as often as the ensemble.
        measured = [round(pair[0] * len(part) / pair[1]) for pair in pairs if pair is not None]
        is_measured = len(measured) == count
        others = None if count == 1 else sum(measured) if is_measured else count * steps
        found.append(Cost(one.name, len(part), count, steps, others, is_measured))
    return tuple(found)
