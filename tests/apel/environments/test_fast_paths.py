"""No fast path differs from its plain environment: Gymnasium's toy-text and classic-control sets with every documented
option, wrapped and not, and what users make of them.

What is expected comes from the plain environment: its chance is replaced by every u = (k + ½)/K in turn, so that the
outcomes of a state and an action are counted instead of drawn.
"""

from __future__ import annotations

import functools
import inspect
import itertools
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.registration import load_env_creator
from gymnasium.envs.toy_text import FrozenLakeEnv, TaxiEnv, frozen_lake
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, RecordEpisodeStatistics, TimeLimit

from apel.configs import EnvironmentConfig
from apel.dynamics.finite_model import FiniteModel
from apel.environments import CartPole, FiniteEnvironment, Maze, World, batched_environment, make_world
from apel.environments.batched import EnvironmentList
from apel.environments.cartpole import BatchedCartPole
from apel.environments.tables import TablesWarning
from apel.environments.unchanged import replacement_in
from tests.apel.models import lottery

K = 60
LIMIT = 25
SETS = ("gymnasium.envs.toy_text", "gymnasium.envs.classic_control")
CONTINUOUS = {"MountainCarContinuous-v0", "Pendulum-v1"}
IDS = [
    id_
    for id_, spec in gymnasium.registry.items()
    if isinstance(spec.entry_point, str) and spec.entry_point.startswith(SETS) and id_ not in CONTINUOUS
]
OPTIONS: dict[str, list[Any]] = {
    "desc": [["SFFH", "FFFG"], ["SSF", "FHS", "SFG"]],
    "fickle_passenger": [True],
    "fickle_probability": [0.9],
    "goal_velocity": [0.01],
    "is_rainy": [True],
    "is_slippery": [True, False],
    "map_name": ["4x4", "8x8"],
    "natural": [True],
    "rainy_probability": [0.5],
    "render_mode": ["rgb_array"],
    "reward_schedule": [(5, -3, -0.25)],
    "sab": [True],
    "success_rate": [0.9, 0.0, 1.0],
    "sutton_barto_reward": [True],
}
"""Of each constructor's option, values to try."""


class Case(NamedTuple):
    """An environment with options."""

    id: str
    options: dict[str, Any]

    def make(self) -> gymnasium.Env[Any, Any]:
        return gymnasium.make(self.id, max_episode_steps=LIMIT, disable_env_checker=True, **self.options)


def cases() -> Iterator[Case]:
    """Every id with its defaults, with each value of each option, and with all pairs of options of the finite ones."""
    for id_ in IDS:
        spec = gymnasium.registry[id_]
        names = list(inspect.signature(load_env_creator(spec.entry_point)).parameters)
        yield Case(id_, {})
        yield from (Case(id_, {name: value}) for name in names for value in OPTIONS[name])
        for one, other in itertools.combinations([name for name in names if name != "render_mode"], 2):
            yield Case(id_, {one: OPTIONS[one][0], other: OPTIONS[other][0]})


class Scaled(gymnasium.RewardWrapper[Any, Any]):
    def reward(self, reward: Any) -> float:
        return 10.0 * float(reward)


class Reversed(gymnasium.ObservationWrapper[Any, Any, Any]):
    def observation(self, observation: Any) -> Any:
        space: Any = self.observation_space
        return space.n - 1 - observation if isinstance(space, spaces.Discrete) else observation


class Swapped(gymnasium.ActionWrapper[Any, Any, Any]):
    def action(self, action: Any) -> Any:
        space: Any = self.action_space
        return space.n - 1 - action


class Hasty(gymnasium.Wrapper[Any, Any, Any, Any]):
    def step(self, action: Any) -> Any:
        observation, reward, _, truncated, info = self.env.step(action)
        return observation, reward, True, truncated, info


class Lenient(TimeLimit):
    """Changes nothing, but who knows."""


PLAIN: Callable[[Any], Any] = lambda environment: environment  # noqa: E731
NEUTRAL: list[Callable[[Any], Any]] = [
    PLAIN,
    OrderEnforcing,
    PassiveEnvChecker,
    functools.partial(TimeLimit, max_episode_steps=7),
    lambda environment: PassiveEnvChecker(TimeLimit(OrderEnforcing(environment), 9)),
]
MEDDLING: list[Callable[[Any], Any]] = [
    Scaled,
    Reversed,
    Swapped,
    Hasty,
    RecordEpisodeStatistics,
    functools.partial(Lenient, max_episode_steps=7),
    lambda environment: TimeLimit(Scaled(environment), 9),
]


class Chance:
    """A generator that always draws the same number."""

    def __init__(self, u: float) -> None:
        self.u = u

    def random(self) -> float:
        return self.u


def counted(act: Callable[[Any], Any], raw: Any) -> dict[Any, float]:
    """How often each outcome of `act` comes about, of K equally probable draws."""
    counts: Counter[Any] = Counter()
    for k in range(K):
        raw.np_random = Chance((k + 0.5) / K)
        counts[act(raw)] += 1
    return {outcome: count / K for outcome, count in counts.items()}


def of_tables(probability: np.ndarray, outcomes: list[Any]) -> dict[Any, float]:
    found: Counter[Any] = Counter()
    for outcome, p in zip(outcomes, np.diff(probability, prepend=0.0).tolist(), strict=True):
        found[outcome] += p
    return {outcome: p for outcome, p in found.items() if p > 0}


def step_from(state: int, action: int, raw: Any) -> tuple[int, float, bool]:
    raw.s = state
    observation, reward, terminated, truncated, _ = raw.step(action)
    assert not truncated
    return int(observation), float(reward), bool(terminated)


def check_tables(model: FiniteModel, raw: Any) -> None:
    """The tables have the outcomes of the plain environment, each as often as there."""
    raw.reset(seed=0)
    starts = counted(lambda raw: int(raw.reset()[0]), raw)
    assert starts == pytest.approx(of_tables(model.start_cumulative, model.start_cell.tolist()), abs=1.01 / K) or (
        len(model.start_cell) > K and set(starts) <= set(model.start_cell.tolist())
    )
    pairs = np.unique(np.linspace(0, model.next_cell.shape[0] * model.num_actions - 1, 40, dtype=int))
    for state, action in (divmod(int(pair), model.num_actions) for pair in pairs):
        columns = (column[state, action].tolist() for column in (model.next_cell, model.reward, model.terminal))
        expected = of_tables(model.cumulative[state, action], list(zip(*columns, strict=True)))
        found = counted(functools.partial(step_from, state, action), raw)
        assert found == pytest.approx(expected, abs=2.01 / K)
        assert set(found) == set(expected)


def played(environment: gymnasium.Env[Any, Any], seed: int) -> list[Any]:
    """An episode of random actions, as lists and numbers."""
    actions: Any = environment.action_space
    rng, told, is_over = np.random.default_rng(seed), [], False
    told.append(np.asarray(environment.reset(seed=seed)[0]).tolist())
    while not is_over:
        observation, reward, terminated, truncated, _ = environment.step(int(rng.integers(actions.n)))
        told.append((np.asarray(observation).tolist(), float(reward), bool(terminated), bool(truncated)))
        is_over = terminated or truncated
    return told


def world_of(make: Callable[[], gymnasium.Env[Any, Any]]) -> World:
    return make_world(EnvironmentConfig("tests:made"), 3, make)


def has_tables(case: Case) -> bool:
    return case.id.startswith(("FrozenLake", "CliffWalking", "Taxi")) and not case.options.get("fickle_passenger")


@pytest.mark.filterwarnings("ignore:.*out of date:DeprecationWarning")
@pytest.mark.parametrize("case", list(cases()), ids=str)
def test_no_fast_path_differs_from_the_plain_environment(case: Case) -> None:
    """With tables, they are those of the plain environment, its limit included; without, it is the plain one."""
    world = make_world(EnvironmentConfig(case.id, case.options, max_episode_steps=LIMIT), 3)
    assert (world.model is not None) == has_tables(case), world.reason
    if world.model is None:
        assert played(world.environment, 5) == played(case.make(), 5)
        assert type(batched_environment([world])) is EnvironmentList
        return
    assert world.model.max_steps == LIMIT
    check_tables(world.model, case.make().unwrapped)


@pytest.mark.filterwarnings("ignore:.*out of date:DeprecationWarning")
@pytest.mark.parametrize("case", [Case(id_, {}) for id_ in IDS], ids=str)
def test_wrapped_environments_are_played_as_they_are(case: Case) -> None:
    """Whatever a wrapper changes is played; those that change only the limit leave the tables, with the limit."""
    for wrap in MEDDLING:
        world = world_of(lambda wrap=wrap: wrap(case.make()))
        assert world.model is None
        assert played(world.environment, 5) == played(wrap(case.make()), 5)
        if has_tables(case):
            assert world.reason.startswith("wrapped by ")
    for wrap, limit in zip(NEUTRAL, (LIMIT, LIMIT, LIMIT, 7, 9), strict=True):
        world = world_of(lambda wrap=wrap: wrap(case.make()))
        assert (world.model.max_steps if world.model else None) == (limit if has_tables(case) else None)


# What users make of them


class Costly(FrozenLakeEnv):
    def step(self, a: Any) -> Any:
        observation, reward, *rest = super().step(a)
        return observation, reward - 0.01, *rest


class Elsewhere(FrozenLakeEnv):
    def reset(self, **options: Any) -> Any:
        _, info = super().reset(**options)
        self.s = 14
        return 14, info


class Rare(FrozenLakeEnv):
    """Differs where no trial of some hundred steps would see it."""

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def step(self, a: Any) -> Any:
        self.count += 1
        return super().step(a) if self.count < 10**6 else (0, 7.0, True, False, {})


class Curriculum(FrozenLakeEnv):
    """Its tables are another each time that they are looked at."""

    @property
    def P(self) -> Any:  # noqa: N802 - Gymnasium's name
        return self.tables

    @P.setter
    def P(self, tables: Any) -> None:  # noqa: N802
        self.tables = tables


class Meddling:
    def reset(self, **options: Any) -> Any:
        started: Any = super().reset(**options)
        return started


class Mixed(Meddling, FrozenLakeEnv):
    pass


class Beneath(FrozenLakeEnv, Meddling):
    pass


class Pond(FrozenLakeEnv):
    """Another map, and nothing else but a method that nobody calls."""

    def __init__(self) -> None:
        super().__init__(desc=["SFG", "FHF"], is_slippery=False)

    def size(self) -> int:
        return self.nrow * self.ncol


class Fickle(TaxiEnv):
    def __init__(self) -> None:
        super().__init__(fickle_passenger=True)


def changed(change: Callable[[Any], None], make: Callable[[], Any] = FrozenLakeEnv) -> Any:
    environment = make()
    change(environment)
    return environment


def freeze_start(environment: Any) -> None:
    environment.initial_state_distrib = np.eye(16)[3] * 0.5


def pay_everywhere(environment: Any) -> None:
    for actions in environment.P.values():
        for outcomes in actions.values():
            outcomes[:] = [(p, state, reward + 2.0, end) for p, state, reward, end in outcomes]


def count_from_one(environment: Any) -> None:
    environment.observation_space = spaces.Discrete(16, start=1)


def count_actions_from_one(environment: Any) -> None:
    environment.action_space = spaces.Discrete(4, start=1)


def step_for_free(environment: Any) -> None:
    environment.step = lambda action: (action, 1.0, False, False, {})


class CostlyMaze(Maze):
    def step(self, action: Any) -> Any:
        observation, reward, *rest = super().step(action)
        return observation, reward - 0.01, *rest


class SmallMaze(Maze):
    def __init__(self) -> None:
        super().__init__(size=3, max_steps=20)


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (Costly, "Costly overrides step"),
        (Elsewhere, "Elsewhere overrides reset"),
        (Rare, "Rare overrides step"),
        (Curriculum, "Curriculum defines P"),
        (Mixed, "Meddling overrides reset"),
        (Beneath, "Meddling overrides reset"),
        (Fickle, "its option fickle_passenger"),
        (lambda: changed(freeze_start), "the probabilities of its starts"),
        (lambda: changed(count_from_one), "its spaces"),
        (lambda: changed(count_actions_from_one), "its spaces"),
        (lambda: changed(step_for_free), "its step was replaced"),
        (lambda: changed(step_for_free, SmallMaze), "its step was replaced"),
        (lambda: changed(step_for_free, lambda: TimeLimit(FrozenLakeEnv(), 5)), "its step was replaced"),
        (CostlyMaze, "CostlyMaze overrides step"),
        (lambda: Scaled(SmallMaze()), "wrapped by Scaled"),
    ],
)
def test_what_users_change_is_played(make: Callable[[], Any], reason: str) -> None:
    """A subclass, a changed object, a wrapper: none of them is played by tables that know nothing of it."""
    world = make_world(EnvironmentConfig("tests:made", max_episode_steps=LIMIT), 3, make)
    assert (world.model, type(batched_environment([world]))) == (None, EnvironmentList)
    assert world.reason.startswith(reason)
    first: Any = world.environment.action_space
    if first.start == 0:
        assert played(world.environment, 5) == played(TimeLimit(make(), LIMIT), 5)


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (Pond, "Gymnasium's FrozenLakeEnv as Pond makes it"),
        (lambda: changed(pay_everywhere), "Gymnasium's FrozenLakeEnv, unchanged"),
        (SmallMaze, "Maze as SmallMaze makes it"),
    ],
)
def test_what_is_only_made_otherwise_keeps_its_tables(make: Callable[[], Any], reason: str) -> None:
    """Another map, other tables of Gymnasium's own environment: what it plays is what the tables say."""
    world = make_world(EnvironmentConfig("tests:made", max_episode_steps=LIMIT), 3, make)
    assert (world.model is not None, world.reason) == (True, reason)
    if isinstance(make(), FrozenLakeEnv):
        assert world.model is not None
        check_tables(world.model, make())


def replaced_step(self: Any, a: Any) -> Any:
    observation, _, *rest = original_step(self, a)
    return observation, 3.0, *rest


original_step = FrozenLakeEnv.step


@pytest.mark.parametrize(
    ("owner", "name", "replacement"),
    [
        (FrozenLakeEnv, "step", replaced_step),
        (FrozenLakeEnv, "step", functools.wraps(original_step)(replaced_step)),
        (FrozenLakeEnv, "step", FrozenLakeEnv.render),
        (gymnasium.Env, "reset", replaced_step),
        (frozen_lake, "categorical_sample", replaced_step),
    ],
)
def test_replaced_methods_of_gymnasium_are_noticed(
    owner: Any, name: str, replacement: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A function that was put in the place of one of the class's, its bases' or its module's."""
    environment = FrozenLakeEnv()
    assert replacement_in(environment, FrozenLakeEnv) is None
    monkeypatch.setattr(owner, name, replacement)
    assert replacement_in(environment, FrozenLakeEnv)


# Tables that a user's class declares


class Declared(gymnasium.Env[Any, Any]):
    """Two cells; the second one ends and pays ``pays``, while the tables say 1."""

    def __init__(self, pays: float = 1.0) -> None:
        self.observation_space, self.action_space = spaces.Discrete(2), spaces.Discrete(2)
        self.pays = pays

    @property
    def finite_model(self) -> FiniteModel:
        arrival = np.tile(np.array([0, 1]), (2, 1))[..., None]
        return FiniteModel(
            next_cell=arrival.astype(np.int32),
            cumulative=np.ones((2, 2, 1)),
            reward=arrival.astype(np.float64),
            terminal=arrival == 1,
            start_cell=np.zeros(1, dtype=np.int32),
            start_cumulative=np.ones(1),
            max_steps=12,
            features=("cell",),
            feature_sizes=(2,),
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.steps = 0
        return 0, {}

    def step(self, action: Any) -> Any:
        self.steps += 1
        return int(action), self.pays * action, action == 1, self.steps >= 12, {}


class Heir(Declared):
    """Steps otherwise, and says nothing of tables."""

    def step(self, action: Any) -> Any:
        return super().step(action)


class Raising(Declared):
    @property
    def finite_model(self) -> FiniteModel:
        return super().finite_model

    def step(self, action: Any) -> Any:
        message = "out of order"
        raise RuntimeError(message)


class Lucky(Declared):
    """Its tables are right, but its chance is its own: learners that play it would see other steps than tables give."""

    @property
    def finite_model(self) -> FiniteModel:
        return lottery(num_distractors=0)

    def __init__(self) -> None:
        super().__init__()
        model = self.finite_model
        self.observation_space = spaces.Discrete(model.num_states)
        self.action_space = spaces.Discrete(model.num_actions)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.cell = int(self.np_random.choice(self.finite_model.start_cell))
        return self.cell, {}

    def step(self, action: Any) -> Any:
        model = self.finite_model
        k = int(np.searchsorted(model.cumulative[self.cell, action], self.np_random.random(), side="right"))
        place = (self.cell, int(action), k)
        self.cell = int(model.next_cell[place])
        return self.cell, float(model.reward[place]), bool(model.terminal[place]), False, {}


class Textual(Declared):
    finite_model = "none"  # type: ignore[assignment]


def test_declared_tables_are_played_where_they_are_true() -> None:
    """Step for step the same: by tables; otherwise, or where somebody else steps, step by step, and it is said."""
    assert make_world(EnvironmentConfig("tests:made"), 3, Declared).reason == "those that Declared declares"
    with pytest.warns(TablesWarning, match=r"tests:made is played step by step, for it differs .* reward 2\.0 .*"):
        assert make_world(EnvironmentConfig("tests:made", {"pays": 2.0}), 3, Declared).model is None
    with pytest.warns(TablesWarning, match="out of order"):
        assert make_world(EnvironmentConfig("tests:made"), 3, Raising).model is None
    with pytest.warns(TablesWarning):
        assert make_world(EnvironmentConfig("tests:made"), 3, Lucky).model is None
    assert world_of(Heir).reason == "Heir overrides step, and declares no tables"
    assert world_of(Textual).reason == "its finite_model is no FiniteModel, but str"
    assert world_of(lambda: FiniteEnvironment(lottery())).reason == "FiniteEnvironment, unchanged"


def test_names_of_features_outlive_the_tables() -> None:
    """A maze whose rewards are scaled has distractors to leave out as before."""
    options = {"size": 3, "distractors": [4]}
    world = world_of(lambda: Scaled(gymnasium.make("apel/Maze-v0", **options)))
    assert (world.model, world.features) == (None, ("x", "y", "distractor"))


# Cart poles


def patient(environment: Any) -> None:
    environment._sutton_barto_reward = True


@pytest.mark.parametrize(
    ("change", "is_batched"),
    [(lambda _: None, True), (patient, False), (step_for_free, False), (count_actions_from_one, False)],
)
def test_changed_cart_poles_are_played_as_they_are(change: Callable[[Any], None], is_batched: bool) -> None:
    """One object that was changed is enough for a list."""
    plain = make_world(EnvironmentConfig("apel/CartPole-v0"), 1)
    world = replace(plain, environment=changed(change, CartPole))
    expected = BatchedCartPole if is_batched else EnvironmentList
    assert type(batched_environment([plain, world])) is expected
