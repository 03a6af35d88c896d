"""How much an experiment may ask for, and which names it may give: refused at once, in one line that says where."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from jobs.experiment.plan import Plan
from jobs.experiment.spec_files import load_experiment
from jobs.experiment.validation import check
from jobs.experiment.yaml_source import SpecError
from tests.command_line import call
from tests.conftest import SMALL

GRID = "sweep={" + ", ".join(f"a{i}: {{arms.APEL.selector.x{i}: [1, 2, 3, 4]}}" for i in range(40)) + "}"
TOO_LARGE = {
    "runs": (["runs=1e8"], "runs: found 100000000, expected less than or equal to 100000"),
    "runs of all arms": (
        ["runs=100000", "sweep={episodes: [5, 6, 7, 8, 9]}"],
        "runs: found 1,500,000 runs over all arms and sweep points, expected at most 1,000,000",
    ),
    "episodes": (["episodes=1e30"], "episodes: found 1e+30, expected a whole number"),
    "episodes in digits": (["episodes=1" + "0" * 30], "episodes: found 10000000000000000000"),
    "many episodes": (["episodes=10000001"], "episodes: found 10000001, expected less than or equal to 10000000"),
    "fraction": (["runs=1.5"], "runs: found 1.5, expected a whole number"),
    "truth": (["runs=true"], "runs: found True, expected a whole number"),
    "text": (["runs=1_000"], "runs: found '1_000', expected a whole number"),
    "seed": (["seed=1e20"], "seed: found 1e+20, expected a whole number"),
    "grid": ([GRID], "sweep: found 10^24 or more sweep points of one arm, expected at most 1,000"),
    "axis": ([f"sweep={{episodes: {list(range(1, 1002))}}}"], "sweep: found 1,001 sweep points of one arm"),
    "copies of a learner": (["arms.APEL.learners={Q_full: 1000000000}"], "arms.APEL.learners.Q_full: found 1000000000"),
    "copies of two": (["arms.APEL.learners={Q_full: 600, Q_red: 600}"], "arms.APEL: found 1,200 learners"),
    "maze": (["environment.options.distractors=[10000000]"], "which makes 250,000,000 states, expected at most"),
    "mazes that do not fit": (
        ["environment.options={size: 900, optimal_length: [1, 2]}"],
        "none of 12 mazes of 900x900 cells has an optimal length",
    ),
    "bins": (
        ["learners.Q_red.representation={bins: [{low: 0, high: 1, count: 1000000000}]}"],
        "representation: bins.0.count: found 1000000000, expected less than or equal to 1000000",
    ),
    "stack": (["learners.Q_red.representation={stack: 100000}"], "stack: found 100000, expected less than or equal"),
    "memory": (
        ["learners.Q_full={type: dqn, replay_size: 1e9}"],
        "replay_size: found 1000000000, expected less than",
    ),
    "network": (
        ["learners.Q_full={type: dqn, network: {hidden: [100000, 100000]}}"],
        "network: found 10,051,701,797 parameters, expected at most 10,000,000",
    ),
    "path": ([f"environment.options{'.a' * 200}=1"], "found more than 50 levels"),
    "selector's value": (["arms.APEL.selector.decay=.inf"], "decay: found inf, expected"),
    "criterion's value": (["criterion.below=.inf"], "criterion.below: found inf, expected a finite number"),
}


@pytest.mark.parametrize("name", TOO_LARGE)
def test_too_large(name: str, small: Path) -> None:
    """Refused before anything is built of it: in two seconds, the import of what it names apart."""
    overrides, expected = TOO_LARGE[name]
    if "dqn" in repr(overrides):
        pytest.importorskip("torch")
        import apel.learners.deep.dqn  # noqa: F401
    began = time.process_time()
    with pytest.raises(SpecError) as caught:
        check(Plan.of(load_experiment(str(small), overrides)))
    assert expected in str(caught.value)
    assert "--set " in str(caught.value)
    assert time.process_time() - began < 2.0


LARGE = {
    "whole floats": ["runs=1e2", "episodes=1e3"],
    "an axis for each arm": [
        "sweep={a: {arms.APEL.selector.decay: "
        + str([i / 2000 for i in range(1, 300)])
        + "}, b: {arms.SSBAS.selector.exploration: "
        + str(list(range(1, 300)))
        + "}}"
    ],
    "copies": ["arms.APEL.learners={Q_full: 1000}"],
    "rates": ["sweep={learners.Q_full.learning_rate: " + str([i / 2000 for i in range(1, 900)]) + "}"],
    "variables": [f"variables.v{i}={list(range(50))}" for i in range(60)],
}


@pytest.mark.parametrize("name", LARGE)
def test_large_is_valid_soon(name: str, small: Path) -> None:
    """What is large, and not too large, is validated in two seconds; what has no time to be built is counted."""
    began = time.process_time()
    trial = check(Plan.of(load_experiment(str(small), LARGE[name])))
    assert time.process_time() - began < 2.5
    assert trial.num_built > 3


def test_axes_of_other_arms_do_not_count(small: Path) -> None:
    """The arms of two axes of 299 places are 299 + 299 + 1, not 299 × 299."""
    assert len(Plan.of(load_experiment(str(small), LARGE["an axis for each arm"])).arm_points) == 299 + 299 + 1


NAMES = {
    "variable is a column": (["variables.seed=[1, 2]"], "variables.seed: found the name of a column of the results"),
    "in capitals": (["variables.Run_Index=[1, 2]"], "variables.Run_Index: found the name of a column of the results"),
    "axis is a column": (["sweep={steps: {episodes: [5, 6]}}"], "sweep.steps: found the name of a column"),
    "axis is a variable": (["sweep={dropped: {episodes: [5, 6]}}"], "sweep.dropped: found the name of another one in"),
    "variable is reported": (
        ["variables.optimal_length=[1]"],
        "variables.optimal_length: found the name of a number th",
    ),
    "axis is reported": (
        ["sweep={optimal_length: {episodes: [70]}}"],
        "sweep.optimal_length: found the name of a number",
    ),
    "filter by what runs came to": (
        ["sweep={episodes: [70, 80]}", "plots=[{kind: bars, name: x, where: {episodes: [70]}}]"],
        "plots.0.where: found 'episodes', expected an axis with another name",
    ),
    "arms that are one number": (
        ['arms={"1": {learners: [Q_full]}, "01": {learners: [Q_red]}}'],
        "arms.01: found the number that '1' is too",
    ),
    "arms that are one fraction": (
        ['arms={"1.0": {learners: [Q_full]}, "1.00": {learners: [Q_red]}}'],
        "arms.1.00: found the number that '1.0' is too",
    ),
    "integer that no column holds": (["variables.v=[18446744073709551616]"], "variables.v.0: found 184467440737095516"),
    "key that is no text": (["variables.v=[{1: 2}]"], "variables.v.0: found the key 1, expected text"),
    "axis without a name": (['sweep={"": {episodes: [5, 6]}}'], "sweep: found an axis without a name"),
    "axis of labels alone": (["sweep={a: {label: [x]}}"], "sweep: a: found nothing but labels"),
    "label with a line end": (['sweep={a: {episodes: [5], label: ["a\\nb"]}}'], r"sweep: a: found the label 'a\nb'"),
    "title": (['title="a\\nb"'], r"title: found 'a\nb', expected text without control characters"),
}


@pytest.mark.parametrize("name", NAMES)
def test_names(name: str, small: Path) -> None:
    """Names that would be lost or confused in the results are refused before anything is played."""
    overrides, expected = NAMES[name]
    with pytest.raises(SpecError) as caught:
        check(Plan.of(load_experiment(str(small), overrides)))
    assert expected in str(caught.value)


FIELDS = {
    "criterion.below.factr=1": "criterion.below.factr: found a field that does not exist here; did you mean factor?",
    "criterion.windw=1": "criterion.windw: found a field that does not exist here; did you mean window?",
    "episods=1": "episods: found a field that does not exist here; did you mean episodes?",
    "environment.zzz=1": "environment.zzz: found a field that does not exist here, expected id, options, run_seed, ",
    "arms.APEL.lerners=[x]": "arms.APEL.lerners: found a field that does not exist here; did you mean learners?",
    "plots=[{kind: bars, name: x, metrc: y}]": "plots.0.metrc: found a field that does not exist here; did you mean me",
    "plots=[{kind: bar, name: x}]": "plots.0.kind: found 'bar', expected one of 'bars', 'distributions', 'survival', ",
    "plots=[{name: x}]": "plots.0.kind: found nothing, expected this field to be given",
    "plots=[bars]": "plots.0: found 'bars', expected a mapping",
    "plots={kind: bars}": "plots: found {'kind': 'bars'}, expected a list",
    "plots=[{kind: bars, name: x, where: 3}]": "plots.0.where: found 3, expected a mapping",
    "variables=[1]": "variables: found [1], expected a mapping",
    "record={every: 1.5}": "record.every: found 1.5, expected a whole number",
    "learners.float_learner=3": "learners.float_learner: found 3, expected a mapping",
    "performance=3": "performance: found 3, expected text",
    "learners.Q_full.learning_rate=.inf": " with --set learners.Q_full.learning_rate=.inf: learners.Q_full: q_learning",
    "plots.99999999999999999999.x=3": "plots: found {'99999999999999999999': {'x': 3}}, expected a list",
    "sweep={'': {learners.Q_full: [$dropped, 0.5]}}": "sweep: found an axis without a name",
    "sweep={a: {learners.Q_full: [$dropped, 0.5]}}": "sweep point a=$dropped: learners.Q_full: found '$dropped', exp",
    "sweep={arms.APEL.learners: [1e300, x]}": "sweep point arms.APEL.learners=1e+300: arms.APEL.learners: found 1e+300",
    "sweep={a..b: [1]}": "sweep: found the path 'a..b', expected the names of fields with dots between them",
    "sweep={learners.Q_full.type.x: [1]}": "sweep: learners.Q_full.type.x: found str before 'x', expected a mapping",
}


@pytest.mark.parametrize("override", FIELDS)
def test_what_was_expected(override: str, small: Path) -> None:
    """Errors say what was found, what would be right, and by which option it came."""
    with pytest.raises(SpecError) as caught:
        check(Plan.of(load_experiment(str(small), [override])))
    assert FIELDS[override] in str(caught.value)
    assert "--set" in str(caught.value)
    assert "Unexpected" not in str(caught.value)


def test_program_that_ends_while_it_is_built(small: Path) -> None:
    """``sys.exit`` in a user's constructor is bad input, not the end of the program."""
    small.write_text(SMALL.replace("Q_full: {type: q_learning}", "Q_full: {type: 'tests.user_code:leave'}"))
    with pytest.raises(SpecError, match=r"learners\.Q_full: SystemExit.* \(.*user_code\.py:\d+, in leave"):
        check(Plan.of(load_experiment(str(small))))


def test_escape_sequences_stay_out_of_the_terminal(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Not from a file's name, a field or a value."""
    for override in ("title=\x1b[31m", 'title="\\e[31m"', "a\x1b[31m=1", "learners={\x1b: 1}", "runs='\x1b[31m'"):
        code, error = call(capsys, "validate", str(small), "--set", override)
        assert code == 2
        assert "\x1b[31m" not in error
        assert "Traceback" not in error
