"""Learners in other programs' forms choose the same actions there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

import apel
from apel.agents.formats import write_onnx, write_sb3
from apel.agents.onnx_form import checked_model, sampled
from apel.learners.deep.acer import Acer
from apel.learners.deep.dqn import Dqn
from apel.learners.deep.sac import DiscreteSac
from tests.apel.agents.test_agent import CART, LEARNERS, ensemble_of

onnxruntime = pytest.importorskip("onnxruntime")
VECTOR = spaces.Box(-1.0, 1.0, (5,), np.float32)
IMAGE = spaces.Box(0, 255, (2, 9, 8), np.uint8)
TURNED = spaces.Box(0, 255, (9, 8, 2), np.uint8)
FIVE = spaces.Discrete(5, start=2)
FILTERS = {"convolutions": [[4, 3, 2], [5, 2, 1]], "hidden": [7]}
NETWORKS: dict[str, tuple[Any, spaces.Space[Any], dict[str, Any]]] = {
    "dueling": (Dqn, VECTOR, {"network": {"hidden": [6, 5]}, "dueling": True, "head_hidden": [4]}),
    "plain": (Dqn, VECTOR, {"network": {"hidden": [6], "activation": "relu"}, "dueling": False, "head_hidden": []}),
    "linear": (Dqn, VECTOR, {"network": {"hidden": []}, "dueling": False, "head_hidden": []}),
    "acer": (Acer, VECTOR, {"network": {"hidden": [6]}}),
    "sac": (DiscreteSac, VECTOR, {"network": {"hidden": [6]}}),
    "normalised": (Dqn, VECTOR, {"network": {"hidden": [6, 5], "layer_norm": True}, "head_hidden": [4]}),
    "images": (Dqn, IMAGE, {"network": FILTERS}),
    "padded": (Dqn, IMAGE, {"network": {**FILTERS, "padding": "same"}, "dueling": False}),
    "turned": (Dqn, TURNED, {"network": {**FILTERS, "layout": "channels_last"}}),
    "state": (Dqn, spaces.Discrete(6, start=1), {"network": {"hidden": [6]}}),
    "states": (DiscreteSac, spaces.MultiDiscrete([3, 4]), {"encoding": "one_hot", "network": {"hidden": [6]}}),
    "numbers": (Dqn, spaces.MultiDiscrete([3, 4]), {"network": {"hidden": [6]}}),
}


@pytest.mark.parametrize("name", NETWORKS)
def test_same_actions(name: str) -> None:
    """The model gives the learner's values, and its actions, at a thousand observations."""
    kind, space, options = NETWORKS[name]
    learner = kind(space, FIVE, 3, replay_size=100, **options)
    session = onnxruntime.InferenceSession(checked_model(learner, space, 2), providers=["CPUExecutionProvider"])
    observations = sampled(space, 1000)
    values, actions = session.run(["values", "action"], {"observation": observations.astype(np.float32)})
    expected = np.stack([learner.action_values(observation) for observation in observations])
    np.testing.assert_array_equal(actions, expected.argmax(axis=1) + 2)
    if kind is Dqn:
        np.testing.assert_allclose(values, expected, rtol=1e-4, atol=1e-4)


def test_other_actions_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A model that chooses otherwise is not written."""
    learner = Dqn(VECTOR, FIVE, 3, replay_size=100)
    values = learner.action_values
    monkeypatch.setattr(learner, "action_values", lambda observation: -values(observation))
    with pytest.raises(ValueError, match="onnxruntime gives the values"):
        checked_model(learner, VECTOR, 2)


def test_trained_network(tmp_path: Path) -> None:
    """An agent's network, in a file, acts as the agent does."""
    config, learner = LEARNERS["dqn"]
    agent = ensemble_of(config, [learner], 5).agent(config)
    write_onnx(agent, agent.names[0], tmp_path / "it.onnx")
    session = onnxruntime.InferenceSession(str(tmp_path / "it.onnx"), providers=["CPUExecutionProvider"])
    world = apel.make_world(CART, run_seed=3)
    observation, _ = world.environment.reset(seed=1)
    for _ in range(8):
        (action,) = session.run(["action"], {"observation": observation[None]})
        assert action[0] == agent.act(observation)
        observation = world.environment.step(int(action[0]))[0]


def test_stable_baselines_zip(tmp_path: Path) -> None:
    """stable-baselines3 loads its algorithm, which predicts what the learner would do."""
    from stable_baselines3 import DQN

    config, learner = LEARNERS["stable_baselines"]
    agent = ensemble_of(config, [learner], 5).agent(config)
    write_sb3(agent, agent.names[0], tmp_path / "it.zip")
    loaded = DQN.load(tmp_path / "it.zip")
    for observation in sampled(spaces.Box(-0.2, 0.2, (4,), np.float32), 1000):
        agent.begin()
        assert int(loaded.predict(observation, deterministic=True)[0]) == agent.act(observation)
    assert loaded.num_timesteps > 0


@pytest.mark.parametrize(
    ("kind", "write"), [("q_learning", write_onnx), ("dqn", write_sb3), ("stable_baselines", write_onnx)]
)
def test_no_such_form(kind: str, write: Any, tmp_path: Path) -> None:
    """What has no such form is refused."""
    config, learner = LEARNERS[kind]
    agent = ensemble_of(config, [learner], 1).agent(config)
    with pytest.raises(ValueError, match="expected one of"):
        write(agent, agent.names[0], tmp_path / "it")
