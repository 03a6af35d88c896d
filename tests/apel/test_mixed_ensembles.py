"""Ensembles of Dyna-Q, votes, Q-learners and users' learners: the plain loop of Algorithm 5 and banks in streaks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from apel.configs import EnvironmentConfig, LearnerConfig
from apel.ensemble import Ensemble
from apel.environments import World, make_world
from apel.experience.representations import Representation
from apel.learners import CompiledBank, Decay, HasActionValues, LockstepBank
from apel.learners.base import StreakLimit, UnbuildableError
from apel.run.criterion import Criterion, Threshold
from apel.run.selection import Selector, freezes_policies, starts_epoch
from apel.selectors import Apel, Fixed, Uniform
from tests.apel.freezing import FreezingApel, FreezingUniform
from tests.apel.plain_selector import PlainSelector
from tests.apel.rounds import assert_same_rows, ensemble_rows, make_banks, play_rounds

HERE = "tests.apel.user_learner"
SEEDS = [1892932127, 501869158]
NEVER = Criterion("length", 3, below=0.5, evaluation="greedy")
GREEDY = Criterion("length", 5, below=Threshold(1.0, "optimal_length", plus=0.5), evaluation="greedy")

MAZE = EnvironmentConfig("apel/Maze-v0", {"size": 4, "distractors": [3], "max_steps": 30}, run_seed="maze_seed")
FROZEN_LAKE = EnvironmentConfig("FrozenLake-v1", max_episode_steps=30)
DECAYING = {"exploration": Decay(start=0.9, end=0.02, steps=600)}
FEW = Representation(exclude=("distractor",))


def learners_of(features: bool) -> dict[str, LearnerConfig]:
    """The learners by a letter; with ``features`` some do not see all."""
    few = FEW if features else Representation()
    q, reduced = LearnerConfig("q_learning", DECAYING), LearnerConfig("q_learning", {"tie_breaking": "first"}, few)
    dyna = LearnerConfig("dyna_q", {"planning_steps": 2, "learning_rate": 0.3}, few)
    opinionated = LearnerConfig(f"{HERE}:Opinionated", {"explore_every": 4})
    vote = LearnerConfig("voting", {"method": "boltzmann_addition", "temperature": 0.5}, members=(q, dyna))
    return {
        "q": q,
        "r": reduced,
        "d": dyna,
        "v": vote,
        "m": LearnerConfig("voting", {"temperature": 0.4}, members=(reduced, q, dyna)),
        "u": opinionated,
        # Members that are not compiled, and a vote of votes, go through the generic bank.
        "g": LearnerConfig("voting", {"method": "rank", "temperature": 0.4}, members=(dyna, opinionated)),
        "n": LearnerConfig("voting", {"temperature": 0.4}, members=(vote, reduced)),
    }


GENERIC = "ugn"
SELECTORS: list[Selector] = [Apel(decay=0.05), FreezingApel(decay=0.05), FreezingUniform(), PlainSelector(Uniform())]


def worlds_of(config: EnvironmentConfig) -> list[World]:
    return [make_world(config, seed) for seed in SEEDS]


@pytest.mark.parametrize("selector", SELECTORS, ids=["apel", "freezing apel", "freezing uniform", "plain uniform"])
@pytest.mark.parametrize("config", [MAZE, FROZEN_LAKE], ids=["maze", "lake"])
@pytest.mark.parametrize("letters", ["qd", "dvm", "rvu", "gqn"])
def test_ensemble_equals_banks(letters: str, config: EnvironmentConfig, selector: Selector) -> None:
    """Whoever is in it, frozen or not: the same rows from the loop, from banks, and from banks that are evaluated
    greedily after every episode.
    """
    learners = [learners_of(config is MAZE)[letter] for letter in letters]
    worlds, freezes = worlds_of(config), freezes_policies(selector)
    rows, times = ensemble_rows(learners, worlds, SEEDS, selector, 20)
    assert {row[1] for run in rows for row in rows[run]} == set(range(len(learners)))
    assert times == [None, None]
    for criterion, limit in ((None, StreakLimit(50, 10**4)), (NEVER, StreakLimit(3, 10**4))):
        banks = make_banks(
            learners, worlds, SEEDS, with_probability=True, freezes=freezes, evaluates=criterion is not None
        )
        assert [isinstance(bank, LockstepBank) for bank in banks] == [letter in GENERIC for letter in letters]
        played = play_rounds(banks, worlds, SEEDS, selector, 20, criterion=criterion, limit=limit)
        assert played.failures == []
        assert_same_rows(played.rows, rows)


@pytest.mark.parametrize("letters", ["d", "v", "gd"])
def test_greedy_train_time(letters: str) -> None:
    """With greedy evaluation a run stops where the walk without exploring is optimal, in the loop as in banks; until
    then its rows are those of a run that nobody measures.
    """
    learners, worlds = [learners_of(features=True)[letter] for letter in letters], worlds_of(MAZE)
    rows, times = ensemble_rows(learners, worlds, SEEDS, Apel(), 300, criterion=GREEDY)
    banks = make_banks(learners, worlds, SEEDS, evaluates=True, with_probability=True)
    played = play_rounds(banks, worlds, SEEDS, Apel(), 300, criterion=GREEDY)
    assert_same_rows(played.rows, rows)
    assert played.book.train_time.tolist() == times == [len(rows[0]), len(rows[1])]
    assert all(time is not None and 5 <= time < 300 for time in times)
    unmeasured, _ = ensemble_rows(learners, worlds, SEEDS, Apel(), max(map(len, rows.values())))
    assert_same_rows({run: unmeasured[run][: len(rows[run])] for run in rows}, rows)
    if letters == "d":
        # What is measured is the greedy walk: the episode itself, with ε = 0.1, is hardly ever optimal five times.
        assert any(row[3] > worlds[0].info["optimal_length"] for row in rows[0][-5:])


@pytest.mark.parametrize("letter", ["q", "d", "v", "u", "g"])
def test_frozen_policy_is_that_of_the_epoch(letter: str) -> None:
    """Within an epoch a learner's opinion of every state stays; it changes with the next one, to what it knows then."""
    world = make_world(EnvironmentConfig("apel/Maze-v0", {"size": 4, "maze_seed": 1, "max_steps": 60}), 1)
    learner = learners_of(features=False)[letter]
    ensemble = Ensemble(world, [learner, LearnerConfig("q_learning")], FreezingUniform(), 3, 31)
    opinions = []
    for _ in range(31):
        ensemble.run_episode()
        opinions.append(_opinions(ensemble))
    changes = [episode for episode in range(1, 31) if opinions[episode] != opinions[episode - 1]]
    assert changes == [1, 3, 7, 15]


def test_epochs() -> None:
    """Epoch β has 2^β episodes, and begins with episode 2^β − 1."""
    assert [episode for episode in range(70) if starts_epoch(episode)] == [0, 1, 3, 7, 15, 31, 63]


def _opinions(ensemble: Ensemble) -> list[list[float]]:
    learner = ensemble.learners[0]
    assert isinstance(learner, HasActionValues)
    return [learner.action_values(np.array([x, y])).tolist() for x in range(4) for y in range(4)]


def test_members_streams_are_their_own() -> None:
    """A member draws from a stream of its own place: neither that of the vote nor that of any other learner."""
    learner = learners_of(features=True)["d"]
    votes = replace(learners_of(features=True)["m"], members=(learner,) * 3)
    (bank,) = make_banks([votes], worlds_of(MAZE), SEEDS)
    alone = make_banks([learner] * 4, worlds_of(MAZE), SEEDS)
    assert isinstance(bank, CompiledBank)
    streams = [row for one in (bank, *alone) for row in one.state()["stream"].tolist()]
    streams += bank.state()["vote_stream"].tolist()
    assert len({tuple(row) for row in streams}) == len(streams) - 2  # learner 0 alone has the stream of the vote, twice


REFUSED = {
    "no members": (LearnerConfig("voting"), "expected members|expected at least one learner"),
    "a representation of the vote": (
        replace(learners_of(features=True)["m"], representation=FEW),
        "members, each with a representation of its own|a representation of a learner that has members",
    ),
    "a member without values": (
        LearnerConfig("voting", members=(LearnerConfig(f"{HERE}:AverageReward"),)),
        "found AverageReward, expected off-policy learners with action values",
    ),
    "a member that is not off-policy": (
        LearnerConfig("voting", members=(LearnerConfig(f"{HERE}:OnPolicy"),)),
        "found OnPolicy, expected off-policy learners with action values",
    ),
    "a method that is none": (
        LearnerConfig("voting", {"method": "plurality"}, members=(LearnerConfig("q_learning"),)),
        "voting: method: found 'plurality'",
    ),
    "no temperature": (
        LearnerConfig("voting", {"temperature": 0.0}, members=(LearnerConfig("q_learning"),)),
        "voting: temperature: found 0.0, expected greater than 0",
    ),
    "an option that is none": (
        LearnerConfig("voting", {"weights": [1]}, members=(LearnerConfig("q_learning"),)),
        "found the option 'weights', which it does not have",
    ),
    "no planning": (LearnerConfig("dyna_q", {"planning_steps": 0}), "planning_steps: found 0"),
    "members of one that holds none": (
        LearnerConfig("q_learning", members=(LearnerConfig("q_learning"),)),
        "found the option 'members', which it does not have",
    ),
    "a member's option": (
        LearnerConfig("voting", members=(LearnerConfig("q_learning", {"planning_steps": 3}),)),
        "q_learning: found the option 'planning_steps', which it does not have",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_learners(name: str) -> None:
    """What makes no sense is refused alike by the plain loop and by banks."""
    config, message = REFUSED[name]
    with pytest.raises((ValueError, UnbuildableError), match=message):
        make_banks([config], worlds_of(MAZE), SEEDS)
    with pytest.raises(ValueError, match=message):
        Ensemble(worlds_of(MAZE)[0], [config], Fixed(), 1, 5)


def test_learner_that_cannot_be_frozen_is_refused() -> None:
    """A selector that freezes policies takes only learners, and members, that can be frozen."""
    user = LearnerConfig(f"{HERE}:AverageReward")
    voting = LearnerConfig("voting", members=(LearnerConfig(f"{HERE}:Unfreezable"),))
    for config, message in (
        (user, "AverageReward has no freeze: its policy cannot be kept for an epoch"),
        (voting, "Unfreezable, expected learners that can be frozen"),
    ):
        with pytest.raises(UnbuildableError, match=message):
            make_banks([config], worlds_of(MAZE), SEEDS, freezes=True)
        make_banks([config], worlds_of(MAZE), SEEDS)


def test_learner_without_values_cannot_be_evaluated() -> None:
    """A greedy criterion takes only learners that say what they think of each action."""
    user = LearnerConfig(f"{HERE}:AverageReward")
    with pytest.raises(UnbuildableError, match="AverageReward has no action_values: it cannot be evaluated"):
        make_banks([user], worlds_of(MAZE), SEEDS, evaluates=True)
    with pytest.raises(ValueError, match="AverageReward has no action_values: it cannot be evaluated"):
        Ensemble(worlds_of(MAZE)[0], [user], Fixed(), 1, 5, criterion=NEVER)
