"""Compiled loops of tabular learners (Algorithm 2): one episode, acted and learned, and one greedy episode.

An environment step with its update costs tens of nanoseconds here. The readable statements of the same algorithms are
`apel.learners.tabular.q_learning`, `apel.learners.tabular.dyna_q` and `apel.learners.tabular.voting`; both draw the
same numbers in the same order.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.finite_model import FiniteTables, draw_distractor, draw_outcome, draw_start
from apel.learners.tabular.tables import NO_VOTE, Tables
from apel.learners.tabular.voting import boltzmann, preferences
from apel.numerics.compiled import njit
from apel.numerics.streams import Stream, categorical, integer, uniform
from apel.run.selection import starts_epoch


class TrajectoryRoom(NamedTuple):
    """Where trajectories are written: N steps of room."""

    observation: NDArray[Any]
    action: NDArray[Any]
    reward_code: NDArray[Any]
    probability: NDArray[np.float64]
    """``float64[N, actions]``, or ``float64[0, actions]`` where nobody asked for it."""


@njit(inline="always")
def _exploration_rate(tables: Tables, member: int) -> float:
    if tables.decay_steps[member] > 0.0:
        start, end = tables.exploration[member, 0], tables.exploration[member, 1]
        return end + (start - end) * math.exp(-tables.steps[member] / tables.decay_steps[member])
    is_before = tables.episode[member] < tables.switch_episode[member]
    return tables.exploration[member, 0] if is_before else tables.exploration[member, 1]


@njit(inline="always")
def _maximum(values: NDArray[np.float64], row: int) -> float:
    best = values[row, 0]
    for action in range(1, values.shape[1]):
        best = values[row, action] if values[row, action] > best else best
    return best


@njit(inline="always")
def _greedy(values: NDArray[np.float64], row: int) -> tuple[float, int, int]:
    """The best value, the first action that has it, and how many have it."""
    # Without branches, which would be mispredicted.
    best = _maximum(values, row)
    first, ties = 0, 0
    for action in range(values.shape[1] - 1, -1, -1):
        equal = values[row, action] == best
        ties += equal
        first = action if equal else first
    return best, first, ties


@njit(inline="always")
def _break_tie(values: NDArray[np.float64], row: int, best: float, position: int) -> int:
    """The action at ``position`` among those of the best value."""
    for action in range(values.shape[1]):
        if values[row, action] == best:
            if position == 0:
                return action
            position -= 1
    return 0


@njit
def _write_probability(
    probability: NDArray[np.float64], values: NDArray[np.float64], row: int, greedy: int, ties: int, exploration: float
) -> None:
    """μ(·|s) of the ε-greedy policy, with the values before this step's update; one tie where the first is taken."""
    num_actions = values.shape[1]
    for action in range(num_actions):
        is_greedy = action == greedy if ties == 1 else values[row, action] == values[row, greedy]
        probability[action] = exploration / num_actions + ((1.0 - exploration) / ties if is_greedy else 0.0)


@njit(inline="always")
def _update(
    values: NDArray[np.float64], row: int, action: int, reward: float, next_value: float, rate: float, discount: float
) -> None:
    """Eq. 2.8."""
    target = reward + discount * next_value
    values[row, action] += rate * (target - values[row, action])


@njit
def _plan(tables: Tables, member: int, row: int, action: int, reward: float, next_row: int, terminal: bool) -> None:
    """Dyna-Q: remember what happened, then learn from pairs that were seen before."""
    values = tables.value[member]
    rate, discount = tables.learning_rate[member], tables.discount[member]
    num_actions = values.shape[1]
    pair = row * num_actions + action
    if tables.model_row[member, pair] < 0:
        tables.pair[member, tables.num_pairs[member]] = pair
        tables.num_pairs[member] += 1
    tables.model_row[member, pair] = next_row
    tables.model_reward[member, pair] = reward
    tables.model_terminal[member, pair] = terminal
    for _ in range(tables.planning_steps[member]):
        drawn = np.int64(tables.pair[member, integer(tables.stream[member], tables.num_pairs[member])])
        next_value = 0.0
        if not tables.model_terminal[member, drawn]:
            next_value = _maximum(values, np.int64(tables.model_row[member, drawn]))
        reward = tables.model_reward[member, drawn]
        _update(values, drawn // num_actions, drawn % num_actions, reward, next_value, rate, discount)


@njit(inline="always")
def learn_step(
    tables: Tables,
    member: int,
    values: NDArray[np.float64],
    row: int,
    action: int,
    reward: float,
    next_row: int,
    terminal: bool,
) -> None:
    """Eq. 2.8 for one observed step of one member with the table ``values``, and its planning."""
    next_value = 0.0 if terminal else _maximum(values, next_row)
    _update(values, row, action, reward, next_value, tables.learning_rate[member], tables.discount[member])
    if tables.planning_steps[member] > 0:
        _plan(tables, member, row, action, reward, next_row, terminal)


@njit(inline="always")
def freeze_at_epoch(tables: Tables, run: int, episode: int) -> None:
    """Where policies are frozen: at the beginning of an epoch, act from now on on what is known now."""
    if tables.frozen.shape[0] > 0 and starts_epoch(episode):
        for member in range(run * tables.num_members, (run + 1) * tables.num_members):
            tables.frozen[member] = tables.value[member]


@njit(inline="always")
def _acting(tables: Tables, member: int) -> NDArray[np.float64]:
    """The values that the policy acts on."""
    return tables.frozen[member] if tables.frozen.shape[0] > 0 else tables.value[member]


@njit
def play_episode(
    world: FiniteTables,
    tables: Tables,
    run: int,
    episode: int,
    environment_stream: Stream,
    recording: TrajectoryRoom,
    start: int,
    position: int,
    record: bool,
) -> tuple[int, float, bool]:
    """One episode, learning while acting: its length, its return, and whether it terminated.

    Step t is recorded at ``start + t``, observations one place later per recorded episode (``position`` of them
    before).
    """
    freeze_at_epoch(tables, run, episode)
    if tables.method[run] != NO_VOTE:
        played = _play_voting(world, tables, run, environment_stream, recording, start, position, record)
    else:
        played = _play_exploring(world, tables, run, environment_stream, recording, start, position, record)
    for member in range(run * tables.num_members, (run + 1) * tables.num_members):
        tables.episode[member] += 1
    return played


@njit
def _play_exploring(
    world: FiniteTables,
    tables: Tables,
    run: int,
    environment_stream: Stream,
    recording: TrajectoryRoom,
    start: int,
    position: int,
    record: bool,
) -> tuple[int, float, bool]:
    """ε-greedy."""
    model = world.model[run]
    next_cell, code_of, terminal_of = world.next_cell[model], world.reward_code[model], world.terminal[model]
    rows, values, stream = tables.row[tables.row_set[run]], tables.value[run], tables.stream[run]
    rate, discount = tables.learning_rate[run], tables.discount[run]
    decays, plans = tables.decay_steps[run] > 0.0, tables.planning_steps[run] > 0
    freezes, takes_first = tables.frozen.shape[0] > 0, tables.takes_first[run]
    acting = _acting(tables, run)
    exploration = _exploration_rate(tables, run)
    cell, distractor = draw_start(world, model, environment_stream)
    state = cell * world.num_distractor_values + distractor
    row = np.int64(rows[state])
    best, greedy, ties = _greedy(acting, row)
    total = 0.0
    for step in range(world.max_steps):
        ties = 1 if takes_first else ties
        if uniform(stream) < exploration:
            action = integer(stream, values.shape[1])
        else:
            action = greedy if ties == 1 else _break_tie(acting, row, best, integer(stream, ties))
        outcome = draw_outcome(world, model, cell, action, environment_stream)
        reward_code = code_of[cell, action, outcome]
        reward = world.reward_value[reward_code]
        terminal = terminal_of[cell, action, outcome]
        if record:
            recording.observation[start + position + step] = state
            recording.action[start + step] = action
            recording.reward_code[start + step] = reward_code
            if recording.probability.shape[0] > 0:
                _write_probability(recording.probability[start + step], acting, row, greedy, ties, exploration)
        cell = np.int64(next_cell[cell, action, outcome])
        state = cell * world.num_distractor_values + draw_distractor(world, environment_stream)
        next_row = np.int64(rows[state])
        best, greedy, ties = _greedy(values, next_row)
        _update(values, row, action, reward, 0.0 if terminal else best, rate, discount)
        tables.steps[run] += 1
        if plans:
            _plan(tables, run, row, action, reward, next_row, terminal)
        if freezes or plans or next_row == row:
            best, greedy, ties = _greedy(acting, next_row)
        row = next_row
        total += reward
        if decays:
            exploration = _exploration_rate(tables, run)
        if terminal:
            break
    if record:
        recording.observation[start + position + step + 1] = state
    return step + 1, total, terminal


@njit
def _read_preferences(
    tables: Tables, run: int, state: int, draws: bool, values: NDArray[np.float64], preference: NDArray[np.float64]
) -> None:
    """What the members of a voting learner think of a state; ``values`` is room for ``float64[members, actions]``."""
    for i in range(tables.num_members):
        member = run * tables.num_members + i
        values[i] = _acting(tables, member)[np.int64(tables.row[tables.row_set[member], state])]
    stream = tables.vote_stream[run]
    preferences(values, tables.method[run], tables.member_temperature[run], stream, draws, preference)


@njit
def _play_voting(
    world: FiniteTables,
    tables: Tables,
    run: int,
    environment_stream: Stream,
    recording: TrajectoryRoom,
    start: int,
    position: int,
    record: bool,
) -> tuple[int, float, bool]:
    """The members vote on every action, and all learn from it."""
    model = world.model[run]
    values = np.empty((tables.num_members, tables.value.shape[2]))
    probability = np.empty(tables.value.shape[2])
    cell, distractor = draw_start(world, model, environment_stream)
    state = cell * world.num_distractor_values + distractor
    total, terminal = 0.0, False
    for step in range(world.max_steps):
        _read_preferences(tables, run, state, True, values, probability)
        boltzmann(probability, tables.temperature[run])
        action = categorical(tables.vote_stream[run], probability)
        outcome = draw_outcome(world, model, cell, action, environment_stream)
        reward_code = world.reward_code[model, cell, action, outcome]
        reward = world.reward_value[reward_code]
        terminal = world.terminal[model, cell, action, outcome]
        if record:
            recording.observation[start + position + step] = state
            recording.action[start + step] = action
            recording.reward_code[start + step] = reward_code
            if recording.probability.shape[0] > 0:
                recording.probability[start + step] = probability
        cell = np.int64(world.next_cell[model, cell, action, outcome])
        next_state = cell * world.num_distractor_values + draw_distractor(world, environment_stream)
        for i in range(tables.num_members):
            member = run * tables.num_members + i
            rows = tables.row[tables.row_set[member]]
            row, next_row = np.int64(rows[state]), np.int64(rows[next_state])
            learn_step(tables, member, tables.value[member], row, action, reward, next_row, terminal)
            tables.steps[member] += 1
        state = next_state
        total += reward
        if terminal:
            break
    if record:
        recording.observation[start + position + step + 1] = state
    return step + 1, total, terminal


@njit
def evaluate_episode(world: FiniteTables, tables: Tables, run: int, environment_stream: Stream) -> tuple[int, float]:
    """One episode without exploring or learning, the first of equally good actions: its length and its return."""
    model = world.model[run]
    values = np.empty((tables.num_members, tables.value.shape[2]))
    preference = np.empty((1, tables.value.shape[2]))
    cell, distractor = draw_start(world, model, environment_stream)
    length, total, terminal = 0, 0.0, False
    while not terminal and length < world.max_steps:
        state = cell * world.num_distractor_values + distractor
        if tables.method[run] == NO_VOTE:
            preference[0] = _acting(tables, run)[np.int64(tables.row[tables.row_set[run], state])]
        else:
            _read_preferences(tables, run, state, False, values, preference[0])
        _, action, _ = _greedy(preference, 0)
        outcome = draw_outcome(world, model, cell, action, environment_stream)
        total += world.reward_value[world.reward_code[model, cell, action, outcome]]
        terminal = world.terminal[model, cell, action, outcome]
        length += 1
        cell = np.int64(world.next_cell[model, cell, action, outcome])
        distractor = draw_distractor(world, environment_stream)
    return length, total
