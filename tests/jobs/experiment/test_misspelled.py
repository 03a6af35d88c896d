"""Names that are nearly right: said once, where they were written, with what was probably meant."""

from __future__ import annotations

import pytest

from jobs.experiment.spec_files import load_experiment
from jobs.experiment.yaml_source import SpecError


def lines_of(*overrides: str) -> list[str]:
    """What is wrong with the main experiment after some options."""
    with pytest.raises(SpecError) as caught:
        load_experiment("distractor-maze", overrides)
    return str(caught.value).splitlines()


def test_missing_for_it_is_misspelled() -> None:
    """The field whose name was meant is not also said to be missing; another one is."""
    (line,) = lines_of("criterion.below={factr: 1.1, info: optimal_length}")
    assert line.endswith("criterion.below.factr: found a field that does not exist here; did you mean factor?")
    assert [line.split(": ")[-2] for line in lines_of("criterion.below={factr: 1.1}")] == [
        "criterion.below.info",
        "criterion.below.factr",
    ]


@pytest.mark.parametrize(
    ("override", "place", "meant"),
    [
        ("arms.APL.selector.decay=0.1", "arms.APL.learners", "APEL"),
        ("learners.Q_ful.learning_rate=0.2", "learners.Q_ful.type", "Q_full"),
    ],
)
def test_option_made_something_new(override: str, place: str, meant: str) -> None:
    """The option is blamed that has made an incomplete arm or learner, not a line of the file that is as it was."""
    first = lines_of(override)[0]
    assert first == f"--set {override}: {place}: found nothing, expected this field to be given; did you mean {meant}?"


def test_several_options() -> None:
    """All of them are named."""
    options = ["arms.new.selector.decay=0.1", "arms.new.selector.type=apel"]
    first = lines_of(*options)[0]
    assert first.startswith(f"--set {options[0]} and --set {options[1]}: arms.new.learners: ")
    assert "did you mean" not in first
