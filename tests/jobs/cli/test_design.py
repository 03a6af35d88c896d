"""`apel design`: ν by two theories, what each expects, and one clear error where that makes no sense."""

from __future__ import annotations

import pytest

from apel.theory import closed_forms, selection_aware
from jobs.cli.design import DISSERTATION, SELECTION_AWARE, SIMULATED, DecayPrediction, Request, advice, design
from jobs.experiment.yaml_source import SpecError
from tests.command_line import call, printed


def rows_of(request: Request) -> dict[tuple[str, str], DecayPrediction]:
    """Predictions by who chose the ν and who predicts."""
    return {(row.decay_by, row.predicted_by): row for row in design(request)}


@pytest.mark.parametrize(
    ("request_", "field", "wanted"),
    [
        (Request(adapt_within=300.0), "adaptation_time", 300.0),
        (Request(rise_within=100.0, num_learners=5), "rise_time", 100.0),
        (Request(explore=0.05, num_learners=3), "exploration", 0.05),
        (Request(performance=-3.5, best_return=-2.3, other_returns=(-100.0,), num_learners=4), "performance", -3.5),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_each_theory_meets_the_criterion_by_its_own_decay(request_: Request, field: str, wanted: float) -> None:
    """Where one theory both chooses ν and predicts, the criterion is met; at the other's ν it is missed."""
    rows = rows_of(request_)
    assert len(rows) == 4
    for theory in (DISSERTATION, SELECTION_AWARE):
        assert getattr(rows[theory, theory], field) == pytest.approx(wanted, rel=1e-4)
    assert getattr(rows[DISSERTATION, SELECTION_AWARE], field) != pytest.approx(wanted, rel=1e-3)


def test_predictions_are_the_theories_own() -> None:
    """Every column comes from the theory that the row names."""
    rows = rows_of(Request(explore=0.05, best_return=1.0, other_returns=(0.0, -1.0), num_learners=3))
    aware, text = rows[DISSERTATION, SELECTION_AWARE], rows[SELECTION_AWARE, DISSERTATION]
    assert aware.adaptation_time == selection_aware.adaptation_time(aware.decay, 3)
    assert aware.rise_time == selection_aware.rise_time(aware.decay, 3)
    assert aware.performance == selection_aware.steady_state_performance(aware.decay, 1.0, [0.0, -1.0])
    assert text.adaptation_time == closed_forms.adaptation_time(text.decay)
    assert text.rise_time == closed_forms.rise_time(text.decay)
    assert text.performance == closed_forms.steady_state_performance(text.decay, 1.0, [0.0, -1.0])


def test_one_return_stands_for_all_others() -> None:
    """A single --other-return is every other learner's."""
    one = Request(performance=0.9, best_return=1.0, other_returns=(0.0,), num_learners=4)
    all_three = Request(performance=0.9, best_return=1.0, other_returns=(0.0, 0.0, 0.0), num_learners=4)
    assert design(one) == design(all_three)


def test_advice() -> None:
    """It names the ν to take, the numbers to trust, and a ν at which nobody keeps a lead."""
    assert advice(design(Request(explore=0.05)), 2)[0] == "take ν = 0.04762 (selection-aware)"
    assert "at ν = 0.4286 nobody keeps a lead" in advice(design(Request(explore=0.6, num_learners=3)), 3)[-1]


def test_noise_and_floor() -> None:
    """They take the place of the selection-aware model: more is explored, and the ν for a share of it is smaller."""
    rows = rows_of(Request(explore=0.05, num_learners=4, win_probability=0.7))
    assert rows[SIMULATED, SIMULATED].exploration == pytest.approx(0.05, rel=0.01)
    assert rows[DISSERTATION, SIMULATED].exploration > 0.11
    assert rows[SIMULATED, SIMULATED].decay < 0.5 * rows[DISSERTATION, DISSERTATION].decay
    penalised = Request(performance=-20.0, best_return=-10.0, other_returns=(-100.0,), win_probability=0.9)
    assert rows_of(penalised)[SIMULATED, SIMULATED].performance == pytest.approx(-20.0, rel=1e-2)
    wish = Request(performance=0.9, best_return=1.0, other_returns=(0.0,), floor=0.05)
    assert rows_of(wish)[SIMULATED, SIMULATED].performance == pytest.approx(0.9, rel=1e-3)
    assert advice(list(rows.values()), 4)[0].endswith("(simulation)")


def test_command(capsys: pytest.CaptureFixture[str]) -> None:
    """The table shows both ν, and the text says which number to trust."""
    shown = printed(capsys, "design", "--explore", "0.05", "--best-return", "1", "--other-return", "0")
    for expected in ("0.05 ", "0.04762", "0.05263", "performance", "take ν = 0.04762", "trust the rows"):
        assert expected in shown


BAD = {
    "nothing wanted": ("", "found none, expected exactly one of --adapt-within, --rise-within, --explore"),
    "two things wanted": ("--explore .05 --rise-within 9", "found --rise-within and --explore, expected exactly one"),
    "explores too much": ("--explore 0.9", "--explore: exploration: found 0.9, expected above 0 and at most"),
    "explores never": ("--explore 0", "--explore: exploration: found 0.0, expected above 0"),
    "adapts before chance": ("--adapt-within 3 --learners 20", "found 3, expected at least 19.1: no decay is faster"),
    "negative time": ("--adapt-within -3", "--adapt-within: episodes: found -3.0"),
    "time no number": ("--rise-within nan", "--rise-within: episodes: found nan"),
    "word": ("--explore often", "--explore"),
    "no noise at all": ("--explore .1 --win-probability .5", "--win-probability: found 0.5, expected above 0.5"),
    "floor too high": ("--explore .1 --learners 4 --floor .3", "--floor: found 0.3, expected at least 0 and below 1/n"),
    "floor above the wish": ("--explore .05 --floor .1", "--explore: found 0.05, expected 0.10"),
    "many in noise": (
        "--explore .1 --learners 21 --floor .01",
        "--learners: found 21, expected at most 20 where chains",
    ),
    "one learner": ("--explore .1 --learners 1", "--learners"),
    "no returns": ("--performance 3", "expected both returns"),
    "one return only": ("--explore .1 --best-return 3", "expected both returns"),
    "performance too high": (
        "--performance 3 --best-return 1 --other-return 0",
        "--performance: performance: found 3.0, expected at least 0.5",
    ),
    "best is not best": ("--explore .1 --best-return 0 --other-return 1", "best_return: found 0.0, expected above"),
    "returns miscounted": (
        "--performance .9 --best-return 1 --other-return 0 --other-return 0 --learners 4",
        "--other-return: found 2, expected 1, or one per other learner, 3",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """One clear error, exit code 2."""
    arguments, expected = BAD[name]
    code, error = call(capsys, "design", *arguments.split())
    assert code == 2
    assert expected in error
    assert "Traceback" not in error


def test_errors_are_spec_errors() -> None:
    """From Python they are what every bad input is."""
    with pytest.raises(SpecError, match="expected exactly one"):
        design(Request())


TOO_LARGE = {
    "explores almost never": (Request(explore=1e-300), "--explore: found a wish that takes a decay of 1e-300, exp"),
    "explores with no float's decay": (Request(explore=1e-308), "--explore: found a wish that takes a decay of 1e-308"),
    "adapts within ages": (Request(adapt_within=1e300), r"--adapt-within: found 1e\+300 episodes, expected at most"),
    "rises within ages": (Request(rise_within=1e6), r"--rise-within: found 1e\+06 episodes, expected at most 50,000"),
    "crowd": (Request(explore=0.1, num_learners=10**9), "--learners: found 1,000,000,000, expected at most 100"),
}


@pytest.mark.parametrize("name", TOO_LARGE)
def test_what_would_be_sought_for_hours_is_refused(name: str) -> None:
    """The time that a model takes grows with 1/ν and with the learners."""
    request, expected = TOO_LARGE[name]
    with pytest.raises(SpecError, match=expected):
        design(request)
