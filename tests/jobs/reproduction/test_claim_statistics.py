"""Each statistic against numbers worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from jobs.analysis.statistics.bootstrap import bootstrap_interval
from jobs.experiment.spec_files import load_experiment
from jobs.reproduction.claims.resampled import CountedShare
from jobs.reproduction.claims.selection import Selection, UnknownNameError
from jobs.reproduction.claims.statistics import SUMMARIES, Sample, against_theory, measured
from jobs.reproduction.claims.theories import Setting, setting_of


def sample(*arms: list[list[float]], axis: list[float] | None = None) -> Sample:
    """Arms of runs of points."""
    values = np.stack([np.array(arm, dtype=np.float64) for arm in arms], axis=1)
    return Sample(values, np.array(axis if axis is not None else range(values.shape[2]), dtype=np.float64))


FIRST, SECOND = [[1.0], [3.0]], [[2.0], [6.0]]


@pytest.mark.parametrize(
    ("quantity", "expected"),
    [
        ("mean", 2.0),  # (1 + 3) / 2
        ("deviation", 2**0.5),  # ((1 − 2)² + (3 − 2)²) / 1
        ("difference", -2.0),  # 2 − 4
        ("ratio", 0.5),
        ("deviation_ratio", 0.5),  # √2 / √8
    ],
)
def test_quantities(quantity: str, expected: float) -> None:
    assert measured(sample(FIRST, SECOND), quantity, "only").value == pytest.approx(expected)


def test_median() -> None:
    """The runs are ordered alike in both arms, so the median of a resample is one of them: 1 − 0, 2 − 5 or 90 − 7."""
    found = measured(sample([[1.0], [2.0], [90.0]], [[0.0], [5.0], [7.0]]), "difference", "only", median=True)
    assert found.estimate == (-3, -3, 83)


@pytest.mark.parametrize(
    ("over", "values", "expected"),
    [
        ("smallest", [4.0, 2.0, 3.0], 2.0),
        ("largest", [4.0, 2.0, 3.0], 4.0),
        ("spread", [4.0, 2.0, 3.0], 2.0),
        ("rise", [4.0, 2.0, 3.0], -1.0),
        ("growth", [4.0, 2.0, 3.0], 0.75),
        ("gap", [0.9, 1.3, 1.0], 0.3),
        ("rising", [4.0, 2.0, 3.0], 0.5),  # one of two steps
        ("trend", [4.0, 2.0, 3.0], -0.5),  # ranks 3 1 2 against 1 2 3: 1 − 6 · 6 / 24
        ("slope", [4.0, 2.0, 3.0], -0.5),  # (−1 · 4 + 1 · 3) / 2
        ("relative_change", [4.0, 2.0, 3.0], -1 / 3),  # −0.5 · 2 / 3
        ("linearity", [4.0, 2.0, 3.0], 0.25),  # 0.5² · 2 of (1 + 1 + 0)
        ("linearity", [1.0, 2.0, 3.0], 1.0),
        ("trend", [5.0, 5.0, 5.0], 0.0),
        ("linearity", [5.0, 5.0, 5.0], 1.0),
    ],
)
def test_summaries(over: str, values: list[float], expected: float) -> None:
    assert float(SUMMARIES[over](np.array(values), np.array([0.0, 1.0, 2.0]))) == pytest.approx(expected)
    assert measured(sample([values, values]), "mean", over).estimate == pytest.approx((expected, expected, expected))


def test_pairs_are_resampled_as_pairs() -> None:
    """The second is one episode slower in every run, however much runs differ."""
    first = np.random.default_rng(1).exponential(1000, 50).round()[:, None]
    found = measured(sample(first.tolist(), (first + 1).tolist()), "difference", "only")
    assert found.estimate == pytest.approx((-1, -1, -1))


def test_interval_is_that_of_the_usual_bootstrap() -> None:
    """Counts of runs are another way of drawing the same resamples; two drawings differ by a little."""
    values = np.random.default_rng(2).exponential(100, 100)
    found = measured(sample(values[:, None].tolist()), "mean", "only")
    assert found.estimate[1:] == pytest.approx(bootstrap_interval(values), abs=0.8)


def test_a_ratio_to_nothing_says_nothing() -> None:
    found = measured(sample([[1.0], [2.0]], [[3.0], [3.0 + 1e-9]]), "deviation_ratio", "only").estimate
    assert (found.low, found.high) == (-np.inf, np.inf)


def at_decay(nu: float) -> Setting:
    """One point whose axis is the decay."""
    return Setting(np.array([nu]), np.array([nu]))


@pytest.mark.parametrize(
    ("theory", "expected"),
    [
        ("concentration_formula", 9.0),  # 1 / 0.1 − 1
        ("concentration_model", 8.0),  # 1 / 0.1 − 2
        ("adaptation_formula", 6.04),  # ln(9 / 17) / ln 0.9
    ],
)
def test_theory_by_decay(theory: str, expected: float) -> None:
    found = against_theory(sample([[20.0], [20.0]], axis=[0.1]), "theory_difference", "only", theory, at_decay(0.1))
    assert found.value == pytest.approx(20 - expected, abs=0.005)


def test_theory_of_performance() -> None:
    """Explored 1 / (9 + 1) of the time by the formula, 0.1 / 0.9 by the model: −2 + share · (−100 + 2)."""
    learners = sample([[-12.0]], [[-2.0]], [[-100.0]], axis=[0.1])
    formula = against_theory(learners, "theory_ratio", "only", "performance_formula", at_decay(0.1))
    assert formula.value == pytest.approx(-12 / (-2 - 9.8))
    model = against_theory(learners, "theory_ratio", "only", "performance_model", at_decay(0.1))
    assert model.value == pytest.approx(-12 / (-2 - 98 / 9))


def test_theory_of_growth_counts_from_the_switch() -> None:
    """The first episode after the switch of the experiment, at 1000, with the decay of its arm: (1 + 1) · 0.99; with
    another switch and another decay, two episodes after it: ((1 + 1) · 0.5 + 1) · 0.5.
    """
    for overrides, episode, expected in (
        ([], 1001, 1.98),
        (["criterion.after=900", "arms.APEL.selector.decay=0.5"], 902, 1.0),
    ):
        experiment = load_experiment("adaptation-behaviour", overrides)
        here = sample([[expected]], axis=[episode])
        setting = setting_of(experiment, Selection("concentration", ["APEL"], {}), here.axis, "criterion.after")
        found = against_theory(here, "theory_ratio", "only", "growth_formula", setting)
        assert found.value == pytest.approx(1)


def test_decays_are_those_of_the_sweep() -> None:
    """As the axis, whatever its places are called, or at the one value that rows are picked by."""
    labelled = "sweep={reading: {label: [slow, quick], arms.APEL.selector.decay: [0.25, 0.5]}, episodes: [1000, 2000]}"
    experiment = load_experiment("selection-behaviour", [labelled])
    selection = Selection("steady_state", ["APEL"], {"reading": "quick"}, axis="episodes")
    found = setting_of(experiment, selection, np.array([1000.0, 2000.0]), None)
    assert found.decays.tolist() == [0.5, 0.5]
    steady = load_experiment("steady-state")
    points = np.array([0.1, 0.001])
    assert setting_of(steady, Selection("x", ["APEL_bad"], {}, axis="decay"), points, None).decays.tolist() == [
        0.1,
        0.001,
    ]
    with pytest.raises(UnknownNameError, match="found several decays, expected 'decay' in where or as the axis"):
        setting_of(steady, Selection("x", ["APEL_bad"], {}), np.array([0.0]), None)
    with pytest.raises(UnknownNameError, match=r"found None as arms\.SSBAS\.selector\.decay of distractor-maze"):
        setting_of(load_experiment("distractor-maze"), Selection("x", ["SSBAS"], {}), np.array([0.0]), None)
    with pytest.raises(UnknownNameError, match=r"found None as criterion\.after of selection-behaviour"):
        setting_of(load_experiment("selection-behaviour"), Selection("x", ["APEL"], {}), points, "criterion.after")


def test_measured_adaptation_time_needs_lengths() -> None:
    """An experiment without a criterion over lengths states none."""
    setting = setting_of(load_experiment("selection-behaviour"), Selection("x", ["APEL"], {}), np.array([0.1]), None)
    with pytest.raises(UnknownNameError, match="does not state how long its learners' episodes are"):
        against_theory(sample([[1.0]], axis=[0.1]), "theory_ratio", "only", "adaptation_window_model", setting)


def test_share() -> None:
    """All of 100: the lower end is 0.025^(1/100); 1 of 2: where the tails are 0.025, 1 − √0.975 and √0.975."""
    assert CountedShare([True] * 100).estimate == pytest.approx((1, 0.025 ** (1 / 100), 1))
    assert CountedShare([True, False]).estimate == pytest.approx((0.5, 1 - 0.975**0.5, 0.975**0.5))
