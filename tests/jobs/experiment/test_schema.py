"""The schema for editors knows what the program knows: what it refuses is refused, and whatever comes along passes."""

from __future__ import annotations

import json
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from apel.building.registry import LEARNERS, SELECTORS
from jobs.experiment.paths import set_path
from jobs.experiment.plan import Plan
from jobs.experiment.schema import experiment_schema
from jobs.experiment.spec import Experiment, validate
from jobs.experiment.spec_files import shipped_experiments
from jobs.experiment.validation import check
from jobs.experiment.yaml_source import SpecError, parse
from tests.command_line import printed
from tests.experiments import SMALL


@pytest.fixture(scope="module")
def schema() -> dict[str, Any]:
    return experiment_schema()


def alternatives(schema: dict[str, Any], kind: str) -> dict[str, Any]:
    return {one["title"]: one for one in schema["$defs"][kind]["oneOf"]}


def test_shipped_experiments_pass(schema: dict[str, Any]) -> None:
    """Every experiment that comes along, and one with variables."""
    Draft202012Validator.check_schema(schema)
    judge = Draft202012Validator(schema)
    for name, text in {**shipped_experiments(), "small": SMALL}.items():
        judge.validate(parse(text, name).content)


def test_knows_every_field_and_option(schema: dict[str, Any]) -> None:
    """Fields, learners and selectors are those that there are, with the options and what is said of them."""
    assert set(schema["properties"]) == set(Experiment.model_fields)
    assert set(alternatives(schema, "LearnerSpec")) == {*LEARNERS, "by import path"}
    selectors = alternatives(schema, "SelectorSpec")
    assert set(selectors) == {*SELECTORS, "by import path"}
    decay = selectors["apel_margin"]["properties"]["decay"]
    assert (decay["default"], decay["exclusiveMaximum"]) == (0.01, 1.0)
    assert decay["description"].startswith("ν, 0 ≤ ν < 1: the share of each concentration that is forgotten")
    assert "prior:" not in decay["description"]
    dqn = alternatives(schema, "LearnerSpec")["dqn"]["properties"]
    assert dqn["replay_size"]["description"].startswith("Transitions that are remembered")
    assert "preset" in alternatives(schema, "LearnerSpec")["acer"]["properties"]
    assert "algorithm" in alternatives(schema, "LearnerSpec")["stable_baselines"]["properties"]
    assert "CartPole-v1" in schema["$defs"]["EnvironmentSpec"]["properties"]["id"]["anyOf"][0]["enum"]


BAD = {
    "episods": 3,
    "runs": 0,
    "environment.ide": "x",
    "learners.Q_full.type": "sarsa",
    "learners.Q_full.lerning_rate": 0.1,
    "learners.Q_full.learning_rate": 2.0,
    "learners.Q_full.exploration": {"start": 1.0, "end": 0.1},
    "learners.Q_red.representation.exclud": ["x"],
    "arms.APEL.selector.type": "best",
    "arms.APEL.selector.decay": 1.5,
    "arms.APEL.selector.nu": 0.5,
    "criterion.below.factr": 1.1,
    "performance": "profit",
    "record": "some",
    "plots": [{"kind": "bar", "name": "x"}],
}


@pytest.mark.parametrize("path", BAD)
def test_refuses_what_is_refused(path: str, schema: dict[str, Any]) -> None:
    """What the schema marks is no experiment."""
    source = parse(SMALL, "small.yaml")
    set_path(source.content, path, BAD[path])
    assert not Draft202012Validator(schema).is_valid(source.content)
    with pytest.raises(SpecError):
        check(Plan.of(validate(source)))


def test_one_s_own_parts_pass(schema: dict[str, Any]) -> None:
    """Import paths take any option; variables stand wherever an option may."""
    source = parse(SMALL, "small.yaml")
    for path, value in {
        "learners.Q_full": {"type": "mine:Learner", "anything": [1]},
        "learners.Q_red.learning_rate": "$rate",
        "learners.Q_red.exploration": {"start": "$rate", "end": 0.1, "steps": 100},
        "arms.APEL.selector": {"type": "mine:Rule", "anything": 1},
        "environment.id": "mine:make",
        "performance": "mine:measure",
    }.items():
        set_path(source.content, path, value)
    Draft202012Validator(schema).validate(source.content)


def test_every_field_is_explained(schema: dict[str, Any]) -> None:
    """Editors and the reference say what each field means, or the sentence about its part names it."""
    parts = [schema, *(kind for part in schema["$defs"].values() for kind in part.get("oneOf", [part]))]
    unexplained = {
        f"{part.get('title')}.{field}"
        for part in parts
        for field, about in part.get("properties", {}).items()
        if field != "type" and not about.get("description") and field not in part.get("description", "")
    }
    assert not unexplained


def test_command(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """It prints JSON; without PyTorch, too, where deep learners then take any option."""

    def load(path: str) -> Any:
        message = f"found the import path {path!r}, but importing it failed: no module named torch"
        raise ValueError(message)

    monkeypatch.setattr("jobs.experiment.schema.load", load)
    printed_schema = json.loads(printed(capsys, "schema"))
    assert alternatives(printed_schema, "LearnerSpec")["dqn"]["additionalProperties"] is True
    assert alternatives(printed_schema, "LearnerSpec")["q_learning"]["additionalProperties"] is False
