"""Which files of a user's an experiment rests on: its identity changes with them, and with nothing else."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import yaml

from jobs.experiment.spec import Experiment, validate
from jobs.experiment.spec_files import load_experiment, shipped_experiments
from jobs.experiment.user_modules import named_modules, source_digests, with_sources
from jobs.experiment.yaml_source import parse
from jobs.results.provenance import of_changed_sources, of_other_versions
from tests.command_line import call

MINE = """import gymnasium as gym
class Env(gym.Env):
    observation_space = gym.spaces.Discrete(6)
    action_space = gym.spaces.Discrete(2)
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed); self.s = 0; return 0, {}
    def step(self, a):
        self.s = max(0, self.s + (1 if a == 1 else -1)); return self.s, -7.0, self.s == 5, False, {}
"""
STALE = """
name: stale
runs: 2
episodes: 100
environment: {id: "mine:Env", max_episode_steps: 50}
learners: {Q: {type: q_learning}}
arms: {Q: {learners: [Q]}}
steady_state_episodes: 20
"""
FILES = {
    "worlds/__init__.py": "",
    "worlds/deep/__init__.py": "from .maze import Corridor\n",
    "worlds/deep/maze.py": "from ..common import a\nimport numpy\n",
    "worlds/common.py": "def f():\n    import late\n",
    "worlds/unused.py": "",
    "late.py": "import importlib\nx = importlib.import_module('dynamic')\n",
    "dynamic.py": "try:\n    import broken\nexcept SyntaxError:\n    pass\n",
    "broken.py": "def f(:\n",
    "unrelated.py": "",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, content in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    return tmp_path


def test_files_that_are_reached(folder: Path) -> None:
    """Those that are named, the packages that they lie in, and what these import, wherever and however."""
    found = source_digests(["worlds.deep", "numpy", "apel.selectors"], [folder])
    assert list(found) == [
        "broken.py", "dynamic.py", "late.py", "worlds/__init__.py", "worlds/common.py", "worlds/deep/__init__.py",
        "worlds/deep/maze.py",
    ]  # fmt: skip
    assert all(len(digest) == 16 for digest in found.values())


@pytest.mark.parametrize("name", FILES)
def test_what_changes_the_digests(folder: Path, name: str) -> None:
    """Every file that is reached counts, by its content and not by its line ends; the others do not."""
    before = source_digests(["worlds.deep"], [folder])
    text = (folder / name).read_bytes()
    (folder / name).write_bytes(text.replace(b"\n", b"\r\n"))
    assert source_digests(["worlds.deep"], [folder]) == before
    (folder / name).write_bytes(text + b"\n# changed\n")
    after = source_digests(["worlds.deep"], [folder])
    assert {key for key in before if before[key] != after[key]} == ({name} & set(before))
    assert set(after) == set(before)


def test_installed_modules_have_versions_instead() -> None:
    """What lies where packages are installed, or among Python's own, is no source of the user's."""
    folders = [Path(entry) for entry in sys.path if Path(entry).is_dir()]
    assert source_digests(["numpy", "json", "gymnasium.envs", "apel", "no_such_module"], folders) == {}


def test_shipped_experiments_have_none() -> None:
    """Nothing that is shipped rests on a user's code: their identities are those of their files alone."""
    for name in shipped_experiments():
        assert load_experiment(name).sources == {}
        assert "sources" not in yaml.safe_load(load_experiment(name).to_yaml())


def test_paths_in_options(small: Path) -> None:
    """Import paths count wherever a value may stand: in nested options, in variables, and in sweeps."""
    overrides = [
        "learners.Q_full={type: stable_baselines, algorithm: 'mine:Algorithm', policy_kwargs: {net: {a: 'nets:Big'}}}",
        "learners.Q_red={type: q_learning, schedules: ['rates:fast', {more: 'rates:slow'}]}",
        "environment.options.reward='rewards.sparse:Goal'",
        "variables.how=['kinds:one', 'kinds:two']",
        "arms.SSBAS.selector={type: ssbas, prior: 'priors:flat'}",
        "sweep={learners.Q_full.policy: ['policies:Small', CnnPolicy]}",
        "title='note:This is no path'",
    ]
    found = load_experiment(str(small), overrides)
    assert named_modules(found) == ["kinds", "mine", "nets", "policies", "priors", "rates", "rewards"]


def test_stored_experiments_keep_their_identity(folder: Path, small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An experiment that is read from its results is the one that was run, whatever has become of the source."""
    monkeypatch.chdir(folder)
    overrides = ["environment={id: 'late:Env'}", "variables={}", "learners.Q_red.representation={}"]
    loaded = load_experiment(str(small), overrides)
    assert list(loaded.sources) == ["broken.py", "dynamic.py", "late.py"]
    stored = validate(parse(loaded.to_yaml(), "spec.yaml"))
    (folder / "late.py").write_text("x = 1\n")
    assert stored.identity == loaded.identity
    now = with_sources(stored)
    assert list(now.sources) == ["late.py"]
    assert now.identity != loaded.identity
    assert with_sources(stored, [folder]).identity == now.identity  # as a submitted job finds it
    (message,) = of_changed_sources(stored)
    assert message.endswith("late.py changed since, broken.py, dynamic.py dropped out")
    assert of_changed_sources(now) == []


def _forget(name: str) -> None:
    sys.modules.pop(name, None)


def test_edited_module(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows of other source are left, and all is computed anew beside them, with a word about why."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "stale.yaml").write_text(STALE)
    (tmp_path / "mine.py").write_text(MINE)
    command = ("run", "stale.yaml", "--placement", "local", "--quiet")
    assert call(capsys, *command) == (0, "")
    assert call(capsys, *command) == (0, "")
    _forget("mine")
    (tmp_path / "mine.py").write_text(MINE.replace("-7.0", "-1.0"))
    code, error = call(capsys, *command)
    assert code == 0
    assert "holds results of other source: mine.py changed since; they stay" in error
    assert len(list((tmp_path / "results" / "stale").glob("*/runs.parquet"))) == 2
    _forget("mine")
    (tmp_path / "mine.py").write_text(MINE)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("results/stale/*/parts/*/*.parquet")}
    assert call(capsys, *command)[0] == 0  # whose rows are there
    assert {path: path.stat().st_mtime_ns for path in tmp_path.glob("results/stale/*/parts/*/*.parquet")} == before
    _forget("mine")


def test_other_versions_are_told(small: Path) -> None:
    """Where packages that matter were others in the last session, it is said which."""
    experiment = load_experiment(str(small))
    session = {"versions": {"numpy": "0.1", "gone": "1"}}
    (message,) = of_other_versions(experiment, {"sessions": [session]})
    assert "numpy 0.1 → " in message
    assert "gone" not in message
    assert of_other_versions(experiment, {}) == []


def test_sources_are_an_ordinary_field() -> None:
    """They are part of the identity where there are any, and only then."""
    text = STALE + "sources: {mine.py: 0123456789abcdef}\n"
    with_them, without = validate(parse(text, "a.yaml")), validate(parse(STALE, "b.yaml"))
    assert isinstance(with_them, Experiment)
    assert with_them.identity != without.identity
    assert with_them.model_copy(update={"sources": {}}).identity == without.identity
