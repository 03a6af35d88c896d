"""What agents show their learners: what a run would have shown them, before they are saved and after."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

import apel
from apel.agents import Agent
from apel.experience.observation_form import BorderError
from tests.channelled import Lives

_PARTS = spaces.Dict({"a": spaces.Box(0, 1, (2,), np.float32), "b": spaces.Discrete(3), "c": spaces.MultiBinary(2)})
_SPACES: dict[str, spaces.Space[Any]] = {
    "dict": _PARTS,
    "tuple": spaces.Tuple([spaces.Box(0, 1, (2,), np.float32), spaces.Discrete(3)]),
    "joint": spaces.Tuple([spaces.Discrete(3), spaces.Discrete(2)]),
    "discrete": spaces.Discrete(4, start=2, dtype=np.int32),
    "bits": spaces.MultiBinary(3),
    "box": spaces.Box(0, 1, (2,), np.float32),
}


class Showing(gymnasium.Env[Any, Any]):
    """Shows elements of a space, three a time."""

    def __init__(self, kind: str) -> None:
        self.observation_space, self.action_space = _SPACES[kind], spaces.Discrete(2)
        self._step = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        self.observation_space.seed(seed)
        self._step = 0
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self._step += 1
        return self.observation_space.sample(), 0.0, self._step == 3, False, {}


class Spoiler:
    """Writes into every array that it is shown, having noted what it was."""

    off_policy = True
    supported_spaces = apel.SupportedSpaces(
        ("Discrete",), ("Discrete", "Box", "MultiDiscrete", "MultiBinary", "Dict", "Tuple")
    )
    shown: list[Any]

    def __init__(self, observation_space: Any, action_space: Any, seed: int) -> None:
        self.space, self.shown = observation_space, []

    def act(self, observation: Any) -> tuple[int, None]:
        self.shown.append((type(observation).__name__, repr(observation)))
        _spoil(observation)
        return 1, None

    def learn(self, transition: Any) -> None:
        return

    def end_episode(self) -> None:
        return

    def state(self) -> dict[str, Any]:
        return {}

    def restore(self, state: dict[str, Any]) -> None:
        return


def _spoil(observation: Any) -> None:
    if isinstance(observation, dict | tuple):
        for part in observation.values() if isinstance(observation, dict) else observation:
            _spoil(part)
    if isinstance(observation, np.ndarray):
        observation[...] = 0


def _shown(agent: Agent) -> list[Any]:
    """What the agent's learner was shown."""
    learner: Any = agent.learner(agent.names[0])
    shown: list[Any] = learner.shown
    return shown


def agent_of(kind: str, learner: apel.LearnerConfig | None = None) -> tuple[Agent, list[Any]]:
    """An agent of a run of one episode, and what its learner was shown."""
    config = apel.EnvironmentConfig(Showing, {"kind": kind})
    learners = [learner or apel.LearnerConfig(Spoiler)]
    ensemble = apel.Ensemble(apel.make_world(config, 1), learners, apel.Uniform(), seed=1, num_episodes=1)
    list(ensemble.run())
    made: Any = ensemble.learners[0]
    return ensemble.agent(config), made.shown


def _raw(agent: Agent, kind: str) -> list[Any]:
    """The three observations of that run, as the environment itself gave them."""
    config = apel.EnvironmentConfig(Showing, {"kind": kind})
    environment = Showing(kind)
    first, _ = environment.reset(seed=apel.make_world(config, 1).seeds.of_episode(0))
    return [first, environment.step(1)[0], environment.step(1)[0]]


@pytest.mark.parametrize("kind", list(_SPACES))
def test_learners_see_what_they_saw_in_the_run(kind: str, tmp_path: Path) -> None:
    """In the same form, before the agent is saved and after; what they write into it changes nothing of the caller's.

    Tuples may be lists, as in a run.
    """
    agent, in_run = agent_of(kind)
    agent.save(tmp_path / "agent")
    loaded = apel.load(tmp_path / "agent", trust=True)
    raw = _raw(agent, kind)
    before = repr(raw)
    for one in (agent, loaded):
        assert [one.act(observation) for observation in raw] == [1, 1, 1]
        assert _shown(one) == in_run
    assert repr(raw) == before
    again = apel.load(tmp_path / "agent", trust=True)
    for observation in raw:
        again.act(list(observation) if isinstance(observation, tuple) else observation, explore=True)
    assert _shown(again) == in_run


def test_agents_play_where_they_were_trained(tmp_path: Path) -> None:
    """A row of bits is the same space after loading, and its environment the same environment."""
    agent_of("bits")[0].save(tmp_path / "agent")
    found = apel.load(tmp_path / "agent", trust=True).evaluate(episodes=2)
    assert found.of("learner 0", "as trained").length.tolist() == [3, 3]


def test_agents_of_before_show_parts(tmp_path: Path) -> None:
    """They hold the vectors and the environment's own space, of which these were made."""
    agent, in_run = agent_of("dict")
    seen: Any = agent.content.spaces.observation
    vectors = spaces.Box(seen.low, seen.high, dtype=seen.dtype.type)
    old = replace(agent.content, spaces=agent.content.spaces._replace(observation=vectors))
    Agent(old, trust=True).save(tmp_path / "agent")
    loaded = apel.load(tmp_path / "agent", trust=True)
    for observation in _raw(agent, "dict"):
        loaded.act(observation)
    assert _shown(loaded) == in_run


def test_stacks_keep_copies() -> None:
    """An environment may write its next observation into the same array."""
    config = apel.EnvironmentConfig(Showing, {"kind": "box"})
    learners = [apel.LearnerConfig(Spoiler, representation=apel.Representation(stack=2))]
    agent = apel.Ensemble(apel.make_world(config, 1), learners, apel.Uniform(), seed=1, num_episodes=1).agent(config)
    observation = np.zeros(2, np.float32)
    for value in (0.25, 0.5):
        observation[...] = value
        agent.act(observation)
    assert "0.25" in _shown(agent)[-1][1]
    assert "0.5" in _shown(agent)[-1][1]


@pytest.mark.parametrize(
    ("kind", "observation", "expected"),
    [
        ("box", [0.5], r"it has the shape \(1,\), not \(2,\)"),
        ("box", [0.5, np.nan], r"found no number at \[1\]"),
        ("box", "near", "it holds something that is no number"),
        ("discrete", 2.5, "2.5 cannot be stored as int32 without loss"),
        ("discrete", 1, "1 is not from 2 to 5"),
        ("bits", [0, 1, 2], "2 at .* is not from 0 to 1"),
        ("joint", (1, 0, 1), "it is no tuple of 2"),
        ("joint", (1.5, 0), "^0: .*1.5 cannot be stored"),
        ("joint", (5, 0), "5 at .* is not from 0 to 2"),
        ("tuple", ([0.5, 0.5],), "it is no tuple of 2"),
        ("dict", {"a": [0.5, 0.5], "b": 3, "c": [0, 1]}, "^b: .*3 is not from 0 to 2"),
        ("dict", {"a": [0.5, 0.5], "b": 1}, "it has no 'c'"),
        ("dict", [0.5, 0.5], r"it has the shape \(2,\), not \(7,\)"),
    ],
)
def test_bad_observations(kind: str, observation: Any, expected: str) -> None:
    """What a run refuses is refused, and no learner sees it."""
    agent, _ = agent_of(kind)
    with pytest.raises(BorderError, match=expected):
        agent.act(observation)
    assert _shown(agent) == []


def test_observations_that_may_lie_outside() -> None:
    """Beyond a Box's bounds, and anywhere in an environment that need not keep to its space."""
    agent, _ = agent_of("box")
    assert agent.act([0.5, 1.5]) == 1
    content = agent_of("discrete")[0].content
    lenient = replace(content, environment=replace(content.environment, observations="warn"))
    assert Agent(lenient, trust=True).act(6) == 1


def test_channels() -> None:
    """Left out or of another form they are refused by name."""
    config = apel.EnvironmentConfig(Lives)
    learners = [apel.LearnerConfig("q_learning", representation=apel.Representation(channel="number"))]
    agent = apel.Ensemble(apel.make_world(config, 1), learners, apel.Uniform(), seed=1, num_episodes=1).agent(config)
    observation, info = Lives().reset(seed=1)
    assert agent.act(observation, info=info) in range(3)
    for changed, expected in (
        ({"number": 3}, "expected the channels .*: KeyError: 'picture'"),
        ({**observation, "number": 30}, "^number: .*30 is not from 0 to 29"),
        (7, "expected the channels"),
    ):
        with pytest.raises(BorderError, match=expected):
            agent.act(changed, info=info)


def test_names_of_learners() -> None:
    """Every learner has a name of its own, by which it is found."""
    config = apel.EnvironmentConfig(Showing, {"kind": "discrete"})
    learners = [apel.LearnerConfig("q_learning")] * 2
    ensemble = apel.Ensemble(apel.make_world(config, 1), learners, apel.Uniform(), seed=1, num_episodes=1)
    with pytest.raises(
        ValueError, match=r"names: found 'q' twice in \['q', 'q'\], expected a name of its own for each"
    ):
        ensemble.agent(config, names=["q", "q"])
    assert ensemble.agent(config, names=["q", "r"]).names == ["q", "r"]
