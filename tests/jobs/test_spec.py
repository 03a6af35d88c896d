"""What an experiment file means. What it may not say is in test_bad_input.py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from apel.metrics import Criterion, Threshold
from jobs.spec import load_experiment, set_path, shipped_experiments, validate
from jobs.validation import check
from jobs.yaml_source import SpecError, parse
from tests.conftest import SMALL


@pytest.mark.parametrize("name", shipped_experiments())
def test_shipped_experiments_are_valid(name: str) -> None:
    """Every experiment that comes along can be built, and is called as its file."""
    experiment = load_experiment(name)
    check(experiment)
    assert experiment.name == name
    assert experiment.figures


def test_main_experiment_is_that_of_the_text() -> None:
    """The settings of Figures 4.7 and 4.8 (§4.3.1)."""
    experiment = load_experiment("distractor-maze")
    assert (experiment.seed, experiment.runs, experiment.episodes) == (1234, 100, 5000)
    assert list(experiment.arms) == ["Q_full", "Q_red", "APEL", "SSBAS"]
    assert experiment.criterion == Criterion("length", 50, below=Threshold(1.1, "optimal_length"))
    assert experiment.arms["APEL"].selector is not None
    assert experiment.arms["APEL"].selector.options == {"decay": 0.01}
    assert experiment.arms["SSBAS"].selector is not None
    assert experiment.arms["SSBAS"].selector.options == {"exploration": 4.921}
    assert experiment.environment.options == {"distractors": [10], "optimal_length": [33, 35]}


def test_yaml_round_trip() -> None:
    """An experiment that is written and read again is the same."""
    experiment = validate(parse(SMALL, "small.yaml"))
    again = validate(parse(experiment.to_yaml(), "again.yaml"))
    assert again.model_dump() == experiment.model_dump()
    assert again.identity == experiment.identity


@given(st.integers(0, 2**31), st.integers(1, 10**6), st.floats(0, 0.999), st.booleans())
def test_round_trip_of_any_values(seed: int, episodes: int, decay: float, stop: bool) -> None:
    """Whatever numbers stand in it."""
    source = parse(SMALL, "small.yaml")
    for path, value in (
        ("seed", seed),
        ("episodes", episodes),
        ("arms.APEL.selector.decay", decay),
        ("stop_when_met", stop),
    ):
        set_path(source.content, path, value)
    experiment = validate(source)
    assert validate(parse(experiment.to_yaml(), "again.yaml")).model_dump() == experiment.model_dump()


def test_identity_is_stable() -> None:
    """The identity of a spec is part of every path: it changes only when the meaning of the spec does."""
    assert load_experiment("distractor-maze").identity == "07d952f82b2f"


@pytest.mark.parametrize(
    ("path", "value", "expected"),
    [
        ("a.b", 3, {"a": {"b": 3}, "list": [1, 2]}),
        ("new.deep.path", 1, {"a": {}, "list": [1, 2], "new": {"deep": {"path": 1}}}),
        ("list.1", 9, {"a": {}, "list": [1, 9]}),
    ],
)
def test_set_path(path: str, value: Any, expected: Any) -> None:
    """Fields are set by dotted path, list entries by number."""
    content: dict[str, Any] = {"a": {}, "list": [1, 2]}
    set_path(content, path, value)
    assert content == expected


def test_errors_are_all_told(small: Path) -> None:
    """Several errors are several lines."""
    with pytest.raises(SpecError) as caught:
        load_experiment(str(small), ["runs=0", "seed=-1"])
    assert len(str(caught.value).splitlines()) == 2
