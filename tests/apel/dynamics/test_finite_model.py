from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from apel.dynamics.finite_model import FiniteModel, draw_distractor, draw_outcome, draw_start, stack_models
from apel.environments import FiniteEnvironment, Maze
from apel.numerics.streams import stream_of_seed
from tests.apel.models import lottery
from tests.apel.splitmix import SplitMix64


@pytest.mark.parametrize(
    ("num_distractors", "num_states", "num_distractor_values"), [(0, 3, 1), (1, 15, 5), (2, 75, 25)]
)
def test_distractors_multiply_the_states(num_distractors: int, num_states: int, num_distractor_values: int) -> None:
    """There are D states per cell, D the joint number of values of all distractors."""
    model = lottery(num_distractors=num_distractors)
    assert (model.num_states, model.num_distractor_values, model.num_actions) == (num_states, num_distractor_values, 2)


def test_states_are_numbered_cell_first() -> None:
    """State = cell · D + distractor, and the values of a state are its cell and its distractors."""
    values = lottery(num_distractors=2).feature_values()
    assert values.shape == (75, 3)
    for state, (cell, first, second) in enumerate(values.tolist()):
        assert state == cell * 25 + first * 5 + second


def test_stacked_models_share_what_is_one() -> None:
    """Runs that share a model share its tables; runs with their own have their own."""
    one, other = Maze(maze_seed=1, size=3).finite_model, Maze(maze_seed=2, size=3).finite_model
    tables = stack_models([one, other, one, one])
    assert tables.model.tolist() == [0, 1, 0, 0]
    assert tables.next_cell.shape == (2, 9, 4, 1)
    np.testing.assert_array_equal(tables.next_cell[1], other.next_cell)


def test_reward_codes_lose_nothing() -> None:
    """The rewards of all models, decoded, are the rewards of the models."""
    models = [lottery(), replace(lottery(), reward=lottery().reward * np.pi)]
    tables = stack_models(models)
    np.testing.assert_array_equal(tables.reward_value[tables.reward_code], np.stack([m.reward for m in models]))


@pytest.mark.parametrize(
    "other",
    [
        Maze(size=4).finite_model,
        Maze(size=3, distractors=(2,)).finite_model,
        Maze(size=3, max_steps=7).finite_model,
    ],
    ids=["size", "features", "step limit"],
)
def test_models_of_one_experiment_have_one_shape(other: FiniteModel) -> None:
    """Models that differ in size, features or step limit cannot be stacked."""
    with pytest.raises(ValueError, match="found tables of the shapes"):
        stack_models([Maze(size=3).finite_model, other])


def test_draws_follow_the_tables() -> None:
    """Start, outcome and distractor are the inverse of the cumulative tables at the stream's uniform draws."""
    model = lottery()
    tables = stack_models([model])
    stream, oracle = stream_of_seed(3), SplitMix64.of_seed(3)
    for _ in range(300):
        u = oracle.uniform()
        # 0 with probability 1/4, else 2; one uniform, then one distractor out of five.
        assert draw_start(tables, 0, stream) == ((0 if u < 0.25 else 2), oracle.integer(5))
        u = oracle.uniform()
        assert draw_outcome(tables, 0, 0, 0, stream) == (0 if u < 0.5 else 1 if u < 0.75 else 2)
        assert draw_distractor(tables, stream) == oracle.integer(5)
    assert int(stream[0]) == oracle.state


def test_what_is_certain_draws_nothing() -> None:
    """One start cell, one outcome, no distractor: no random number is spent, as every model's own stream expects."""
    tables = stack_models([Maze(size=3).finite_model])
    stream = stream_of_seed(3)
    before = stream.copy()
    draw_start(tables, 0, stream)
    draw_outcome(tables, 0, 0, 0, stream)
    draw_distractor(tables, stream)
    np.testing.assert_array_equal(stream, before)


def test_environment_plays_its_tables() -> None:
    """`FiniteEnvironment` is the tables with a stream: start, then per step outcome, then distractor."""
    model = lottery()
    environment = FiniteEnvironment(model)
    for seed in range(60):
        oracle = SplitMix64.of_seed(seed)
        cell = 0 if oracle.uniform() < 0.25 else 2
        observation, _ = environment.reset(seed=seed)
        assert observation.tolist() == [cell, oracle.integer(5)]
        for step in range(1, 21):
            action = (seed + step) % 2
            u = oracle.uniform()
            outcome = next(k for k in range(3) if u < model.cumulative[cell, action, k])
            expected_reward = model.reward[cell, action, outcome]
            expected_end = bool(model.terminal[cell, action, outcome])
            cell = int(model.next_cell[cell, action, outcome])
            observation, reward, terminated, truncated, info = environment.step(action)
            assert observation.tolist() == [cell, oracle.integer(5)]
            assert (reward, terminated, info) == (expected_reward, expected_end, {})
            assert truncated == (step == 20 and not expected_end)
            if terminated or truncated:
                break


def test_environment_frequencies() -> None:
    """Starts and outcomes come with their probabilities, within 5 standard errors."""
    environment = FiniteEnvironment(lottery(num_distractors=0))
    starts = np.array([environment.reset(seed=seed)[0] for seed in range(4_000)])
    assert abs(float(np.mean(starts == 0)) - 0.25) <= 5 * (0.25 * 0.75 / 4_000) ** 0.5
    nexts = []
    for seed in range(8_000):
        if environment.reset(seed=seed)[0] == 0:
            nexts.append(environment.step(0)[0])
    for cell, probability in enumerate((0.5, 0.25, 0.25)):
        frequency = nexts.count(cell) / len(nexts)
        assert abs(frequency - probability) <= 5 * (probability * (1 - probability) / len(nexts)) ** 0.5


def test_observation_of_one_feature_is_a_number() -> None:
    """With one feature the space is Discrete and observations are plain integers."""
    environment = FiniteEnvironment(lottery(num_distractors=0))
    observation, _ = environment.reset(seed=0)
    assert type(observation) is int
    assert environment.observation_space.contains(observation)


def test_terminal_step_at_the_limit_is_not_truncated() -> None:
    """An episode that ends by itself on its last permitted step is terminated, not truncated."""
    environment = FiniteEnvironment(lottery(max_steps=1, num_distractors=0))
    flags = set()
    for seed in range(50):
        environment.reset(seed=seed)
        flags.add(environment.step(1)[2:4])
    assert flags == {(True, False), (False, True)}


def test_observations_are_the_callers_own() -> None:
    """Writing into an observation does not change the environment."""
    environment = FiniteEnvironment(lottery())
    first, _ = environment.reset(seed=1)
    copy = first.copy()
    first[:] = 99
    assert environment.reset(seed=1)[0].tolist() == copy.tolist()
