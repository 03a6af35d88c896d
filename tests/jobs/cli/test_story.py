"""A user's way through the program: init, run, compare, export, evaluate."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

import apel
from tests.command_line import printed

TINY = ("runs=2", "episodes=3", "learners.ACER.learning_starts=1", "models=final")


def test_story(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """What is exported plays, greedily, the same returns as what the results hold: by command and in Python."""
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.chdir(tmp_path)
    printed(capsys, "init", "my.yaml", "--env", "apel/CartPole-v0")
    sets = [word for one in TINY for word in ("--set", one)]
    printed(capsys, "run", "my.yaml", "--placement", "local", "--quiet", "--arms", "DQN,ensemble", *sets)
    results = str(next(Path("results", "my").iterdir()))
    ranked = json.loads(printed(capsys, "compare", results, "--json"))
    assert {place["name"] for place in ranked["answers"][0]["rankings"][0]["places"]} == {"DQN", "ensemble"}
    printed(capsys, "export", results, "agent", "--arm", "ensemble", "--run", "1", "--evaluations", "2")
    exported, stored = (
        {
            (one["learner"], one["mode"]): one["returns"]
            for one in json.loads(printed(capsys, "evaluate", *words, "--episodes", "3", "--json"))["played"]
        }
        for words in (["agent"], [results, "--arm", "ensemble", "--run", "1"])
    )
    agent = apel.load("agent")
    own = agent.evaluate(episodes=3)
    for name in agent.names:
        assert exported[name, "greedy"] == stored[name, "greedy"] == own.of(name).episode_return.tolist()
