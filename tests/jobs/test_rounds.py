"""Runs are added until the best arm is decided: the same ones whatever came between, and no more than that takes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from cluster.shard import Execution
from jobs.analysis.answer.comparison import compare
from jobs.analysis.answer.contests import contests
from jobs.analysis.answer.measures import measures, run_rows
from jobs.analysis.answer.played import PlayedRuns
from jobs.experiment.plan import Plan, RunKey
from jobs.experiment.spec_files import load_experiment
from jobs.experiment.yaml_source import SpecError
from jobs.results.store import ResultStore
from jobs.rounds import AllAtOnce, UntilDecided, refuse_undecidable
from jobs.runner import Settings, run_experiment

MOST = 30


@pytest.fixture
def plan(small: Path) -> Plan:
    """Three arms of thirty runs."""
    return Plan.of(load_experiment(str(small), [f"runs={MOST}"]))


class Played:
    """Rows that are made up as they are asked for: train times of each arm, by run."""

    def __init__(self, plan: Plan, means: dict[str, float]) -> None:
        self.plan, self.means = plan, means
        self.finished: set[RunKey] = set()
        self.rounds: list[tuple[int, tuple[str, ...]]] = []

    def rows(self) -> pa.Table:
        """The finished runs."""
        keys = sorted(self.finished)
        noise = np.random.default_rng(7).normal(size=(MOST, len(self.means)))
        place = {arm: position for position, arm in enumerate(self.means)}
        times = [round(1000 * (self.means[arm] + noise[index, place[arm]])) for arm, _, index in keys]
        columns = {
            "arm": [arm for arm, _, _ in keys], "sweep": [""] * len(keys), "run_index": [index for *_, index in keys],
            "train_time": times, "censored": [False] * len(keys), "steps": times,
        }  # fmt: skip
        return pa.table(columns)

    def play(self, rounds: UntilDecided, num_rounds: int = 99) -> None:
        """Play so many rounds, or all there are."""
        while num_rounds and (due := rounds.next(self.finished)) is not None:
            self.rounds.append((len(due.seeds), tuple(one.arm for one in due.arm_points)))
            self.finished |= set(due.run_keys())
            num_rounds -= 1


def test_rounds(plan: Plan) -> None:
    """A beaten arm gets no more runs, the rounds end with the decision, and what was saved is counted.

    With three arms and α = 0.05 no fewer than nine runs decide.
    """
    played = Played(plan, {"Q_full": 8.0, "APEL": 0.0, "SSBAS": 1.6})
    rounds = UntilDecided(plan, 0.05, played.rows)
    played.play(rounds)
    assert played.rounds[0] == (9, ("Q_full", "APEL", "SSBAS"))
    assert played.rounds[1] == (12, ("APEL", "SSBAS"))
    assert len(played.rounds) < 6
    last = played.rounds[-1][0]
    saved = 3 * MOST - 9 - 2 * last
    told = f"no more runs: APEL is the best, at an error of 5 %; {saved} of 90 runs were saved"
    assert rounds.told(played.finished) == told
    assert rounds.next(played.finished) is None


@pytest.mark.parametrize("num_rounds", [1, 2, 3])
def test_what_came_between_does_not_matter(plan: Plan, num_rounds: int) -> None:
    """Another process, or the same command with another cap in between, plays the same rounds."""
    means = {"Q_full": 1.0, "APEL": 0.0, "SSBAS": 0.9}
    once, again = Played(plan, means), Played(plan, means)
    once.play(UntilDecided(plan, 0.05, once.rows))
    again.play(UntilDecided(plan, 0.05, again.rows), num_rounds)
    again.play(UntilDecided(plan, 0.05, again.rows))
    assert again.rounds == once.rounds
    assert again.finished == once.finished


def test_runs_that_are_there_already_count(plan: Plan) -> None:
    """Decisions are those of the first runs, though there are more: nothing is played, and the answer is the same."""
    means = {"Q_full": 8.0, "APEL": 0.0, "SSBAS": 1.6}
    played = Played(plan, means)
    played.finished = set(plan.run_keys())
    rounds = UntilDecided(plan, 0.05, played.rows)
    assert rounds.next(played.finished) is None
    assert "APEL is the best" in rounds.told(played.finished)
    assert "0 of 90 runs were saved" in rounds.told(played.finished)


def test_undecided(plan: Plan) -> None:
    """Arms that are equal get all runs that there may be, and nothing is claimed."""
    played = Played(plan, {"Q_full": 0.0, "APEL": 0.0, "SSBAS": 0.0})
    rounds = UntilDecided(plan, 0.01, played.rows)
    played.play(rounds)
    assert played.rounds[-1][0] == MOST
    assert rounds.told(played.finished).startswith("no more runs: with 30 runs it is not decided")


def test_an_error_that_no_number_of_runs_reaches(plan: Plan) -> None:
    """Is refused before anything is played; the smallest one is named."""
    refuse_undecidable(plan, 0.0005)
    told = r"--error: found 0\.0001, expected more than 0\.000488281 with 3 to be compared"
    with pytest.raises(SpecError, match=told):
        refuse_undecidable(plan, 0.0001)


@pytest.mark.parametrize("steps", [100_000, 3_000])
def test_a_missed_criterion_is_no_quick_one(small: Path, steps: int) -> None:
    """Where steps end runs too, an arm that never meets the criterion has fewer episodes than one that does, or, where
    its episodes are short, fewer steps: it counts with the cap of steps.
    """
    plan = Plan.of(load_experiment(str(small), ["runs=20", "episodes=5000", "steps=100000"])).only(["Q_full", "APEL"])
    played = {"Q_full": (1000, False, 40_000), "APEL": (560, True, steps)}
    columns = [
        {"arm": arm, "sweep": "", "run_index": run, "train_time": time + run, "censored": missed, "steps": took}
        for run in range(20)
        for arm, (time, missed, took) in played.items()
    ]
    table = pa.Table.from_pylist(columns)
    rounds = UntilDecided(plan, 0.05, lambda: table)
    assert "Q_full is the best" in rounds.told({(row["arm"], "", row["run_index"]) for row in columns})
    kinds = measures(plan.experiment, run_rows(table, contests(plan.experiment)[0].candidates[:2]), [PlayedRuns()] * 2)
    assert [one.kind for one in kinds.known] == ["steps", "episodes"]
    assert kinds.known[0].values.max() == 100_000
    assert kinds.known[1].values.max() == 5000


def test_all_at_once(plan: Plan) -> None:
    """Without it there is one round."""
    assert AllAtOnce(plan).next(set()) is plan
    assert AllAtOnce(plan).next(set(plan.run_keys())) is None


@pytest.mark.parametrize(
    ("override", "arms", "message"),
    [
        ("sweep={arms.APEL.selector.decay: [0.01, 0.1]}", None, "sweep: found a sweep, expected none with --until"),
        ("runs=9", ("APEL",), "--until: found 1 arms to be played, expected 2 to 32"),
    ],
)
def test_what_cannot_be_decided(
    override: str, arms: tuple[str, ...] | None, message: str, small: Path, tmp_path: Path
) -> None:
    """It is said before anything is played or written."""
    experiment = load_experiment(str(small), [override])
    settings = Settings(results=str(tmp_path / "results"), placement="local", error=0.05, arms=arms)
    with pytest.raises(SpecError, match=message):
        run_experiment(experiment, settings)
    assert not (tmp_path / "results").exists()


def test_played(small: Path, tmp_path: Path) -> None:
    """Rounds that are played: rows are those of the whole experiment, also where every round was interrupted, and
    `apel compare` gives the same answer.
    """
    arms = "arms={good: {learners: [Q_full]}, bad: {learners: [Q_red]}}"
    stuck = "learners.Q_red={type: q_learning, learning_rate: 1e-9}"
    experiment = load_experiment(str(small), ["runs=14", "record=none", "episodes=200", stuck, arms])
    settings = Settings(results=str(tmp_path / "rounds"), placement="local", shard_size=4, error=0.4)
    outcome = run_experiment(experiment, settings)
    rows = outcome.store.runs()
    whole = run_experiment(experiment, replace(settings, results=str(tmp_path / "whole"), error=None)).store.runs()
    assert len(rows) < len(whole)
    keep = pa.compute.is_in(pa.array(_keys(whole)), value_set=pa.array(_keys(rows)))
    assert whole.filter(keep).equals(rows)
    assert f"{len(whole) - len(rows)} of 28 runs were saved" in outcome.told

    told, broken = "", replace(settings, results=str(tmp_path / "broken"), execution=Execution(checkpoint_seconds=0.0))
    for _ in range(60):
        calls = iter(range(1000))
        interrupted = run_experiment(experiment, broken, stopping=lambda calls=calls: next(calls) > 9)  # type: ignore[misc]
        if not interrupted.was_stopped:
            told = interrupted.told
            break
    assert told == outcome.told
    assert interrupted.store.runs().equals(rows)

    (answer,) = compare(ResultStore.at(outcome.store.folder.location()), 0.4)
    assert answer.verdict is not None
    assert (f"{answer.verdict.best} is the best" in outcome.told) == (answer.verdict.best is not None)


def _keys(table: pa.Table) -> list[str]:
    return [f"{row['arm']} {row['run_index']}" for row in table.select(["arm", "run_index"]).to_pylist()]
