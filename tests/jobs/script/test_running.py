"""An experiment in one call, with what a script or a notebook holds."""

from __future__ import annotations

import sys
import threading
from pathlib import Path
from typing import Any

import gymnasium
import pandas as pd
import pytest

import apel
import jobs
from jobs.experiment.yaml_source import SpecError
from tests.user_code import Corridor, RoundRobin, Walker, shortness

CELL = Path(__file__).with_name("cell.py").read_text()
"""What somebody would type into a notebook."""
LOCK = threading.Lock()


def notebook(text: str = CELL) -> dict[str, Any]:
    """The names of a notebook after a cell."""
    held: dict[str, Any] = {"__name__": "__main__"}
    exec(compile(text, "<ipython-input-1>", "exec"), held)
    return held


def run(held: dict[str, Any], results: Path, **options: Any) -> jobs.Results:
    """Play the notebook's experiment here."""
    given = {"runs": 3, "episodes": 30, "placement": "local", "quiet": True, "results": str(results)} | options
    learners = given.pop("learners", {"mine": held["Sarsa"], "Q": "q_learning"})
    return jobs.run(environment=held["make_env"], learners=learners, **given)


def test_results(tmp_path: Path) -> None:
    """Rows as data frames, a table, a figure; the same in shards of any size; and what is there is not played again."""
    held = notebook()
    results = run(held, tmp_path)
    assert list(results.runs["arm"].unique()) == ["ensemble", "mine", "Q"]
    assert len(results.runs) == 9
    assert len(results.episodes) == 9 * 30
    assert {"arm", "run_index", "episode", "selected", "return", "length", "probability"} <= set(results.episodes)
    assert "ensemble" in repr(results)
    assert results.path in repr(results)
    assert len(results.plot().axes) == 1
    assert len(results.plot("return", "probability").axes) == 2
    assert "mine" in str(results.compare())
    agent = results.agent(run=1)
    assert agent.names == ["mine", "Q"]
    observation, _ = held["make_env"]().reset(seed=1)
    assert agent.act(observation) in (0, 1)
    assert agent.learner("mine").table.any()
    with pytest.raises(SpecError, match="did you mean ensemble"):
        results.agent(arm="ensembl")
    agent.save(tmp_path / "agent")
    trained = {"mine": {"type": held["Sarsa"], "start_from": str(tmp_path / "agent")}}
    assert run(held, tmp_path, learners=trained).episodes["length"].mean() < results.episodes["length"].mean()
    small = run(held, tmp_path / "small", shard_size=1, models="final")
    assert len(list(Path(small.path).glob("models/arm=ensemble/*-final.npz"))) == 3
    assert (small.agent(run=1).learner("mine").table == agent.learner("mine").table).all()
    pd.testing.assert_frame_equal(results.episodes, small.episodes)
    # A comment more, as in a cell that is run again, and more runs.
    more = run(notebook(f"# again\n{CELL}"), tmp_path, runs=4)
    assert more.path == results.path
    before = results.runs.set_index(["arm", "run_index"])
    pd.testing.assert_frame_equal(more.runs.set_index(["arm", "run_index"]).loc[before.index], before)
    other = run(notebook(CELL.replace("LENGTH = 6", "LENGTH = 5")), tmp_path)
    assert other.path != results.path


def test_no_episodes(tmp_path: Path) -> None:
    """Where none is recorded there are none, in the columns that others have."""
    held = notebook()
    none, all_of_them = (run(held, tmp_path, runs=1, episodes=2, record=record) for record in ("none", "all"))
    assert none.episodes.empty
    assert none.episodes.dtypes.to_dict() == all_of_them.episodes.dtypes.to_dict()


def test_parts_of_many_kinds(tmp_path: Path) -> None:
    """Classes of modules, keys, import paths, options, a selector that is made, a rule of one's own, a measure."""
    results = jobs.run(
        environment={"id": Corridor, "max_episode_steps": 50},
        learners={"walker": {"type": Walker, "share": 0.9}, "path": "tests.user_code:Walker", "Q": apel.QLearning},
        selector=apel.Apel(decay=0.2),
        performance=shortness,
        runs=2, episodes=5, alone=False, placement="local", quiet=True, results=str(tmp_path),
    )  # fmt: skip
    experiment = results.experiment
    assert list(experiment.arms) == ["ensemble"]
    assert experiment.arms["ensemble"].selector is not None
    assert experiment.arms["ensemble"].selector.type == "apel"
    assert experiment.arms["ensemble"].selector.options["decay"] == 0.2
    assert experiment.learners["Q"].type == "q_learning"
    assert experiment.learners["walker"].options == {"share": 0.9}
    assert list(experiment.sources) == ["tests/__init__.py", "tests/user_code.py"]
    again = jobs.run(
        environment="tests.user_code:Corridor", learners={"w": Walker, "Q": Walker},
        selector=RoundRobin, runs=1, episodes=2, alone=False, placement="local", quiet=True, results=str(tmp_path),
    )  # fmt: skip
    assert again.episodes["selected"].tolist() == [0, 1]


def environment() -> gymnasium.Env[Any, Any]:
    return Corridor()


def locked() -> gymnasium.Env[Any, Any]:
    with LOCK:
        return Corridor()


locked.__module__ = "__main__"

BAD = {
    "no learners": ({"learners": {}}, "learners: found {}, expected a mapping from names to learners"),
    "a learner that is one already": ({"learners": {"a": 3}}, "learners.a: found int, expected a name, or what makes"),
    "no type": ({"learners": {"a": {"rate": 1}}}, "learners.a: found ['rate'], expected a mapping with 'type'"),
    "no such learner": ({"learners": {"a": "qlearning"}}, "did you mean q_learning?"),
    "an environment that is one": (
        {"environment": Corridor()},
        "environment: found Corridor, expected a name",
    ),
    "an option that is no value": (
        {"learners": {"a": {"type": Walker, "share": object()}}},
        "learners.a.share: found <object",
    ),
    "an unknown option": ({"learners": {"a": {"type": Walker, "shar": 1}}}, "did you mean share?"),
    "a lock": ({"environment": locked}, "environment: found a function that cannot be sent to another process"),
    "a name": ({"learners": {"a b": Walker}}, "learners.a b: found 'a b', expected a name of letters"),
    "no runs": ({"runs": 0}, "runs: found 0, expected greater than or equal to 1"),
    "models": ({"models": "last"}, "models: found 'last', expected 'none' or 'final'"),
    "a measure": ({"performance": 3}, "performance: found int"),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_input(what: str, tmp_path: Path) -> None:
    """One clear error, and nothing is written."""
    given, expected = BAD[what]
    options: dict[str, Any] = {"environment": environment, "learners": {"w": Walker}, "placement": "local"} | given
    with pytest.raises(SpecError) as caught:
        jobs.run(**options, results=str(tmp_path / "results"), quiet=True)
    assert expected in str(caught.value)
    assert str(caught.value).startswith("jobs.run(): ")
    assert not (tmp_path / "results").exists()


def test_failed_runs(tmp_path: Path) -> None:
    """They are told, and the others' results are there."""
    held = notebook()
    broken = type("Broken", (held["Sarsa"],), {"end_episode": lambda self: {}["lost"], "__module__": "__main__"})
    with pytest.raises(jobs.FailedRunsError, match=r"broken: 3 run\(s\) failed: KeyError") as caught:
        run(held, tmp_path, learners={"broken": broken, "Q": "q_learning"})
    assert caught.value.results is not None
    assert list(caught.value.results.runs["arm"].unique()) == ["Q"]


SCRIPT = """
import aside


class Gust(aside.Calm):
    def wind(self):
        return 0.1


def make():
    return Gust(make_env())
"""
ASIDE = """
import gymnasium
from apel import QLearning


class Calm(gymnasium.Wrapper):
    def wind(self):
        return 0.0

    def step(self, action):
        return super().step(action if self.np_random.random() >= self.wind() else 0)


class Learner(QLearning):
    pass
"""


@pytest.mark.ray
@pytest.mark.usefixtures("ray_session")
def test_same_rows_on_ray(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a notebook holds, and a module that its workers could not import, is sent to actors by value."""
    (tmp_path / "aside.py").write_text(ASIDE)
    with monkeypatch.context() as patch:
        patch.syspath_prepend(tmp_path)
        held = notebook(CELL + SCRIPT)
    monkeypatch.chdir(Path(__file__).parent)
    rows = {}
    for placement in ("local", "actors"):
        results = jobs.run(
            environment=held["make"], learners={"mine": held["Sarsa"], "aside": held["aside"].Learner}, runs=2,
            episodes=15, alone=False, results=str(tmp_path / placement), placement=placement, quiet=True,
        )  # fmt: skip
        rows[placement] = results.episodes
        assert {"__main__:Sarsa", "__main__:make", "aside.py"} <= set(results.experiment.sources)
    sys.modules.pop("aside")
    pd.testing.assert_frame_equal(rows["local"], rows["actors"])


def test_guide_takes_fifteen_lines() -> None:
    """The guide's experiment with one's own learner and environment, a DQN and twenty seeds."""
    page = Path(__file__).parents[3] / "docs" / "guide" / "2-own-learner-and-environment.md"
    script = page.read_text().partition("```python\n# crossing.py\n")[2].partition("```")[0]
    assert 0 < len([line for line in script.splitlines() if line]) <= 15
