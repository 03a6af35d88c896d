from __future__ import annotations

import math

import pytest

from apel.building.registry import LEARNERS, METRICS, SELECTORS, load, resolve
from apel.learners.tabular.q_learning import QLearning
from apel.selectors import Apel


def test_shipped_names() -> None:
    """The names that experiment files use."""
    ours = {"q_learning", "dyna_q", "voting", "dqn", "acer", "sac"}
    assert set(LEARNERS) == ours | {"stable_baselines", "stable_baselines_on_policy"}
    families = (
        {"apel", "apel_recency", "apel_margin", "apel_surprise"},
        {"ssbas", "esbas", "ucb1", "sw_ucb", "d_ucb", "agent57", "d3rb", "ed2rb"},
        {"discounted_ts", "dynamic_ts", "exp3", "exp3s", "corral"},
        {"incumbent", "epsilon_greedy", "uniform", "fixed"},
    )
    assert set(SELECTORS) == set().union(*families)
    assert set(METRICS) == {"return", "negative_length"}


def test_name_stands_for_what_is_shipped() -> None:
    """A registry key is looked up, nothing imported."""
    assert resolve("apel", SELECTORS, "selector") is Apel


def test_import_path_stands_for_its_object() -> None:
    """``package.module:Name`` is imported, of ours or of anyone's."""
    assert resolve("apel.learners.tabular.q_learning:QLearning", LEARNERS, "learner") is QLearning
    assert load("math:tau") == math.tau


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("q_lerning", "found the learner 'q_lerning', expected one of ['acer', 'dqn', 'dyna_q', 'q_learning',"),
        ("", "found the learner '', expected one of ['acer', 'dqn', 'dyna_q', 'q_learning',"),
        ("math.tau", "found the learner 'math.tau', expected one of ['acer', 'dqn', 'dyna_q', 'q_learning',"),
        ("math:tao", "found the import path 'math:tao', but module 'math' has no 'tao'"),
        ("math:", "found the import path 'math:', but module 'math' has no ''"),
        (
            "no_such_module:Name",
            "importing 'no_such_module' failed: ModuleNotFoundError: No module named 'no_such_module'",
        ),
        (":Name", "found the import path ':Name', but importing '' failed"),
        ("tests.apel.broken_module:Name", "importing 'tests.apel.broken_module' failed: ZeroDivisionError: division"),
    ],
)
def test_unknown_name_is_one_clear_line(name: str, message: str) -> None:
    """Whatever is wrong with a name or a path, the answer is a `ValueError` of one line that says what was found."""
    with pytest.raises(ValueError, match="found the") as error:
        resolve(name, LEARNERS, "learner")
    assert message in str(error.value)
    assert "\n" not in str(error.value)
