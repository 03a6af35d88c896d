"""`apel` with nothing but its core dependencies: what a user has after ``pip install apel``."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint, EntryPoints, entry_points, packages_distributions
from pathlib import Path

import pytest

import apel
import apel.__main__
import jobs.missing_extra

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]

BLOCKED = """
import sys

BLOCKED = set({blocked!r})


class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in BLOCKED:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)


sys.meta_path.insert(0, Absent())
"""
SCRIPT = """
import pkgutil, importlib
import apel

OPTIONAL = "apel.learners.stable_baselines", "apel.environments.breakout", "apel.learners.deep", "apel.agents.onnx_form"
for module in pkgutil.walk_packages(apel.__path__, "apel."):
    if not module.name.startswith(OPTIONAL):
        importlib.import_module(module.name)
world = apel.make_world(apel.EnvironmentConfig("FrozenLake-v1"), run_seed=1)
learners = [apel.LearnerConfig("q_learning"), apel.LearnerConfig("q_learning", {"learning_rate": 0.5})]
print(len(list(apel.Ensemble(world, learners, apel.Apel(), seed=1, num_episodes=5).run())), "episodes")
print(apel.Dqn.__name__)
try:
    import jobs
    jobs.run
except ModuleNotFoundError as error:
    print(error)
sys.argv = ["apel", "list"]
from jobs.__main__ import run
run()
"""


def distributions(requirements: list[str]) -> set[str]:
    """Normalised names of what is required."""
    return {name.split(";")[0].split("[")[0].split(">")[0].split("<")[0].strip().lower() for name in requirements}


def modules_of(wanted: set[str]) -> set[str]:
    """The top-level modules of distributions that are installed here."""
    found = packages_distributions()
    return {module for module, owners in found.items() if any(owner.lower() in wanted for owner in owners)}


def test_message_knows_the_extra() -> None:
    """Whatever the extra brings that we import is known by its module's name."""
    service = modules_of(distributions(PROJECT["optional-dependencies"]["service"]))
    assert service >= jobs.missing_extra.SERVICE
    assert len(distributions(PROJECT["optional-dependencies"]["service"])) == len(jobs.missing_extra.SERVICE)


def test_core_alone() -> None:
    """All of it but what is for an extra can be imported and used; the rest says what to install."""
    extras = PROJECT["optional-dependencies"]
    wanted = set().union(*(distributions(extras[name]) for name in extras if name != "dev")) - {"apel"}
    core = distributions(PROJECT["dependencies"]) | {"cloudpickle"}  # which is Gymnasium's too
    blocked = modules_of(wanted - core)
    assert {"ray", "pandas", "torch", "matplotlib", "typer"} <= blocked
    text = BLOCKED.format(blocked=sorted(blocked)) + SCRIPT
    ended = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=300, check=False)
    advice = r"expected the extra 'service' to be installed: pip install 'apel[service]'"
    lines = ended.stdout.splitlines()
    assert lines[:2] == ["5 episodes", "Dqn"], ended.stderr
    assert advice in lines[2]
    assert ended.returncode == 2
    assert ended.stderr.startswith("error: found no ")
    assert advice in ended.stderr
    assert "Traceback" not in ended.stderr


def test_module_is_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    """``python -m apel`` is whatever is installed as the command, and says so where nothing is."""
    (installed,) = entry_points(group="console_scripts", name="apel")
    assert installed.module.startswith("jobs.")
    called: list[str] = []
    script = EntryPoint("apel", "tests.apel.test_core_alone:noted", "console_scripts")
    monkeypatch.setattr("tests.apel.test_core_alone.noted", lambda: called.append("run"))
    monkeypatch.setattr("apel.__main__.entry_points", lambda **_: EntryPoints([script]))
    apel.__main__.run()
    assert called == ["run"]
    monkeypatch.setattr("apel.__main__.entry_points", lambda **_: EntryPoints([]))
    with pytest.raises(SystemExit, match="found no installed command 'apel'"):
        apel.__main__.run()


def noted() -> None:
    """Replaced by the test that calls it."""
    raise AssertionError


def test_public_names() -> None:
    """What is listed is there, once, and in order; what is not listed is refused as by any module."""
    assert [name for name in apel.__all__ if not hasattr(apel, name)] == []
    assert len(set(apel.__all__)) == len(apel.__all__)
    assert {"Ensemble", "Learner", "load", "Dqn", "QLearning", "Apel", "__version__"} <= set(apel.__all__)
    assert not hasattr(apel, "Dqm")


def test_version_has_one_source() -> None:
    """Citation, changelog and compose file speak of the version that is built."""
    root, version = Path(__file__).parents[2], PROJECT["version"]
    assert f"\nversion: {version}\n" in (root / "CITATION.cff").read_text()
    assert f"\n## {version} (" in (root / "CHANGELOG.md").read_text()
    assert f"image: apel:{version} " in (root / "docker-compose.yml").read_text()


def test_convolutions_need_no_pytorch() -> None:
    """On the processor a learner over images acts and learns without it."""
    code = """
import numpy as np
from gymnasium import spaces
import apel
network = {"convolutions": [[2, 3, 1]], "hidden": []}
space = spaces.Box(0, 255, (1, 4, 4), np.uint8)
learner = apel.Dqn(space, spaces.Discrete(2), 1, network=network, learning_starts=1, batch_size=2)
for _ in range(4):
    image = space.sample()
    learner.learn(apel.Transition(image, learner.act(image)[0], 1.0, space.sample(), False, False, None))
print("learnt")
"""
    done = subprocess.run(
        [sys.executable, "-c", BLOCKED.format(blocked=["torch"]) + code], capture_output=True, text=True, check=False
    )
    assert (done.stdout.strip(), done.stderr) == ("learnt", "")
