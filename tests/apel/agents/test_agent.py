"""Agents in the hand: what is saved is what was trained, goes on as if nothing had been, and runs no code unasked."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import apel
from apel.agents import evaluation
from apel.agents.evaluation import Played
from apel.agents.files import AGENT_FILE, ARRAYS_FILE
from apel.building import make_learner
from apel.learners.base import Learner, Transition
from tests.user_code import Forgetful

CART = apel.EnvironmentConfig("apel/CartPole-v0")
MAZE = apel.EnvironmentConfig("apel/Maze-v0", {"size": 4, "distractors": [3], "max_steps": 50}, run_seed="maze_seed")
DEEP = {"learning_starts": 20, "replay_size": 60, "batch_size": 8}
BINS = tuple(apel.Bins(-1, 1, 3) for _ in range(4))
LEARNERS: dict[str, tuple[apel.EnvironmentConfig, apel.LearnerConfig]] = {
    "q_learning": (MAZE, apel.LearnerConfig("q_learning", {"exploration": {"start": 1.0, "end": 0.1, "steps": 90.0}})),
    "bins": (CART, apel.LearnerConfig("q_learning", {}, apel.Representation(bins=BINS))),
    "dyna_q": (MAZE, apel.LearnerConfig("dyna_q", {}, apel.Representation(exclude=("distractor",)))),
    "voting": (
        MAZE,
        apel.LearnerConfig("voting", members=(apel.LearnerConfig("q_learning"), apel.LearnerConfig("dyna_q"))),
    ),
    "dqn": (CART, apel.LearnerConfig("dqn", {**DEEP, "network": {"hidden": [8]}, "prioritized": {}})),
    "linear": (CART, apel.LearnerConfig("dqn", {**DEEP, "network": {"hidden": []}})),
    "acer": (CART, apel.LearnerConfig("acer", {"learning_starts": 1, "replay_size": 100})),
    "sac": (CART, apel.LearnerConfig("sac", DEEP)),
    "stable_baselines": (
        CART,
        apel.LearnerConfig("stable_baselines", {"learning_starts": 20, "buffer_size": 60, "batch_size": 8}),
    ),
    "share": (
        CART,
        apel.LearnerConfig(
            "dqn", {**DEEP, "head_hidden": [8], "prioritized": {}}, learns_from=apel.OwnShare(own_share=0.5)
        ),
    ),
    "on_policy": (
        CART,
        apel.LearnerConfig("stable_baselines_on_policy", {"n_steps": 32, "batch_size": 8}, learns_from="own"),
    ),
    "own": (CART, apel.LearnerConfig("tests.user_code:Walker")),
}


def ensemble_of(config: apel.EnvironmentConfig, learners: list[apel.LearnerConfig], episodes: int) -> apel.Ensemble:
    """Some learners that were trained together."""
    world = apel.make_world(config, run_seed=3)
    ensemble = apel.Ensemble(world, learners, apel.Apel(decay=0.05), seed=3, num_episodes=episodes)
    for _ in ensemble.run():
        pass
    return ensemble


def go_on(learner: Learner, world: apel.World, view: Any, episodes: range) -> list[Any]:
    """What a learner does in some episodes, learning on: its actions and what it says of them."""
    done: list[Any] = []
    for episode in episodes:
        observation, _ = world.environment.reset(seed=world.seeds.of_episode(episode))
        ended = False
        while not ended:
            action, probability = learner.act(view(observation))
            done.append((action, None if probability is None else probability.tolist()))
            following, reward, terminated, truncated, _ = world.environment.step(action)
            step = (view(observation), action, float(reward), view(following), terminated, truncated, probability)
            learner.learn(Transition(*step))
            observation, ended = following, terminated or truncated
        learner.end_episode()
    return done


@pytest.mark.parametrize("kind", [kind for kind in LEARNERS if kind != "own"])
def test_going_on(kind: str, tmp_path: Path) -> None:
    """Export, load and go on equals going on without the interruption, value for value."""
    config, learner = LEARNERS[kind]
    ensemble = ensemble_of(config, [learner], 6)
    ensemble.agent(config, ["it"]).save(tmp_path / "agent")
    view = make_learner(learner, apel.make_world(config, 3), 3, 0)[1]
    loaded = apel.load(tmp_path / "agent").learner("it")
    without = go_on(ensemble.learners[0], apel.make_world(config, 3), view, range(6, 10))
    after = go_on(loaded, apel.make_world(config, 3), view, range(6, 10))
    assert len(after) > 40
    assert after == without


def test_save_after_going_on(tmp_path: Path) -> None:
    """What an agent learned since it was loaded is saved with it, and changes its digest."""
    config, learner = LEARNERS["dyna_q"]
    agent = ensemble_of(config, [learner], 3).agent(config)
    before = agent.digest
    view = make_learner(learner, apel.make_world(config, 3), 3, 0)[1]
    go_on(agent.learner("learner 0"), apel.make_world(config, 3), view, range(3, 5))
    agent.save(tmp_path / "agent")
    assert apel.load(tmp_path / "agent").digest == agent.digest != before


@pytest.mark.parametrize("kind", ["q_learning", "dyna_q", "voting", "dqn"])
def test_asking_changes_nothing(kind: str) -> None:
    """To act on what was learned, or to read its values, is not to learn: the digest stays."""
    config, learner = LEARNERS[kind]
    agent = ensemble_of(config, [learner], 3).agent(config)
    before = agent.digest
    observation, _ = apel.make_world(config, 4).environment.reset(seed=11)
    agent.act(observation)
    values = agent.learner("learner 0").action_values(observation)  # type: ignore[attr-defined]
    values[:] = 7.0
    assert agent.digest == before


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An agent of two learners in a maze, saved."""
    learners = [LEARNERS["q_learning"][1], LEARNERS["dyna_q"][1]]
    path = tmp_path_factory.mktemp("agents") / "both"
    ensemble_of(MAZE, learners, 80).agent(MAZE, ["slow", "fast"]).save(path)
    return path


def test_acting(both: Path) -> None:
    """The best acts, greedily, unless somebody else is named."""
    agent = apel.load(both)
    assert agent.names == ["slow", "fast"]
    assert agent.best == "fast"
    world = apel.make_world(MAZE, run_seed=3)
    observation, _ = world.environment.reset(seed=5)
    values: Any = agent.learner("fast")
    expected = int(np.argmax(values.action_values(observation[:2])))
    assert [agent.act(observation) for _ in range(20)] == [expected] * 20
    assert len({agent.act(observation, explore=True) for _ in range(200)}) > 1
    agent.acting = "slow"
    other: Any = agent.learner("slow")
    assert agent.act(observation) == int(np.argmax(other.action_values(observation)))


def test_selector_acts(both: Path) -> None:
    """With the selector every episode has a learner of its own, more often the one of which it thinks more."""
    agent = apel.load(both, acting="selector")
    chosen = []
    world = apel.make_world(MAZE, run_seed=3)
    observation, _ = world.environment.reset(seed=5)
    for _ in range(300):
        agent.begin()
        agent.act(observation)
        chosen.append(agent.now)
    share = chosen.count("fast") / 300
    concentration = np.array(agent.content.scores)
    assert abs(share - concentration[1] / concentration.sum()) < 0.1


def test_floor(tmp_path: Path) -> None:
    """As trained, a floor lets one play that its selector never picks, as often as `apel.run.floor` has it at the end;
    without exploring nobody does. By hand: φ = (ρ Λ + what is lacking / 20) / L of the learner.
    """
    learners = [LEARNERS["q_learning"][1], LEARNERS["dyna_q"][1]]
    world = apel.make_world(MAZE, run_seed=3)
    ensemble = apel.Ensemble(world, learners, apel.Fixed(), 3, 99, acting_floor=apel.ActingFloor(0.3))
    for _ in range(60):
        ensemble.run_episode()
    ensemble.agent(MAZE, ["first", "other"]).save(tmp_path / "agent")
    agent = apel.load(tmp_path / "agent", acting="selector")
    selector, floor = agent.content.selector, agent.content.selector.floor
    assert floor is not None
    assert selector.row[:2].tolist() == [1.0, 0.0]  # the selector's own, in the middle of a run, too
    lacking = max(0.0, 0.3 * floor.played.sum() - floor.played[1]) / 20
    expected = (0.3 * floor.length[2] + lacking) / floor.length[1]
    observation, _ = world.environment.reset(seed=5)
    shares = []
    for explore in (True, False):
        now = []
        for _ in range(400):
            agent.begin()
            agent.act(observation, explore=explore)
            now.append(agent.now)
        shares.append(now.count("other") / 400)
    assert shares == [pytest.approx(expected, abs=0.1), 0.0]
    assert expected > 0.1
    found = agent.evaluate(episodes=30)
    first, other = (found.of(name, "as trained").episode_return for name in agent.names)
    together = found.of("(ensemble)", "as trained").episode_return
    assert (together != first).any()
    assert ((together == first) | (together == other)).all()
    greedy = found.of("(ensemble)", "greedy").episode_return
    np.testing.assert_array_equal(greedy, found.of("first", "greedy").episode_return)


def test_floor_to_come() -> None:
    """Where the floor has not begun, the selector's word counts in the agent as it did in the run."""
    learners = [LEARNERS["q_learning"][1], LEARNERS["dyna_q"][1]]
    floor = apel.ActingFloor(0.3, after=10**6)
    ensemble = apel.Ensemble(apel.make_world(MAZE, run_seed=3), learners, apel.Fixed(), 3, 99, acting_floor=floor)
    for _ in range(5):
        ensemble.run_episode()
    selector = ensemble.agent(MAZE, ["first", "other"]).content.selector
    assert selector.floor is None
    assert selector.row[:2].tolist() == [1.0, 0.0]


def test_evaluation(both: Path) -> None:
    """All play the same episodes, the same ones every time; the ensemble's are those of whom the selector picks."""
    agent = apel.load(both)
    found = agent.evaluate(episodes=30, seed=1)
    assert [(one.learner, one.mode) for one in found.played] == [
        ("slow", "greedy"), ("slow", "as trained"), ("fast", "greedy"), ("fast", "as trained"),
        ("(ensemble)", "greedy"), ("(ensemble)", "as trained"),
    ]  # fmt: skip
    again = apel.load(both).evaluate(episodes=30, seed=1)
    for one, other in zip(found.played, again.played, strict=True):
        np.testing.assert_array_equal(one.episode_return, other.episode_return)
    columns = np.stack([found.of(name).episode_return for name in agent.names])
    assert (found.of("(ensemble)").episode_return == columns).any(axis=0).all()
    fast = found.of("fast", "as trained")
    low, high = fast.interval
    assert low < fast.mean < high
    assert not np.array_equal(
        fast.episode_return, agent.evaluate(episodes=30, seed=2).of("fast", "as trained").episode_return
    )


def test_interval_of_many_episodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Resamples are drawn a few at a time where there are many episodes, in memory that does not grow with them."""
    returns = np.random.default_rng(3).normal(size=400)
    one = Played("Q", "greedy", returns, np.ones(400, dtype=np.int64))
    together = one.interval
    monkeypatch.setattr(evaluation, "_BATCH_NUMBERS", 1000)
    assert one.interval == pytest.approx(together, abs=0.01)
    assert together == pytest.approx((returns.mean() - 0.1, returns.mean() + 0.1), abs=0.02)


def test_cut_episodes(both: Path) -> None:
    """The ensemble's are those of whom it selected; as episodes they count once, with the learner that played them."""
    agent = apel.load(both, acting="selector")
    lengths = np.sort(np.concatenate([one.length for one in agent.evaluate(episodes=20, seed=1).played]))
    most = int(lengths[len(lengths) // 2])
    found = agent.evaluate(episodes=20, seed=1, max_steps=most)
    assert [one.num_cut for one in found.played] == [int((one.length == most).sum()) for one in found.played]
    of_learners = [found.of(name, mode).num_cut for name in agent.names for mode in evaluation.MODES]
    assert found.num_cut == sum(of_learners) > 0
    together = found.of("(ensemble)", "as trained").num_cut
    assert together < sum(found.of(name, "as trained").num_cut for name in agent.names)


def test_evaluation_learns_nothing(both: Path) -> None:
    """The agent is afterwards what it was before."""
    agent = apel.load(both)
    before = agent.digest
    agent.evaluate(episodes=2)
    assert agent.digest == before


def test_evaluation_elsewhere(both: Path) -> None:
    """Another environment is played if it has the same spaces."""
    agent = apel.load(both)
    cell = replace(MAZE, options={**MAZE.options, "max_steps": 3})
    assert agent.evaluate(cell, episodes=2).of("slow").length.max() <= 3
    with pytest.raises(
        ValueError, match=r"found an environment with the observations Box.*expected those of the agent"
    ):
        agent.evaluate("CartPole-v1", episodes=2)
    with pytest.raises(ValueError, match="found 0 episodes"):
        agent.evaluate(episodes=0)


def test_only(both: Path) -> None:
    """One learner of several is an agent, too."""
    agent = apel.load(both).only("slow")
    assert (agent.names, agent.best) == (["slow"], "slow")
    greedy = agent.evaluate(episodes=3).of("slow").episode_return
    np.testing.assert_array_equal(greedy, apel.load(both).evaluate(episodes=3).of("slow").episode_return)


def test_raw_observations() -> None:
    """An agent takes what the environment itself says, also where learners see something else."""
    config = apel.EnvironmentConfig("Blackjack-v1")
    agent = ensemble_of(config, [apel.LearnerConfig("q_learning")], 5).agent(config)
    raw, _ = gymnasium.make("Blackjack-v1").reset(seed=1)
    assert agent.act(raw) in (0, 1)


@pytest.mark.parametrize("name", ["worst", "(ensemble)"])
def test_unknown_learner(both: Path, name: str) -> None:
    """Whoever is not there is refused by name."""
    agent = apel.load(both)
    with pytest.raises(ValueError, match=r"expected one of \['slow', 'fast'\]"):
        agent.learner(name)
    with pytest.raises(ValueError, match="expected 'best', 'selector', or one of"):
        apel.load(both, acting=name)


def test_consent(tmp_path: Path) -> None:
    """Code that is not shipped is run only where somebody says so."""
    config, own = LEARNERS["own"]
    ensemble_of(config, [own], 2).agent(config).save(tmp_path / "agent")
    with pytest.raises(
        ValueError, match=r"found code that is not shipped.*\n.*learners.learner 0.type: 'tests.user_code:Walker'"
    ):
        apel.load(tmp_path / "agent")
    trusted: Any = apel.load(tmp_path / "agent", trust=True).learner("learner 0")
    assert trusted.num_seen > 0


def test_state_that_cannot_be_stored(tmp_path: Path) -> None:
    """A learner whose state is no tree of arrays is told of by its place."""
    agent = ensemble_of(MAZE, [LEARNERS["q_learning"][1]], 1).agent(MAZE)
    broken = replace(agent.content.learners[0], state=Forgetful(None, None, 1).state())
    with pytest.raises(ValueError, match=r"learners\[0\]\.state\.generator: found object, expected only"):
        apel.Agent(replace(agent.content, learners=(broken,))).save(tmp_path / "agent")
    assert not (tmp_path / "agent").exists()


def test_damaged_files(both: Path, tmp_path: Path) -> None:
    """What is not what was written is refused, and says which folder."""
    with pytest.raises(ValueError, match=r"found no agent\.json and arrays\.npz"):
        apel.load(tmp_path)
    text, arrays = (both / AGENT_FILE).read_bytes(), (both / ARRAYS_FILE).read_bytes()
    folder = tmp_path / "copy"
    folder.mkdir()
    told = json.loads(text)
    for changed, expected in (
        ({**told, "format": 99}, "format 99, expected 1"),
        ({**told, "origin": {**told["origin"], "seed": 4}}, "found another agent than the one whose digest"),
        ({"digest": told["digest"]}, "a state that is no agent"),
        ({name: part for name, part in told.items() if name != "spaces"}, "found a damaged agent"),
        ([], "found no agent"),
    ):
        (folder / AGENT_FILE).write_text(json.dumps(changed))
        (folder / ARRAYS_FILE).write_bytes(arrays)
        with pytest.raises(ValueError, match=expected) as caught:
            apel.load(folder)
        assert str(folder) in str(caught.value)
    (folder / AGENT_FILE).write_bytes(text)
    (folder / ARRAYS_FILE).write_bytes(arrays[:100])
    with pytest.raises(ValueError, match="found an unreadable state"):
        apel.load(folder)


def test_folder_of_something_else(both: Path, tmp_path: Path) -> None:
    """Nothing else is overwritten; an agent is."""
    (tmp_path / "letters.txt").write_text("dear")
    agent = apel.load(both)
    with pytest.raises(ValueError, match="found something that is no agent"):
        agent.save(tmp_path)
    agent.save(both)
    (both / f".{AGENT_FILE}.unfinished").write_text("{")  # a process died while it saved
    agent.save(both)
    assert {one.name for one in both.iterdir()} == {AGENT_FILE, ARRAYS_FILE}
