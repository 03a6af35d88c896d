"""Several views of one step: each learner's channel, stack, reward and end, in every kind of bank."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from apel import EnvironmentConfig, LearnerConfig, Representation
from apel.building import make_bank, make_learner
from apel.ensemble import Ensemble
from apel.environments import World, make_world
from apel.experience.channels import ChannelledEnvironment, ChannelSpace
from apel.experience.frame_stacking import StackSpace
from apel.experience.trajectory import TrajectoryBatch
from apel.learners.banks.batched_learner import NO_ERRORS, Transitions
from apel.learners.banks.lockstep import LockstepBank
from apel.learners.base import StreakLimit
from apel.run.opening import open_book
from apel.selectors import Fixed, Uniform
from tests.apel.plain_agent import PlainAgent
from tests.channelled import Lives, Witness

LIVES = "tests.channelled:Lives"
WITNESS = "tests.channelled:Witness"


def world(**options: Any) -> World:
    return make_world(EnvironmentConfig(LIVES, options), 1, Lives)


def witness(representation: Representation) -> LearnerConfig:
    return LearnerConfig(WITNESS, representation=representation)


def witnesses(*representations: Representation, **options: Any) -> tuple[list[Witness], list[int]]:
    """What each learner was told in two episodes, the first of which the first learner plays, and who played them."""
    learners = [witness(one) for one in representations]
    ensemble = Ensemble(world(**options), learners, Uniform(), seed=3, num_episodes=6)
    selected = [record.selected for record in ensemble.run()]
    return ensemble.learners, selected  # type: ignore[misc]


def test_entries_hold_every_channel_and_signal_in_few_bytes() -> None:
    """A step is one element: 2 × 2 bytes, two numbers below 256, two signals of four bytes."""
    made = world()
    assert made.info == {}  # signals are of steps, not of runs
    space = made.environment.observation_space
    assert isinstance(space, ChannelSpace)
    assert space.entry_type.names == ("number", "picture", "wind", "bonus", "life_lost")
    assert space.entry_type.itemsize == 4 + 1 + 1 + 4 + 4
    made.environment.reset(seed=1)
    entry, reward, *_ = made.environment.step(0)
    assert (entry["number"], entry["bonus"], entry["life_lost"], reward) == (1, 1.0, 0.0, 10.0)
    assert entry["picture"].tolist() == [[1, 1], [1, 1]]


def test_each_learner_sees_its_own_world_and_the_score_is_the_games() -> None:
    """Whoever plays: the same steps reach every learner in its own terms; the selector compares the game's score."""
    pictures = Representation(channel="picture")
    numbers = Representation(channel="number", reward="bonus", terminal="life_lost")
    (seer, counter), selected = witnesses(pictures, numbers)
    assert set(selected) == {0, 1}  # both as actors and as those who learn from others
    assert seer.space == spaces.Box(0, 255, (2, 2), np.uint8)
    assert counter.space == spaces.Discrete(30)
    assert seer.episodes == counter.episodes == 6
    for start in range(0, 72, 12):
        own, other = seer.learned[start : start + 12], counter.learned[start : start + 12]
        assert [step[1] for step in own] == [step[1] for step in other]  # the same actions
        assert [step[2] for step in own] == [10.0] * 12
        assert [step[2] for step in other] == list(range(1, 13))
        assert [step[0] for step in own] == [[[t, t], [t, t]] for t in range(12)]
        assert [step[3] for step in other] == list(range(1, 13))
        assert [step[4] for step in own] == [False] * 11 + [True]
        assert [t + 1 for t, step in enumerate(other) if step[4]] == [3, 7, 12]
    record = Ensemble(world(), [witness(numbers)], Fixed(), seed=3, num_episodes=1).run_episode()
    assert (record.episode_return, record.length) == (120.0, 12)


def test_stacks_begin_anew_with_every_life() -> None:
    """Of the last three views, those before a life's first are like the first; the step that ends a life still shows
    what was there before.
    """
    (seer,), _ = witnesses(Representation(channel="picture", stack=3, terminal="life_lost"))
    assert isinstance(seer.space, StackSpace)
    assert seer.space.shape == (3, 2, 2)
    last = [[int(frame[0][0]) for frame in step[0]] for step in seer.learned[:12]]
    following = [[int(frame[0][0]) for frame in step[3]] for step in seer.learned[:12]]
    assert last[:5] == [[0, 0, 0], [0, 0, 1], [0, 1, 2], [3, 3, 3], [3, 3, 4]]
    assert following[:4] == [[0, 0, 1], [0, 1, 2], [1, 2, 3], [3, 3, 4]]
    assert (last[7], following[6], following[11]) == ([7, 7, 7], [5, 6, 7], [10, 11, 12])
    assert seer.learned[12][0] == [[[0, 0], [0, 0]]] * 3
    assert seer.acted == [step[0] for step in seer.learned]


def test_a_life_that_is_lost_as_the_game_is_cut_off_is_an_end_and_no_cut() -> None:
    """The game of 14 steps is truncated; for who ends with lives the 12th step is an end, the 14th a cut."""
    (seer,), _ = witnesses(Representation(channel="number", terminal="life_lost"), endless=True)
    assert [t + 1 for t, step in enumerate(seer.learned[:14]) if step[4]] == [3, 7, 12]
    assert [t + 1 for t, step in enumerate(seer.learned[:14]) if step[5]] == [14]


class BatchedWitness:
    """`Witness` for several runs."""

    off_policy = True
    is_alone = False
    errors = NO_ERRORS

    def __init__(self, num_runs: int) -> None:
        self.runs = [Witness(None, None, 0) for _ in range(num_runs)]

    def act(self, runs: Any, observation: Any) -> Any:
        actions = [self.runs[run].act(seen)[0] for run, seen in zip(runs, observation, strict=True)]
        return np.array(actions), np.full((len(runs), 3), 1 / 3)

    def learn(self, runs: Any, transitions: Transitions) -> None:
        for run, *step in zip(runs, *transitions[:6], strict=True):
            seen, action, reward, following, terminated, truncated = step
            entry = (seen.tolist(), int(action), float(reward), following.tolist(), bool(terminated), bool(truncated))
            self.runs[run].learned.append(entry)

    def lag(self, runs: Any) -> Any:
        # Out of step with each other for ever: what a run is told must not depend on it.
        return np.array([-(len(self.runs[run].learned) + run) % 3 for run in runs])

    def end_episode(self, runs: Any) -> None:
        for run in runs:
            self.runs[run].end_episode()


def stacked_bank(representation: Representation, worlds: Sequence[World]) -> tuple[LockstepBank, BatchedWitness]:
    """As `apel.building` would make it, around a witness."""
    config = LearnerConfig("dqn", {"network": {"hidden": [4]}, "head_hidden": []}, representation)
    bank = make_bank([config] * len(worlds), worlds, [1] * len(worlds), 0, "return", with_probability=True)
    assert isinstance(bank, LockstepBank)
    learner = BatchedWitness(len(worlds))
    bank.learner = learner  # type: ignore[assignment]
    return bank, learner


@pytest.mark.parametrize(
    "representation",
    [
        Representation(channel="picture", stack=4, reward="bonus", terminal="life_lost"),
        Representation(channel="number", terminal="life_lost"),
        Representation(channel="wind"),
    ],
)
@pytest.mark.parametrize("endless", [False, True])
def test_banks_tell_what_the_plain_loop_tells(representation: Representation, endless: bool) -> None:
    """Acting and learning from others, in lockstep or run by run: the same steps in the same order as of one member."""
    worlds = [world(endless=endless) for _ in range(3)]
    bank, stacked = stacked_bank(representation, worlds)
    book = open_book(Fixed(), 1, 3, None, [1, 2, 3], [{}] * 3)
    played = bank.play([0, 1, 2], book, Fixed(), 0, StreakLimit(2, 10_000), record=True)
    assert played.failures == ()
    batch = played.batch
    assert isinstance(batch, TrajectoryBatch)
    other_bank, learning = stacked_bank(representation, worlds)
    assert other_bank.learn(pickle.loads(pickle.dumps(batch))) == ()
    one = PlainAgent(witness(representation), worlds[1], 2, 0)
    for run, episode, trajectory in batch.trajectories():
        if run == 1:
            one.learn(trajectory, episode)
    expected = one.learner
    assert isinstance(expected, Witness)
    assert len(expected.learned) == (28 if endless else 24)
    for bank_witness in (stacked.runs[1], learning.runs[1]):
        assert bank_witness.learned == expected.learned
        assert bank_witness.episodes == expected.episodes == 2
    # Acting it saw what it then learned from, but for what it was before a life began anew.
    assert stacked.runs[1].acted == [step[0] for step in expected.learned]


def test_evaluation_stacks_as_acting_does() -> None:
    """Without exploring, an episode shows the same stacks."""
    representation = Representation(channel="picture", stack=3, terminal="life_lost")
    bank, learner = stacked_bank(representation, [world()])
    seen: list[Any] = []

    def action_values(runs: Any, observation: Any) -> Any:
        seen.append(observation[0].tolist())
        return np.zeros((1, 3))

    learner.action_values = action_values  # type: ignore[attr-defined]
    assert bank.evaluate_one(0, 1) == (12, 120.0)
    (witnessed,), _ = witnesses(representation)
    assert seen == witnessed.acted[:12]


@pytest.mark.parametrize(
    ("representation", "message"),
    [
        ({}, r"channel: found None, expected one of \['number', 'picture', 'wind'\]"),
        ({"channel": "smell"}, "channel: found 'smell', expected one of"),
        ({"channel": "bonus"}, "channel: found 'bonus', expected one of"),
        (
            {"channel": "wind", "reward": "number"},
            r"reward: found 'number', expected one of .*\['bonus', 'life_lost'\]",
        ),
        (
            {"channel": "wind", "terminal": "death"},
            "terminal: found 'death', expected one of the environment's signals",
        ),
        ({"channel": "wind", "stack": 2}, "stack: found 2 for Discrete.*, expected a Box"),
        ({"channel": "picture", "exclude": ["x"]}, "exclude: found 'x'"),
    ],
)
def test_what_is_not_there_is_refused(representation: dict[str, Any], message: str) -> None:
    """One line says what was found and what there is."""
    with pytest.raises(ValueError, match=message):
        make_learner(witness(Representation(**representation)), world(), 1, 0)


@pytest.mark.parametrize(
    ("representation", "message"),
    [
        ({"channel": "x"}, "channel: found 'x', but the environment has no channels"),
        ({"reward": "x"}, r"reward: found 'x', expected one of the environment's signals: \[\]"),
    ],
)
def test_plain_environments_have_no_channels(representation: dict[str, Any], message: str) -> None:
    """Of an ordinary environment nothing can be picked; nor of one that is played from tables."""
    cart_pole = make_world(EnvironmentConfig("apel/CartPole-v0"), 1)
    with pytest.raises(ValueError, match=message):
        make_learner(witness(Representation(**representation)), cart_pole, 1, 0)
    maze = make_world(EnvironmentConfig("apel/Maze-v0"), 1)
    config = LearnerConfig("q_learning", representation=Representation(**representation))
    with pytest.raises(ValueError, match="expected nothing but exclude"):
        make_bank([config], [maze], [1], 0, "return", with_probability=False)


@pytest.mark.parametrize("field", [{"stack": 2}, {"reward": "bonus"}, {"terminal": "life_lost"}])
def test_those_who_vote_pick_a_channel_and_no_more(field: dict[str, Any]) -> None:
    """A vote has members with channels of their own; it keeps no stacks and knows one reward for all."""
    members = (
        LearnerConfig("q_learning", representation=Representation(channel="number")),
        LearnerConfig("q_learning", representation=Representation(channel="wind")),
    )
    (record,) = Ensemble(world(), [LearnerConfig("voting", members=members)], Fixed(), 5, 1).run()
    assert record.length == 12
    bad = LearnerConfig("q_learning", representation=Representation(channel="picture", **field))
    with pytest.raises(ValueError, match="found stack, reward or terminal of a learner that votes"):
        make_learner(LearnerConfig("voting", members=(bad,)), world(), 1, 0)


def test_names_must_differ() -> None:
    """A channel and a signal of one name could not both be fields."""
    with pytest.raises(ValueError, match="expected different names"):
        ChannelSpace(Lives.observation_space, ["wind"])


def test_signals_need_channels() -> None:
    """An environment that declares signals has a Dict of plain spaces as observations."""

    class Odd(gymnasium.Env[Any, Any]):
        observation_space = spaces.Box(0, 1, (3,))
        action_space = spaces.Discrete(2)

    with pytest.raises(ValueError, match="expected a Dict of plain ones"):
        ChannelledEnvironment(Odd(), ["bonus"])


def test_an_environment_that_forgets_a_signal_fails_its_run_alone() -> None:
    """The error names the signal; other runs go on."""

    class Forgetful(Lives):
        def step(self, action: Any) -> Any:
            observation, reward, terminated, truncated, _ = super().step(action)
            return observation, reward, terminated, truncated, {"bonus": 1.0}

    bad = make_world(EnvironmentConfig(LIVES), 1, Forgetful)
    bank, _ = stacked_bank(Representation(channel="number"), [world(), bad])
    book = open_book(Fixed(), 1, 2, None, [1, 2], [{}] * 2)
    played = bank.play([0, 1], book, Fixed(), 0, StreakLimit(2, 10_000), record=True)
    assert [(failure.run, failure.error) for failure in played.failures] == [(1, "KeyError: 'life_lost'")]
    assert played.episodes.run.tolist() == [0, 0]
