"""The scripts of `examples/` run, and show what they say that they show.

They run in this process, in a fraction of their size: a script by its function ``main``, which takes its sizes as
arguments, the notebook cell by cell, with the sizes set after the cell with the tag ``parameters``. The notebook plays
without Ray; its rows are the same with it.
"""

from __future__ import annotations

import ast
import json
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


def main_of(name: str) -> Callable[..., Any]:
    """The function ``main`` of a script."""
    main: Callable[..., Any] = runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name=name)["main"]
    return main


def test_first_ensemble(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The agent that was saved, and loaded, can be asked what to order."""
    agent = main_of("first_ensemble")(40, tmp_path)
    assert agent.names == ["everything", "no weather"]
    assert agent.acting == "no weather"
    assert agent.act(np.array([3, 0, 4])) == agent.act(np.array([3, 0, 1]))  # whatever the weather
    assert "last 4 episodes: mean return" in capsys.readouterr().out


def test_own_learner(capsys: pytest.CaptureFixture[str]) -> None:
    """Both learners play, and both are told of."""
    records = main_of("own_learner")(60)
    assert {record.selected for record in records} == {0, 1}
    out = capsys.readouterr().out
    assert "Q-learning: " in out
    assert "Expected SARSA: " in out


def test_own_selector() -> None:
    """All miss less than a uniform choice, which misses max − mean: 0.28 per choice at first, then 0.20."""
    missed = main_of("own_selector")(400, 4)
    assert missed["uniform"] == pytest.approx(400 * (0.28 + 0.20) / 2, rel=0.1)
    assert all(value < missed["uniform"] for name, value in missed.items() if name != "uniform")


def test_choosing_decay() -> None:
    """The ν of the theory finds the new best about when it should: the standard error of eight runs is about 28."""
    decay, measured = main_of("choosing_decay")(1600, 8)
    assert 0.0 < decay < 0.05
    assert 100.0 < measured < 300.0


def test_deep_learners() -> None:
    """Each learner, and their ensemble, is evaluated."""
    evaluation = main_of("deep_learners")(16, 2)
    assert {"table", "DQN"} <= {played.learner for played in evaluation.played}
    assert all(len(played.episode_return) == 2 for played in evaluation.played)


def test_notebook(tmp_path: Path) -> None:
    """Its cells run from top to bottom."""
    held: dict[str, Any] = {"__name__": "__main__"}
    sizes = {"RUNS": 2, "EPISODES": 20, "EVALUATIONS": 0, "RESULTS": str(tmp_path), "PLACEMENT": "local"}
    shown: list[Any] = []
    for cell in json.loads((EXAMPLES / "hundred_seeds.ipynb").read_text())["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            shown.append(last_value("".join(cell["source"]), held))
            if "parameters" in cell["metadata"].get("tags", ()):
                assert sizes.keys() <= held.keys()
                held |= sizes
    table, statistics, figure, answer, names = (value for value in shown if value is not None)
    assert "ensemble" in repr(table)
    assert list(statistics["count"]) == [2.0, 2.0, 2.0]
    assert len(figure.axes) == 2
    assert "without_distractor" in repr(answer)
    assert names == ["everything", "without_distractor"]


def last_value(text: str, held: dict[str, Any]) -> Any:
    """What a cell shows: the value of its last line."""
    tree = ast.parse(text)
    *first, last = tree.body
    exec(compile(ast.Module(first, []), "<cell>", "exec"), held)
    if isinstance(last, ast.Expr):
        return eval(compile(ast.Expression(last.value), "<cell>", "eval"), held)
    exec(compile(ast.Module([last], []), "<cell>", "exec"), held)
    return held.get("figure") if "figure" in text else None


def test_every_example_is_run_here() -> None:
    """Six of them, one a notebook."""
    names = {path.name for path in EXAMPLES.iterdir() if not path.name.startswith("__")}
    tested = {"first_ensemble", "own_learner", "own_selector", "choosing_decay", "deep_learners"}
    assert names == {f"{name}.py" for name in tested} | {"hundred_seeds.ipynb", "README.md"}
