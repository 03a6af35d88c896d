"""From results to agents and back: kept or played again they are the same, and experiments begin with them."""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from PIL import Image

import apel
from apel.agents import Agent, Evaluation, Played
from apel.agents.evaluation import ENSEMBLE
from apel.agents.files import AGENT_FILE
from apel.building import make_bank
from cluster.shard import Execution
from jobs.agents.exporting import agent_of
from jobs.agents.watching import film_agent
from jobs.cli.agent_commands import _remarks
from jobs.experiment.plan import Plan
from jobs.experiment.run_plans import run_plan
from jobs.experiment.spec_files import load_experiment
from jobs.experiment.starts import _agent
from jobs.experiment.validation import check
from jobs.experiment.yaml_source import SpecError
from jobs.films.scenes import Wish, find_scene
from jobs.films.watching import FilmOptions
from jobs.remote.package import write_package
from jobs.results.store import ResultStore, StoreError
from tests.command_line import call, called
from tests.same_rows import assert_same, play, run_rows

MAZE = """
name: kept-maze
runs: 3
episodes: 40
environment:
  id: apel/Maze-v0
  run_seed: maze_seed
  options: {size: 4, distractors: [3], max_steps: 60}
variables: {dropped: [x, y, distractor]}
learners:
  full: {type: q_learning}
  red: {type: dyna_q, representation: {exclude: [$dropped]}}
  voter: {type: q_learning}
  vote: {type: voting, members: [voter, red]}
arms:
  all: {learners: [full, red, vote], selector: {type: apel, decay: 0.01}}
record: all
models: {every_steps: 500}
"""
CART = """
name: kept-cart
runs: 2
episodes: 8
environment: {id: apel/CartPole-v0}
learners:
  dqn: {type: dqn, learning_starts: 20, replay_size: 90, batch_size: 8, network: {hidden: [8]}}
  sac: {type: sac, learning_starts: 20, replay_size: 90, batch_size: 8}
  acer: {type: acer, learning_starts: 1, replay_size: 60}
  mine: {type: "tests.user_code:Walker"}
arms:
  all: {learners: [dqn, mine], selector: {type: ssbas}}
  deep: {learners: [dqn, sac, acer], selector: {type: uniform}}
models: final
"""


def written(folder: Path, text: str) -> Path:
    """An experiment file."""
    (folder / "spec.yaml").write_text(text)
    return folder / "spec.yaml"


@pytest.fixture(scope="module")
def maze(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three runs side by side, with models of every 500 steps."""
    folder = tmp_path_factory.mktemp("maze")
    return play(written(folder, MAZE), folder / "results", placement="local", shard_size=3)


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same without models, one run at a time and in short streaks."""
    folder = tmp_path_factory.mktemp("alone")
    execution = Execution(streak_episodes=3, checkpoint_episodes=9)
    spec = written(folder, MAZE)
    return play(spec, folder / "results", "models=none", placement="local", shard_size=1, execution=execution)


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without Ray, and in a folder of its own."""
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.chdir(tmp_path)


def exported(results: Path, run: int, steps: int | None = None) -> tuple[Agent, bool]:
    """The agent of a run, and whether it was kept."""
    store = ResultStore.at(str(results))
    found = agent_of(store, find_scene(store, Wish(run=run)), steps, lambda _: None, trust=True)
    return found.agent, found.was_kept


def test_rows_are_the_same(maze: Path, alone: Path) -> None:
    """Keeping models changes neither a row nor the identity; without it nothing is kept."""
    assert maze.name == alone.name
    assert_same(maze, alone)
    assert not (alone / "models").exists()


@pytest.mark.parametrize(("run", "steps"), [(0, None), (1, 500), (2, 1000)])
def test_kept_is_replayed(maze: Path, alone: Path, run: int, steps: int | None) -> None:
    """What is kept of a run in a shard of three is what the run alone comes to when it is played again."""
    (kept, was_kept), (replayed, was_replayed) = exported(maze, run, steps), exported(alone, run, steps)
    assert (was_kept, was_replayed) == (True, False)
    assert kept.digest == replayed.digest
    origin = kept.content.origin
    assert (origin["run"], origin["arm"], origin["identity"]) == (run, "all", maze.name)
    row = run_rows(maze).iloc[run]
    if steps is None:
        assert (origin["episodes"], origin["steps"]) == (row["episodes"], row["steps"])
    else:
        assert steps <= origin["steps"] < steps + 60


def test_kept_deep_is_replayed(tmp_path: Path) -> None:
    """So of networks, whose memories stand side by side in a shard."""
    spec, arms = written(tmp_path, CART), ("deep",)
    kept, was_kept = exported(play(spec, tmp_path / "kept", placement="local", arms=arms), 1)
    settings = {"placement": "local", "arms": arms, "shard_size": 1}
    replayed, _ = exported(play(spec, tmp_path / "none", "models=none", **settings), 1)
    assert was_kept
    assert kept.digest == replayed.digest


def test_fresh_forgets_models(tmp_path: Path) -> None:
    """Whoever starts over has no models of before."""
    spec = written(tmp_path, MAZE)
    results = play(spec, tmp_path / "results", "models=final", "runs=2", placement="local")
    names = sorted(path.name for path in (results / "models" / "arm=all").iterdir())
    assert names == ["000000-final.npz", "000001-final.npz"]
    play(spec, tmp_path / "results", "models=none", "runs=1", placement="local", fresh=True)
    assert not list(results.glob("models/**/*.npz"))


def test_damaged_model(maze: Path, tmp_path: Path) -> None:
    """A model that is not what was kept is refused, not taken."""
    path = maze / "models" / "arm=all" / "000001-final.npz"
    content = path.read_bytes()
    try:
        for changed, expected in (
            (content[:1000], "found a file that is cut off"),
            (content[:500] + b"?" + content[501:], "found a damaged file"),
            ((maze / "models" / "arm=all" / "000000-final.npz").read_bytes(), "found the file"),
        ):
            path.write_bytes(changed)
            with pytest.raises(StoreError, match=expected):
                exported(maze, 1)
    finally:
        path.write_bytes(content)


def test_going_on_in_an_experiment(maze: Path, tmp_path: Path) -> None:
    """Learners begin with tables, models of the world and clocks; their streams are those of their runs."""
    agent, _ = exported(maze, 0)
    agent.save("agent")
    again = MAZE.replace("kept-maze", "again").replace("selector:", "start_from: agent, selector:")
    experiment = load_experiment(str(written(tmp_path, again)), ["variables.dropped=[y]"])
    plan = Plan.of(experiment)
    run = run_plan(plan.arm_points[0], 2, plan.seeds[2])
    assert [config.start is not None for config in run.learners] == [True] * 3
    world = apel.make_world(run.environment, run.seed)
    for index, config in enumerate(run.learners[:1]):
        banks = [
            make_bank([one], [world], [run.seed], index, "return", with_probability=False)
            for one in (config, replace(config, start=None))
        ]
        begun, fresh = (bank.models([0])[0] for bank in banks)
        trained = agent.content.learners[index].state
        np.testing.assert_array_equal(begun["table"]["values"], trained["table"]["values"])
        np.testing.assert_array_equal(begun["table"]["keys"], trained["table"]["keys"])
        assert begun["steps"] == trained["steps"] > 0
        np.testing.assert_array_equal(begun["stream"], fresh["stream"])
        assert begun["episode"] == 0


@pytest.mark.parametrize("kind", ["maze", "cart"])
def test_rows_with_a_start(kind: str, tmp_path: Path) -> None:
    """Rows that begin with an agent do not depend on shards, streaks and interruptions, and are others than without."""
    text = MAZE.replace("{every_steps: 500}", "final") if kind == "maze" else CART
    overrides = ["variables.dropped=[y]"] if kind == "maze" else ["record=all"]
    spec = written(tmp_path, text)
    exported(play(spec, tmp_path / "first", *overrides, placement="local", arms=("all",)), 1)[0].save("agent")
    overrides += ["arms.all.start_from=agent", "models=none"]
    whole = play(spec, tmp_path / "whole", *overrides, placement="local", arms=("all",), shard_size=3)
    pieces = Execution(streak_episodes=2, checkpoint_episodes=5)
    assert_same(
        whole,
        play(spec, tmp_path / "cut", *overrides, placement="local", arms=("all",), shard_size=1, execution=pieces),
    )
    assert run_rows(whole)["steps"].tolist() != run_rows(next((tmp_path / "first").glob("*/*")))["steps"].tolist()
    replayed, was_kept = exported(whole, 0)
    assert not was_kept
    assert replayed.content.origin["identity"] == whole.name


def test_agent_that_is_gone(maze: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A model that is kept needs nothing of the agent that its run began with; a replay that does says so in a line."""
    exported(maze, 0)[0].save("agent")
    overrides = ["variables.dropped=[y]", "models=final", "runs=1", "episodes=5", "arms.all.start_from=agent"]
    results = play(written(tmp_path, MAZE), tmp_path / "further", *overrides, placement="local")
    before, _ = exported(results, 0)
    Path("agent").rename("moved")
    _agent.cache_clear()
    after, was_kept = exported(results, 0)
    assert was_kept
    assert after.digest == before.digest
    assert call(capsys, "evaluate", str(results), "--episodes", "2")[0] == 0
    shutil.rmtree(results / "models")
    for words in (["export", str(results), "a"], ["evaluate", str(results)], ["watch", str(results)]):
        code, err = call(capsys, *words)
        assert (code, err.count("error:")) == (2, 1)
        assert "learners.full: start_from: agent: found no agent.json" in " ".join(err.split())


def test_identity(maze: Path, tmp_path: Path) -> None:
    """An agent counts by what it is, not by where it lies."""
    spec = written(tmp_path, MAZE)
    for run, name in ((0, "a"), (0, "b"), (1, "c")):
        exported(maze, run)[0].save(name)
    found = {
        name: load_experiment(str(spec), [f"learners.full.start_from={name}"]).identity for name in ("a", "b", "c")
    }
    assert found["a"] == found["b"]
    assert len({*found.values(), load_experiment(str(spec)).identity}) == 3


def test_submitted(maze: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A job is sent the agents that it begins with, and is the same experiment where it runs."""
    exported(maze, 0)[0].save(tmp_path / "agent")
    overrides = [f"learners.full.start_from={tmp_path / 'agent'}", "variables.dropped=[y]"]
    experiment = load_experiment(str(written(tmp_path, MAZE)), overrides)
    write_package(experiment, [], tmp_path / "package")
    monkeypatch.chdir(tmp_path / "package")
    (tmp_path / "agent").rename(tmp_path / "gone")
    there = load_experiment("experiment.yaml")
    assert there.identity == experiment.identity
    check(Plan.of(there))


def test_bad_starts(maze: Path, tmp_path: Path) -> None:
    """What nothing can begin with is refused at validation, in one line that says why."""
    agent, _ = exported(maze, 0)
    agent.save("all")
    agent.only("red").save("red")
    spec = written(tmp_path, MAZE)
    for overrides, expected in (
        (["learners.full.start_from=nowhere"], r"full\.start_from: nowhere: found no agent\.json"),
        (["arms.all.start_from=red"], r"found an agent with the learners \['red'\] in red, expected 'full' among them"),
        (["learners.full.start_from=red"], "is of the type 'dyna_q', expected 'q_learning'"),
        (["arms.all.start_from=all", "environment.options.size=5"], r"has the observations \[MultiDiscrete\(\[4 4 3\]"),
        (["learners.full.start_from=3"], r"start_from: found 3"),
        (["sweep={learners.full.start_from: [red, all]}"], "expected an arm for each agent to begin with"),
        (["models=all"], "models: found 'all'"),
        (["models={every_steps: 0}"], "every_steps"),
        (["models={every: 3}"], "models"),
    ):
        with pytest.raises(SpecError, match=expected) as caught:
            check(Plan.of(load_experiment(str(spec), ["variables.dropped=[y]", *overrides])))
        assert len(str(caught.value).splitlines()) <= 2


def test_agent_that_changed(maze: Path, tmp_path: Path) -> None:
    """Results say which agent they began with: another one in its place is noticed."""
    exported(maze, 0)[0].save("mine")
    experiment = load_experiment(str(written(tmp_path, MAZE)), ["learners.full.start_from=mine"])
    exported(maze, 1)[0].save("mine")
    with pytest.raises(SpecError, match=r"found the agent \w+, expected \w+, as when this was loaded"):
        check(Plan.of(experiment))


def test_commands(maze: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Export, evaluate in JSON, watch."""
    code, err = call(capsys, "export", str(maze), "agent", "--run", "2")
    assert code == 0, err
    told = json.loads(Path("agent", AGENT_FILE).read_text())
    assert told["score_name"] == "mean return of 10 episodes"
    ended = called(capsys, "evaluate", "agent", "--episodes", "5", "--json")
    assert ended.code == 0, ended.err
    evaluation = json.loads(ended.out)
    assert [len(one["returns"]) for one in evaluation["played"]] == [5] * 8
    own = apel.load("agent").evaluate(episodes=5)
    assert evaluation["played"][0]["returns"] == own.played[0].episode_return.tolist()
    code, err = call(capsys, "watch", "agent", "--seed", "3", "-o", "film.gif")
    assert code == 0, err
    assert Image.open("film.gif").n_frames > 1  # type: ignore[attr-defined]
    code, err = call(capsys, "export", str(maze), "one", "--learner", "vote", "--evaluations", "0")
    assert (code, apel.load("one").names) == (0, ["vote"])


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["export", "RESULTS", "no/such/agent"], "expected a folder that exists"),
        (["export", "RESULTS", "."], "expected a new folder, or one that holds an agent"),
        (
            ["export", "RESULTS", "a", "--learner", "nobody"],
            "--learner: found 'nobody', expected one of full, red, vote",
        ),
        (
            ["export", "RESULTS", "a", "--steps", "501"],
            "--steps: found 501, expected one of those that are kept: 500, ",
        ),
        (["export", "RESULTS", "a", "--run", "7"], "--run: found 7"),
        (["export", "RESULTS", "a", "--format", "onnx"], "expected the name of a file that ends in .onnx"),
        (["export", "RESULTS", "a.zip", "--format", "sb3"], "expected one of stable_baselines"),
        (["export", "RESULTS", "a.onnx", "--format", "onnx"], "expected one of dqn, acer, sac"),
        (["evaluate", "RESULTS", "--environment", "CartPole-v1", "--episodes", "2"], "expected those of the agent"),
        (["evaluate", "nowhere"], "nowhere: found no runs.parquet"),
        (["evaluate", "AGENT", "--arm", "all"], "--arm: found 'all' with agent, which is an agent, expected it with"),
        (["evaluate", "AGENT", "--run", "1"], "--run: found 1 with agent, which is an agent"),
        (["watch", "AGENT", "--episode", "3"], "--episode: found 3 with agent, which is an agent"),
        (["watch", "RESULTS", "--explore"], "--explore: found it with"),
        (["watch", "RESULTS", "--seed", "3"], "which are results, expected it with an agent alone"),
    ],
)
def test_bad_input(maze: Path, capsys: pytest.CaptureFixture[str], words: list[str], expected: str) -> None:
    """Each gets one clear error, and exit code 2."""
    Path("letters.txt").touch()
    if "AGENT" in words:
        exported(maze, 0)[0].save("agent")
    code, err = call(capsys, *({"RESULTS": str(maze), "AGENT": "agent"}.get(word, word) for word in words))
    assert code == 2
    assert err.count("error:") == 1
    assert expected in " ".join(err.split())


def test_foreign_code(maze: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An agent of somebody's learner is evaluated only with --trust."""
    spec = written(tmp_path, CART)
    results = play(spec, tmp_path / "results", "runs=1", "episodes=2", placement="local", arms=("all",))
    for words in (["export", str(results), "agent"], ["evaluate", str(results)]):
        code, err = call(capsys, *words)
        assert code == 2
        assert "learners.mine.type: 'tests.user_code:Walker'" in err
    assert call(capsys, "export", str(results), "agent", "--trust", "--evaluations", "0")[0] == 0
    code, err = call(capsys, "evaluate", "agent", "--episodes", "2")
    assert (code, "learners.mine.type: 'tests.user_code:Walker'" in err) == (2, True)
    assert call(capsys, "evaluate", "agent", "--episodes", "2", "--trust")[0] == 0


def test_cut_episodes_are_told_once() -> None:
    """Those of the ensemble are episodes of its learners."""
    one = np.ones(4)
    played = [Played(name, "greedy", one, one.astype(np.int64), cut) for name, cut in (("a", 3), (ENSEMBLE, 2))]
    agent: Any = SimpleNamespace(names=["a"])
    told = _remarks(Evaluation("E", 0, tuple(played)), agent)
    assert told == ["3 episodes did not end, and were cut off"]


class Pusher(gymnasium.Env[np.ndarray, np.ndarray]):
    """Pays what is pushed, for two steps."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"]}
    observation_space = gymnasium.spaces.Box(0, 1, (1,), np.float32)
    action_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, dict[str, Any]]:
        self.step_number = 0
        return np.zeros(1, np.float32), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        self.step_number += 1
        return np.zeros(1, np.float32), float(action[0]), self.step_number == 2, False, {}

    def render(self) -> Any:
        return np.zeros((16, 16, 3), np.uint8)


def test_film_of_fractional_actions() -> None:
    """Two pushes by 0.25 are drawn, and not their whole parts: an episode with the return 0.5."""
    spaces = SimpleNamespace(observation=Pusher.observation_space, action=Pusher.action_space)
    agent: Any = SimpleNamespace(
        acting="me",
        now="me",
        content=SimpleNamespace(origin={}, spaces=spaces),
        begin=lambda: None,
        act=lambda *_, **__: np.array([0.25], np.float32),
    )
    film = film_agent(agent, apel.EnvironmentConfig(Pusher), FilmOptions(Path("film.gif")), seed=0, explore=False)
    assert (film.episode_return, film.length) == (0.5, 2)
