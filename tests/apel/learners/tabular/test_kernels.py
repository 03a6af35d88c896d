"""Dyna-Q, voting, frozen policies, first ties and greedy evaluation: the compiled loops against plain ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from apel.dynamics.finite_model import FiniteModel
from apel.experience.representations import Representation, state_rows
from apel.experience.trajectory import TrajectoryBatch
from apel.learners import (
    CompiledBank,
    Decay,
    DynaQOptions,
    QLearningOptions,
    Switch,
    TabularLearner,
    TabularMember,
    VotingOptions,
)
from apel.learners.base import StreakLimit
from apel.run.criterion import Criterion
from apel.run.opening import open_book
from apel.run.state import FINISHED, Book
from apel.selectors import Fixed
from tests.apel.freezing import FreezingFixed
from tests.apel.models import frozen_lakes, lottery, mazes
from tests.apel.plain_q_learning import PlainEpisode, PlainLearner, PlainQLearning, constant, decaying, switched
from tests.apel.plain_voting import PlainVoting

KEYS = [0x123456789ABCDEF0, 2**64 - 5, 17]
UNLIMITED = StreakLimit(10**6, 10**5)
MODELS: dict[str, Callable[[], list[FiniteModel]]] = {
    "maze": lambda: mazes(max_steps=40),
    "frozen lake": frozen_lakes,
    "lottery": lambda: [lottery(num_distractors=2)] * 3,
}
GREEDY = Criterion("length", 10_000, below=1.0, evaluation="greedy")
GREEDY_RETURN = replace(GREEDY, measure="return")


@dataclass(frozen=True)
class Case:
    """One learner in three runs; ``excluded`` are the features that its members (or it) do not see, by position."""

    model: str
    members: tuple[QLearningOptions, ...]
    excluded: tuple[tuple[int, ...], ...] = ((),)
    voting: VotingOptions | None = None
    freezes: bool = False
    episodes: int = 32


Q, FIRST = QLearningOptions(), QLearningOptions(tie_breaking="first")
DYNA, SOME = DynaQOptions(planning_steps=5), DynaQOptions(planning_steps=2)
DECAYING = DynaQOptions(0.5, 0.9, Decay(start=0.9, end=0.05, steps=500), "random", 3)
SWITCHED = DynaQOptions(0.25, 1.0, Switch(before=0.8, episode=20, after=0.01), "first", 1)
LOTTERY = DynaQOptions(1.0, 0.5, 0.2, "random", 10)
VOTINGS = {
    method: VotingOptions(method, temperature, 0.3)  # type: ignore[arg-type]
    for method, temperature in (
        ("majority", 0.7),
        ("rank", 0.9),
        ("boltzmann_addition", 0.5),
        ("boltzmann_multiplication", 1.5),
    )
}
CASES = {
    "first": Case("maze", (FIRST,)),
    "first, frozen": Case("maze", (FIRST,), freezes=True),
    "frozen": Case("maze", (Q,), freezes=True),
    "frozen lake, frozen": Case("frozen lake", (QLearningOptions(0.2, 0.97, 0.3),), freezes=True, episodes=200),
    "dyna": Case("maze", (DYNA,)),
    "dyna, frozen": Case("maze", (DYNA,), ((2,),), freezes=True),
    "dyna of a changing state": Case("maze", (DECAYING,), ((0, 2),)),
    "dyna, switched, first": Case("maze", (SWITCHED,), ((2,),)),
    "dyna on frozen lake": Case("frozen lake", (replace(DYNA, exploration=0.3),), episodes=100),
    "dyna in the lottery": Case("lottery", (LOTTERY,), ((1,),), episodes=100),
    "dyna in the lottery, frozen": Case("lottery", (LOTTERY,), ((1, 2),), freezes=True, episodes=100),
    **{
        f"{method}{', frozen' * freezes}": Case("maze", (Q, SOME, FIRST), ((2,), (), (0,)), voting, freezes)
        for method, voting in VOTINGS.items()
        for freezes in (False, True)
    },
    "majority of one": Case("frozen lake", (Q,), ((),), VOTINGS["majority"], episodes=100),
    "addition in the lottery": Case("lottery", (LOTTERY, Q), ((), (1,)), VOTINGS["boltzmann_addition"], episodes=100),
    "cool majority": Case("maze", (Q, Q), ((2,), ()), VotingOptions()),
}
FEW = ("dyna, frozen", "majority, frozen", "boltzmann_addition")
cases = pytest.mark.parametrize("case", CASES.values(), ids=CASES)


def explorations(options: QLearningOptions) -> Callable[[int, int], float]:
    match options.exploration:
        case Decay(start, end, steps):
            return decaying(start, end, steps)
        case Switch(before, episode, after):
            return switched(before, episode, after)
        case float(rate):
            return constant(rate)


def seed_of(run: int, member: int) -> int:
    return 2**64 - 1 - 1000 * run - member


def make_bank(case: Case, models: Sequence[FiniteModel]) -> CompiledBank:
    learners = [
        TabularLearner(
            tuple(
                TabularMember(options, Representation(exclude=excluded), seed_of(run, m))
                for m, (options, excluded) in enumerate(zip(case.members, case.excluded, strict=True))
            ),
            case.voting,
            seed_of(run, 100),
        )
        for run in range(len(models))
    ]
    return CompiledBank(models, KEYS, learners, "return", with_probability=True, freezes=case.freezes)


def make_plain(case: Case, models: Sequence[FiniteModel]) -> tuple[list[PlainLearner], list[list[PlainQLearning]]]:
    """Of each run who acts, and the tables that it holds."""
    tables = [
        [
            PlainQLearning(
                model,
                KEYS[run],
                seed_of(run, m),
                options.learning_rate,
                options.discount,
                explorations(options),
                [i for i in range(len(model.features)) if i not in excluded],
                takes_first=options.tie_breaking == "first",
                planning_steps=options.planning_steps if isinstance(options, DynaQOptions) else 0,
                freezes=case.freezes,
            )
            for m, (options, excluded) in enumerate(zip(case.members, case.excluded, strict=True))
        ]
        for run, model in enumerate(models)
    ]
    if case.voting is None:
        return [members[0] for members in tables], tables
    voting = case.voting
    voters = [
        PlainVoting(
            model,
            KEYS[run],
            seed_of(run, 100),
            tables[run],
            voting.method,
            voting.temperature,
            voting.member_temperature,
        )
        for run, model in enumerate(models)
    ]
    return list(voters), tables


def open_three(case: Case, criterion: Criterion | None = None) -> tuple[Book, Fixed]:
    selector = FreezingFixed() if case.freezes else Fixed()
    return open_book(selector, 1, case.episodes, criterion, [1, 2, 3], [{}] * 3), selector


def assert_same_episodes(batch: TrajectoryBatch | None, plain: Sequence[PlainLearner]) -> None:
    """Step for step; the plain learners play along."""
    assert batch is not None
    for run, episode, trajectory in batch.trajectories():
        played = plain[run].play(episode)
        assert trajectory.observation.tolist() == played.states
        assert trajectory.action.tolist() == played.actions
        assert trajectory.reward.tolist() == played.rewards
        assert trajectory.terminated == played.terminated
        assert trajectory.probability is not None
        np.testing.assert_allclose(trajectory.probability, played.probabilities, rtol=0, atol=1e-12)


def assert_same_tables(
    bank: CompiledBank, tables: Sequence[Sequence[PlainQLearning]], models: Sequence[FiniteModel], case: Case
) -> None:
    """Every value of every table, acting and frozen, without any tolerance."""
    state, position = bank.state(), 0
    for run, model in enumerate(models):
        for member, excluded in enumerate(case.excluded):
            rows = state_rows(Representation(exclude=excluded), model.features, model.feature_values())
            plain = tables[run][member]
            assert state["value"][position][rows].tolist() == [plain.values(s) for s in range(model.num_states)]
            if case.freezes:
                assert state["frozen"][position][rows].tolist() == [plain.judged(s) for s in range(model.num_states)]
            position += 1
    assert len(state["value"]) == position
    assert len(state["frozen"]) == (position if case.freezes else 0)


@cases
def test_streaks_equal_the_plain_loop(case: Case) -> None:
    """Compiled streaks give the plain loop's episodes, step for step, and its tables, value for value."""
    models = MODELS[case.model]()
    bank, (plain, tables) = make_bank(case, models), make_plain(case, models)
    book, selector = open_three(case)
    answer = bank.play([0, 1, 2], book, selector, 0, UNLIMITED, record=True)
    assert answer.failures == ()
    assert book.status.tolist() == [FINISHED] * 3
    assert_same_episodes(answer.batch, plain)
    assert_same_tables(bank, tables, models, case)
    assert len({tuple(row) for row in bank.state()["stream"].tolist()}) == 3 * len(case.members)


@cases
def test_learning_from_a_batch_equals_plain_updates(case: Case) -> None:
    """On episodes of others it updates, plans and freezes as the plain loop does; then it acts on what it learned."""
    models = MODELS[case.model]()
    actor = make_bank(Case(case.model, (QLearningOptions(exploration=0.5),)), models)
    batch = actor.play([0, 1, 2], open_three(replace(case, episodes=13))[0], Fixed(), 0, UNLIMITED, record=True).batch
    assert batch is not None
    bank, (plain, tables) = make_bank(case, models), make_plain(case, models)
    assert bank.learn(batch) == ()
    for run, episode, trajectory in batch.trajectories():
        steps = (trajectory.observation, trajectory.action, trajectory.reward)
        states, actions, rewards = (column.tolist() for column in steps)
        plain[run].learn_episode(PlainEpisode(states, actions, rewards, terminated=trajectory.terminated), episode)
    assert_same_tables(bank, tables, models, case)
    # Episode 13 lies within the epoch 7 … 14: what was frozen before episode 7 is what it acts on.
    book, selector = open_three(replace(case, episodes=17))
    book.episode[:] = 13
    assert_same_episodes(bank.play([0, 1, 2], book, selector, 0, UNLIMITED, record=True).batch, plain)
    assert_same_tables(bank, tables, models, case)


@pytest.mark.parametrize(
    ("name", "cut"), [*((name, 5) for name in CASES), *((name, cut) for name in FEW for cut in (1, 6, 7))]
)
def test_restored_bank_goes_on_identically(name: str, cut: int) -> None:
    """State and book carried over to a new bank, in mid-epoch (after 1, 5 or 6 episodes) or at its end (after 7), give
    the plain loop's episodes from there on.
    """
    case, models = CASES[name], MODELS[CASES[name].model]()
    bank, (plain, tables) = make_bank(case, models), make_plain(case, models)
    book, selector = open_three(replace(case, episodes=16))
    assert_same_episodes(bank.play([0, 1, 2], book, selector, 0, StreakLimit(cut, 10**6), record=True).batch, plain)
    state = bank.state()
    other, other_book = make_bank(case, models), open_three(replace(case, episodes=16))[0]
    other.play([0, 2], open_three(case)[0], selector, 0, StreakLimit(3, 10**6), record=False)
    other.restore(state)
    for column, values in zip(other_book, book, strict=True):
        if isinstance(column, np.ndarray):
            column[...] = values
    bank.play([0, 1, 2], book, selector, 0, UNLIMITED, record=False)  # whose state must be a copy
    assert_same_episodes(other.play([0, 1, 2], other_book, selector, 0, UNLIMITED, record=True).batch, plain)
    assert_same_tables(other, tables, models, case)


@pytest.mark.parametrize(
    ("name", "criterion"), [*((name, GREEDY) for name in CASES), *((name, GREEDY_RETURN) for name in FEW)]
)
def test_greedy_evaluation_equals_the_plain_loop(name: str, criterion: Criterion) -> None:
    """What a greedy criterion measures is another episode, on the values that the policy acts on; no row moves."""
    models, case = MODELS[CASES[name].model](), replace(CASES[name], episodes=17)
    results: list[list[Any]] = []
    for one in (criterion, None):
        bank = make_bank(case, models)
        book, selector = open_three(case, one)
        episodes = bank.play([0, 1, 2], book, selector, 0, UNLIMITED, record=False).episodes
        if one is not None:
            plain, _ = make_plain(case, models)
            position = 0
            for run in range(3):
                for episode in range(case.episodes):
                    plain[run].play(episode)
                    length, total = plain[run].evaluate(episode)
                    expected = float(length) if one.measure == "length" else total
                    assert episodes.measure[position] == expected
                    position += 1
            assert position == len(episodes.run)
        columns = [column.tolist() for column in episodes._replace(measure=episodes.length)]
        results.append([columns, {name: values.tolist() for name, values in bank.state().items()}])
    assert results[0] == results[1]


@pytest.mark.parametrize("name", FEW)
def test_streak_limits_change_nothing(name: str) -> None:
    """Streaks of 1, 5 or 50 episodes, or of few steps, give the same tables and episodes."""
    case, models, results = CASES[name], MODELS[CASES[name].model](), []
    for limit in (StreakLimit(1, 10**6), StreakLimit(5, 10**6), StreakLimit(50, 10**6), StreakLimit(50, 3)):
        bank, (book, selector) = make_bank(case, models), open_three(case, GREEDY)
        rows: dict[int, list[Any]] = {0: [], 1: [], 2: []}
        while (runs := np.flatnonzero(book.status != FINISHED).tolist()) != []:
            episodes = bank.play(runs, book, selector, 0, limit, record=False).episodes
            for run, *row in zip(*(column.tolist() for column in episodes), strict=True):
                rows[run].append(row)
        results.append((rows, {name: values.tolist() for name, values in bank.state().items()}))
    assert all(result == results[0] for result in results[1:])
    assert len(results[0][0][0]) == case.episodes


def test_policy_changes_only_between_epochs() -> None:
    """In the episodes 2^β − 1 … 2^(β+1) − 2 a frozen learner without exploration repeats itself where nothing is left
    to chance; the first epochs begin with the episodes 0, 1, 3, 7, 15. Its first action, worth −1, it takes again until
    the next epoch begins.
    """
    model = replace(lottery(num_distractors=0), start_cumulative=np.array([0.0, 1.0]))
    model = replace(model, cumulative=np.ones_like(model.cumulative), terminal=np.zeros_like(model.terminal))
    case = Case("lottery", (QLearningOptions(exploration=0.0, tie_breaking="first"),), freezes=True, episodes=31)
    bank, (book, selector) = make_bank(case, [model] * 3), open_three(case)
    batch = bank.play([0, 1, 2], book, selector, 0, UNLIMITED, record=True).batch
    assert batch is not None
    played = [trajectory.action.tolist() for run, _, trajectory in batch.trajectories() if run == 0]
    changes = [episode for episode, (one, next_one) in enumerate(pairwise(played), 1) if one != next_one]
    assert changes
    assert set(changes) <= {1, 3, 7, 15}
