"""An experiment that is written and read again is the same: its fields, its identity, its plan."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jobs.experiment.plan import Plan
from jobs.experiment.run_plans import arm_plan, run_plan
from jobs.experiment.spec import Experiment, validate
from jobs.experiment.spec_files import load_experiment, shipped_experiments
from jobs.experiment.validation import check
from jobs.experiment.yaml_source import SpecError, parse
from tests.cases import FOLDER
from tests.conftest import SMALL
from tests.jobs.experiment.test_yaml import TREES


def planned(experiment: Experiment) -> list[str]:
    """All that is sent to those who play the first run of every arm and sweep point."""
    plan = Plan.of(experiment)
    return [repr((arm_plan(one), run_plan(one, 0, plan.seeds[0]))) for one in plan.arm_points]


def assert_same(experiment: Experiment) -> None:
    """Written and read once and twice, it is the same."""
    again = validate(parse(experiment.to_yaml(), "again.yaml"))
    assert again.model_dump() == experiment.model_dump()
    assert again.identity == experiment.identity
    assert again.to_yaml() == experiment.to_yaml()
    assert planned(again) == planned(experiment)


@pytest.mark.parametrize("name", shipped_experiments())
def test_shipped_experiments(name: str) -> None:
    """Every experiment that comes along."""
    assert_same(load_experiment(name))


SOURCE = parse(SMALL, "small.yaml")


@given(option=TREES, environment=TREES, values=st.lists(TREES, min_size=1, max_size=3), swept=TREES)
def test_any_values(option: Any, environment: Any, values: list[Any], swept: Any) -> None:
    """Whatever plain values stand where they may."""
    source = replace(SOURCE, content=copy.deepcopy(SOURCE.content))
    source.content["learners"]["Q_full"]["option"] = option
    source.content["environment"]["options"]["option"] = environment
    source.content["variables"]["more"] = values
    source.content["sweep"] = {"axis": {"learners.Q_red.option": [swept, option], "label": ["a", "b"]}}
    if "$" not in repr((option, environment, swept)):
        assert_same(validate(source))


@pytest.mark.parametrize("sweep", ["", "sweep: {episodes: [5, 6]}\n", "sweep: {learners.A.trust_region: [null, {}]}\n"])
def test_null_that_is_an_option_stays_one(sweep: str) -> None:
    """``trust_region: null`` means: none; alone, with any sweep, and from the stored file."""
    text = SMALL.replace("arms:", "  A: {type: acer, trust_region: null}\narms:\n  A: {learners: [A]}") + sweep
    experiment = validate(parse(text, "small.yaml"))
    again = validate(parse(experiment.to_yaml(), "spec.yaml"))
    assert again.identity == experiment.identity
    for one in (experiment, again):
        point = Plan.of(one).only(["A"]).arm_points[0]
        assert run_plan(point, 0, 1).learners[0].options == {"trust_region": None}


def test_identity_counts_a_null() -> None:
    """An option that is null is not an option that is not there."""
    with_null = SMALL.replace("Q_full: {type: q_learning}", "Q_full: {type: q_learning, discount: null}")
    assert validate(parse(with_null, "a.yaml")).identity != validate(parse(SMALL, "a.yaml")).identity
    infinite = [validate(parse(with_null.replace("null", value), "a.yaml")).identity for value in ("null", ".inf", "1")]
    assert len(set(infinite)) == 3


def test_misspelt_option_with_null_is_refused_in_a_sweep(small: Path) -> None:
    """A null does not make a wrong name right."""
    swept = load_experiment(str(small), ["sweep={learners.Q_full.discuont: [null, 1]}"])
    with pytest.raises(SpecError, match="found the option 'discuont', which it does not have"):
        check(Plan.of(swept))


@pytest.mark.parametrize("value", [{1, 2}, b"x", 2**64, float("nan"), {"deep": [{1: 2}]}])
def test_options_that_no_file_can_hold(value: Any) -> None:
    """From Python too: a set's order, and with it the identity, would differ from process to process."""
    content = copy.deepcopy(SOURCE.content)
    content["learners"]["Q_full"]["option"] = value
    with pytest.raises(SpecError, match=r"learners\.Q_full\.option: "):
        validate(replace(SOURCE, content=content))


def test_setting_what_an_alias_stands_for_sets_one_place() -> None:
    """tests/cases/yaml-alias: with ``--set`` for learner a, learner b keeps its own; so it does in a sweep."""
    path, field = str(FOLDER / "yaml-alias" / "spec.yaml"), "learners.a.exploration.start"
    changed = load_experiment(path, [f"{field}=0.3"])
    assert [changed.learners[name].options["exploration"]["start"] for name in "ab"] == [0.3, 1.0]
    swept = Plan.of(load_experiment(path, [f"sweep={{{field}: [0.3, 0.4]}}"])).arm_points
    assert [(one.arm, one.point.label) for one in swept] == [("a", f"{field}=0.3"), ("a", f"{field}=0.4"), ("b", "")]
    assert {one.point.experiment.learners["b"].options["exploration"]["start"] for one in swept} == {1.0}


def test_drawn_values_are_copies(small: Path) -> None:
    """What a run's learners get of a variable, they may change without changing it for others."""
    overrides = ["variables.table=[[1, 2]]", "learners.Q_full.table=$table", "learners.Q_red.table=$table"]
    point = Plan.of(load_experiment(str(small), overrides)).only(["APEL"]).arm_points[0]
    first, second = (learner.options["table"] for learner in run_plan(point, 0, 1).learners)
    first.append(3)
    assert second == [1, 2]


@pytest.mark.parametrize("overrides", [[], ["learners.mine.learning_rate=1e-3", "learners.shipped.learning_rate=1e-3"]])
def test_exponents_are_numbers(overrides: list[str]) -> None:
    """tests/cases/exponent: ``1e-3`` is .001 for learners of ours and of the user's, in the file and in ``--set``."""
    experiment = load_experiment(str(FOLDER / "exponent" / "spec.yaml"), overrides)
    rates = [run_plan(one, 0, 1).learners[0].options["learning_rate"] for one in Plan.of(experiment).arm_points]
    assert rates == [0.001, 0.001]
    assert load_experiment(
        str(FOLDER / "exponent" / "spec.yaml"), ["environment.options.wind=1e-2"]
    ).environment.options == {"wind": 0.01}
