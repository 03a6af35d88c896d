"""MKL's reproducible mode: set where a learner multiplies and nowhere before, and never silently missed."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

torch = pytest.importorskip("torch")

from apel.numerics.rounding import is_reproducible, settle  # noqa: E402 - after the question whether there is PyTorch
from tests.snippets import Snippets, snippets  # noqa: E402

settle()  # to ask pins the mode of this process, in which other tests multiply
pytestmark = pytest.mark.skipif(is_reproducible() is None, reason="this PyTorch has no MKL that can be asked")

MULTIPLY = """
import torch
torch.ones(64, 64) @ torch.ones(64, 64)
"""
WRAP = """
import stable_baselines3
from gymnasium import spaces
from apel.learners.stable_baselines.adapter import StableBaselines
StableBaselines(spaces.Box(-1, 1, (4,)), spaces.Discrete(2), 1)
"""
PLAY = """
from apel.configs import EnvironmentConfig, LearnerConfig, SelectorConfig
from cluster.learner_host import LearnerHost
from cluster.shard import ArmPlan, Execution, RunPlan, Shard
run = RunPlan(0, 0, EnvironmentConfig({environment!r}), (LearnerConfig({learner!r}, {options!r}),))
arm = ArmPlan("one", "one", "", ("one",), SelectorConfig("fixed"), "return", 5, recording="all")
LearnerHost().prepare(Shard(arm, (run,)), 0, Execution(), None)
"""
SMALL = {"algorithm": "stable_baselines3:DQN", "buffer_size": 10}
DEEP = PLAY.format(environment="CartPole-v1", learner="stable_baselines", options=SMALL)
COMPILED = PLAY.format(environment="CartPole-v1", learner="dqn", options={"network": {"hidden": [8]}})
TABULAR = PLAY.format(environment="FrozenLake-v1", learner="q_learning", options={})
ASK = """
import os
from apel.numerics.rounding import is_reproducible
print(os.environ.get("MKL_CBWR"), is_reproducible())
"""


@pytest.fixture(scope="module")
def processes() -> Iterator[Snippets]:
    """Processes that have PyTorch and have not multiplied."""
    with snippets("torch", "gymnasium", "numba") as started:
        yield started


@dataclass
class Run:
    """Calls code in a process of its own."""

    processes: Snippets

    def __call__(self, code: str, **environment: str) -> tuple[str, str]:
        """What it prints, and what it complains of."""
        kept = {key: value for key, value in os.environ.items() if key != "MKL_CBWR"} | {"OMP_NUM_THREADS": "1"}
        done = self.processes.play(code, kept | environment)
        return done.stdout.strip(), done.stderr


@pytest.fixture
def run(processes: Snippets) -> Run:
    """Calls code in a process of its own."""
    return Run(processes)


def test_import_leaves_the_environment_alone() -> None:
    """``import apel`` sets no variable and loads no PyTorch."""
    code = "import os, sys; before = dict(os.environ); import apel; print(before == os.environ, 'torch' in sys.modules)"
    kept = {key: value for key, value in os.environ.items() if key != "MKL_CBWR"}
    kept["PYGAME_HIDE_SUPPORT_PROMPT"] = "hide"  # which Gymnasium sets
    done = subprocess.run([sys.executable, "-c", code], env=kept, capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr) == ("True False", "")


@pytest.mark.parametrize("make", [WRAP, DEEP])
def test_learners_settle_it(run: Run, make: str) -> None:
    """Whatever makes a learner that multiplies has the mode set, and in effect; that PyTorch is loaded does no harm."""
    assert run("import torch\n" + make + ASK) == ("AUTO,STRICT True", "")


def test_too_late(run: Run) -> None:
    """Where PyTorch has multiplied before, making a learner warns: what is wrong, and what to do."""
    found, complaint = run(MULTIPLY + WRAP + WRAP + ASK)
    assert found == "AUTO,STRICT False"
    assert "RoundingWarning: found that this process multiplied with PyTorch before" in complaint
    assert "start this process (in a notebook: the kernel) anew with MKL_CBWR=AUTO,STRICT" in complaint


def test_job_is_refused_where_it_is_too_late(run: Run) -> None:
    """A learner whose rows will be stored is not made there at all; one that never multiplies with PyTorch is."""
    _, complaint = run(MULTIPLY + DEEP)
    assert "RoundingError: found that this process multiplied" in complaint
    assert "placement in processes of its own: actors or packed" in complaint
    for other in (TABULAR, COMPILED):
        assert run(MULTIPLY + other + "print('made')") == ("made", "")


def test_who_multiplied_in_that_mode_is_in_time(run: Run) -> None:
    """With the variable set from outside, products before the first learner do no harm."""
    assert run(MULTIPLY + WRAP + ASK, MKL_CBWR="AUTO,STRICT") == ("AUTO,STRICT True", "")


def test_mode_of_the_user_stays(run: Run) -> None:
    """Who has asked for another mode keeps it, and hears nothing."""
    assert run(MULTIPLY + WRAP + ASK, MKL_CBWR="COMPATIBLE") == ("COMPATIBLE True", "")
