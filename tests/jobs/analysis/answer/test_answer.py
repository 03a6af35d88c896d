"""Which arm to use, how sure that is, and what of that can be known from which rows."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from jobs.analysis.answer.comparison import Answer, compare
from jobs.analysis.answer.measures import measures
from jobs.analysis.answer.played import PlayedRuns
from jobs.analysis.answer.words import _columns, answer_json, answer_lines
from jobs.analysis.pages.report import write_report
from jobs.experiment.spec_files import load_experiment
from jobs.results.store import ResultStore
from jobs.runner import Settings, run_experiment
from tests.command_line import called, printed
from tests.experiments import SMALL

Play = Callable[..., ResultStore]
AT_LENGTH = ["criterion=null", "episodes=60"]


@pytest.fixture(scope="module")
def play(tmp_path_factory: pytest.TempPathFactory) -> Play:
    """Plays the small experiment with changes, each once."""
    folder = tmp_path_factory.mktemp("answers")
    (folder / "small.yaml").write_text(SMALL)
    played: dict[tuple[str, ...], ResultStore] = {}

    def play(*changes: str) -> ResultStore:
        if changes not in played:
            experiment = load_experiment(str(folder / "small.yaml"), changes)
            settings = Settings(results=str(folder / "results"), placement="local")
            played[changes] = run_experiment(experiment, settings).store
        return played[changes]

    return play


def answer(store: ResultStore) -> Answer:
    """The one answer that results give."""
    (found,) = compare(store, 0.05)
    return found


def value(found: Answer, kind: str, name: str) -> float:
    """Mean of a candidate by a measure."""
    (ranking,) = (one for one in found.rankings if one.kind == kind)
    return next(place.estimate.value for place in ranking.places if place.name == name)


def recorded(store: ResultStore, arm: str) -> pd.DataFrame:
    """The episodes of an arm, as pandas reads them."""
    folder = store.folder.location(f"episodes/arm={arm}")
    return pd.concat([pd.read_parquet(file) for file in sorted(Path(folder).glob("*.parquet"))])


def test_returns_and_areas(play: Play) -> None:
    """Of runs of equal length: the stored return of the last tenth, and the mean return of all episodes."""
    store = play(*AT_LENGTH)
    found, runs = answer(store), store.runs().to_pandas()
    assert [one.kind for one in found.rankings] == ["return", "area"]
    assert not found.notes
    for arm, group in runs.groupby("arm"):
        assert value(found, "return", arm) == pytest.approx(group["last_tenth_return"].mean())
        assert value(found, "area", arm) == pytest.approx(recorded(store, arm)["return"].mean())
    returns = [place.estimate.value for place in found.rankings[0].places]
    assert returns == sorted(returns, reverse=True)
    assert sum(place.probability_best for place in found.rankings[0].places) == pytest.approx(1.0)


def test_returns_that_overflow_are_not_compared(play: Play) -> None:
    """Which is said in place of an answer."""
    experiment = play(*AT_LENGTH).experiment()
    rows = [pd.DataFrame({"steps": [9], "censored": [None], "last_tenth_return": [end]}) for end in (np.inf, 3.0)]
    found = measures(experiment, rows, [PlayedRuns()] * 2)
    assert not found.known
    assert found.notes[0] == "the return of some runs is so large that it is no finite number"


def test_area_over_steps(play: Play) -> None:
    """Where steps end a run, an episode counts as long as it was."""
    store = play("criterion=null", "steps=1500")
    found, episodes = answer(store), recorded(store, "Q_full")
    weighted = episodes["return"] * episodes["length"]
    by_run = weighted.groupby(episodes["run_index"]).sum() / episodes.groupby("run_index")["length"].sum()
    assert value(found, "area", "Q_full") == pytest.approx(by_run.mean())


@pytest.mark.parametrize(
    "changes", [AT_LENGTH, ["criterion=null", "steps=1500", "episodes=1000"]], ids=["episodes", "steps"]
)
def test_learners_inside(play: Play, changes: list[str]) -> None:
    """A learner has the episodes of the last tenth that it played, run by run, and all of these are somebody's."""
    store = play(*changes)
    inside = {one.ensemble: one for one in answer(store).inside}["APEL"]
    episodes = recorded(store, "APEL").sort_values(["run_index", "episode"])
    if changes == AT_LENGTH:
        late = episodes[episodes["episode"] >= 54]
    else:
        late = episodes[episodes.groupby("run_index")["length"].cumsum() > 1350]
    for one in inside.learners:
        own = late[late["selected"] == ["Q_full", "Q_red"].index(one.place.name)]
        assert one.num_episodes == len(own)
        assert one.place.num_runs == own["run_index"].nunique()
        assert one.place.estimate.value == pytest.approx(own.groupby("run_index")["return"].mean().mean())
    assert sum(one.num_episodes for one in inside.learners) == len(late)


def test_criterion_that_ends_runs(play: Play) -> None:
    """How early it is met decides; runs at the cap are counted; the final return is not compared."""
    store = play()
    found, runs = answer(store), store.runs().to_pandas()
    assert [one.kind for one in found.rankings] == ["episodes", "steps"]
    for place in found.rankings[0].places:
        group = runs[runs["arm"] == place.name]
        assert place.estimate.value == pytest.approx(group["train_time"].mean())
        assert place.num_at_cap == group["censored"].sum()
        assert value(found, "steps", place.name) == pytest.approx(group["steps"].mean())


def test_criterion_that_ends_nothing(play: Play) -> None:
    """Returns decide, and the steps to the criterion are those of the episodes before it was met."""
    store = play("stop_when_met=false")
    found = answer(store)
    assert [one.kind for one in found.rankings] == ["return", "area", "episodes", "steps"]
    episodes, runs = recorded(store, "APEL"), store.runs().to_pandas().query("arm == 'APEL'").set_index("run_index")
    before = episodes[episodes["episode"] < episodes["run_index"].map(runs["train_time"])]
    assert value(found, "steps", "APEL") == pytest.approx(before.groupby("run_index")["length"].sum().mean())


@pytest.mark.parametrize(
    ("record", "kinds", "said"),
    [
        ("none", ["return", "episodes"], ["with record: none no episode is", "steps to the criterion are not known"]),
        ("log", ["return", "area", "episodes"], ["estimated from the 378 of 1,440", "steps to the criterion are not"]),
        ("{every: 7}", ["return", "area", "episodes"], ["estimated from the 216 of 1,440"]),
    ],
)
def test_what_was_not_recorded(play: Play, record: str, kinds: list[str], said: list[str]) -> None:
    """It is said, and the return, which needs no episodes, is what it is with all of them."""
    found, whole = answer(play("stop_when_met=false", f"record={record}")), answer(play("stop_when_met=false"))
    assert [one.kind for one in found.rankings] == kinds
    assert found.rankings[0] == whole.rankings[0]
    assert found.verdict == whole.verdict
    text = " ".join(answer_lines([found]))
    for part in said:
        assert part in text
    if "area" in kinds:
        assert value(found, "area", "APEL") == pytest.approx(value(whole, "area", "APEL"), rel=0.5)
    if record == "none":
        assert "Of the learners inside APEL and SSBAS no late episode was recorded" in text


def test_costs(play: Play) -> None:
    """An ensemble's steps beside those of its learners alone: as played here, or as many each as the ensemble's."""
    store = play(*AT_LENGTH)
    steps = store.runs().to_pandas().groupby("arm")["steps"].sum()
    costs = {cost.name: cost for cost in answer(store).costs}
    assert (costs["APEL"].steps, costs["APEL"].alone, costs["APEL"].is_measured) == (
        steps["APEL"],
        2 * steps["APEL"],
        False,
    )
    assert costs["Q_full"].alone is None
    other = play(*AT_LENGTH, "arms.SSBAS={learners: [Q_red]}")
    steps = other.runs().to_pandas().groupby("arm")["steps"].sum()
    apel = {cost.name: cost for cost in answer(other).costs}["APEL"]
    assert (apel.alone, apel.is_measured) == (steps["Q_full"] + steps["SSBAS"], True)


def test_costs_in_a_sweep(play: Play) -> None:
    """Learners alone that an axis does not touch are those of an ensemble at every point; others those of its own."""
    decays, rates = "arms.APEL.selector.decay: [0.01, 0.1]", "learners.Q_full.learning_rate: [0.1, 0.2]"
    store = play(*AT_LENGTH, "arms.SSBAS={learners: [Q_red]}", f"sweep={{{decays}, {rates}}}")
    steps = store.runs().to_pandas().groupby(["arm", "sweep"])["steps"].sum()
    costs = {cost.name: cost for cost in answer(store).costs}
    for decay, rate in itertools.product((0.01, 0.1), (0.1, 0.2)):
        own = f"learners.Q_full.learning_rate={rate}"
        apel = costs[f"APEL [arms.APEL.selector.decay={decay}, {own}]"]
        assert (apel.alone, apel.is_measured) == (steps["Q_full", own] + steps["SSBAS", ""], True)


def test_sweeps(play: Play) -> None:
    """Points that change a learner are candidates; points that change the task have an answer each."""
    tuned = compare(play(*AT_LENGTH, "sweep={learners.Q_full.learning_rate: [0.1, 0.2]}"), 0.05)
    assert [len(one.rankings[0].places) for one in tuned] == [6]
    assert "APEL [learners.Q_full.learning_rate=0.2]" in {place.name for place in tuned[0].rankings[0].places}
    tasks = compare(play(*AT_LENGTH, "sweep={environment.options.max_steps: [50, 100]}"), 0.05)
    assert [one.task for one in tasks] == [f"environment.options.max_steps={steps}" for steps in (50, 100)]
    assert all(len(one.rankings[0].places) == 3 for one in tasks)
    lines = answer_lines(tasks)
    assert "environment.options.max_steps=50:" in lines


def test_words(play: Play) -> None:
    """One screen of 80 columns, which claims no more than the rows say."""
    lines = answer_lines([answer(play(*AT_LENGTH))])
    assert max(map(len, lines)) <= 80
    assert len(lines) <= 30
    text = " ".join(lines)
    assert text.startswith("If you have to choose now, use ")
    assert "cannot be told apart" in text
    assert "6 runs cannot decide between 3; it takes at least 9." in text


@pytest.mark.parametrize("num_columns", [3, 6, 7, 9, 12])
def test_no_number_is_cut(num_columns: int) -> None:
    """Where a table is too wide, names are, and whole columns are left out: half of a number would be another one."""
    heads = ["in an_ensemble_of_many", *(f"heading {column}" for column in range(num_columns))]
    row = ["slow_wide", *(f"{10_000 + column:,}" for column in range(num_columns))]
    first, second = _columns(heads, [row])
    assert max(len(first), len(second)) <= 80
    numbers = second.split()[1:]
    assert numbers == row[1 : 1 + len(numbers)]
    assert len(numbers) >= min(num_columns, 6)
    assert first.split("  ")[0].strip().startswith("in an_en")


def test_decided_words(play: Play) -> None:
    """Where the runs decide, what to use is said first, with the error; one arm alone is no choice."""
    stuck = ["learners.Q_red={type: q_learning, learning_rate: 1e-9}", "runs=12", "episodes=120"]
    store = play(*stuck, "criterion=null", "arms={good: {learners: [Q_full]}, bad: {learners: [Q_red]}}")
    found = answer(store)
    text = " ".join(answer_lines([found]))
    assert text.startswith("Use good. It returns ")
    assert re.search(r"better than bad, the next, by [\d.]+ \([\d.]+ to [\d.]+\), run by run", text)
    assert "decided after 8 runs, at an error of 5 %" in text
    assert found.verdict is not None
    assert found.verdict.gap["bad"].low > 0
    alone = answer_lines([answer(play(*AT_LENGTH, "arms={APEL: {learners: [Q_full, Q_red], selector: {type: apel}}}"))])
    assert " ".join(alone).startswith("Only APEL has results. It returns")
    assert re.search(r"Of its learners Q_\w+ returned most", " ".join(alone))


def test_single_run(play: Play) -> None:
    """That all resamples of one run agree is no certainty, and is not told as one."""
    said = " ".join(answer_lines(compare(play(*AT_LENGTH, "seed=5", "runs=1"), 0.05, ["APEL"])))
    assert "returned most at the end (in a single run)." in said
    assert "100 %" not in said


def test_command(play: Play, capsys: pytest.CaptureFixture[str]) -> None:
    """`apel compare` prints the words, the report has them, and --json has all of it."""
    store = play(*AT_LENGTH)
    place = store.folder.location()
    lines = answer_lines([answer(store)])
    assert printed(capsys, "compare", place).splitlines() == lines
    content = json.loads(printed(capsys, "compare", place, "--json"))
    assert content == json.loads(answer_json(store.experiment(), [answer(store)]))
    first = content["answers"][0]["rankings"][0]["places"][0]
    assert set(first["estimate"]) == {"value", "low", "high"}
    assert 0 <= first["probability_best"] <= first["probability_near"] <= 1
    assert lines[0] in Path(write_report(store)).read_text()
    assert np.isfinite(first["estimate"]["value"])


def test_some_arms(play: Play, capsys: pytest.CaptureFixture[str]) -> None:
    """The error is shared among the comparisons of the arms that are asked for, and no other is spoken of."""
    store = play(*AT_LENGTH)
    place = store.folder.location()
    (found,) = compare(store, 0.05, ["Q_full", "APEL"])
    assert found.verdict is not None
    assert {one.name for one in found.rankings[0].places} == {one.name for one in found.costs} == {"Q_full", "APEL"}
    two = "arms={Q_full: {learners: [Q_full]}, APEL: {learners: [Q_full, Q_red], selector: {type: apel, decay: 0.01}}}"
    alike = play(*AT_LENGTH, two)  # another experiment, with the same rows of these arms
    assert found == answer(alike)
    assert found.verdict != answer(store).verdict
    assert printed(capsys, "compare", place, "--arms", "Q_full,APEL").splitlines() == answer_lines([found])
    assert not compare(store, 0.05, [])


def test_bad_input(play: Play, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is no folder of results, and an error that is no probability, are refused with one message."""
    assert called(capsys, "compare", str(tmp_path)).code == 2
    ended = called(capsys, "compare", play(*AT_LENGTH).folder.location(), "--error", "0.9")
    assert ended.code == 2
    assert "--error" in ended.err
    ended = called(capsys, "compare", play(*AT_LENGTH).folder.location(), "--error", "0.0004")
    assert ended.code == 2
    assert "--error: found 0.0004, expected more than 0.000488281 with 3 to be compared" in ended.err
    assert called(capsys, "compare", play(*AT_LENGTH).folder.location(), "--error", "0.0005").code == 0
    ended = called(capsys, "compare", play(*AT_LENGTH).folder.location(), "--arms", "APEL,SBAS")
    assert ended.code == 2
    assert "--arms: found 'SBAS', expected some of Q_full, APEL, SSBAS; did you mean SSBAS?" in ended.err
