"""A made-up life of several runs in lockstep: what happens is given, whatever the learners do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.batched_environment import Runs
from apel.learners.banks.batched_learner import BatchedLearner
from tests.apel.learners.deep.steps import transitions

NUM_ACTIONS = 3


class Tick(NamedTuple):
    """What happens to whom; arrays have a row for each of the R runs."""

    acting: Runs
    learning: Runs
    freezing: Runs
    observation: NDArray[np.float64]
    next_observation: NDArray[np.float64]
    action: NDArray[np.int64]
    reward: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    probability: NDArray[np.float64]

    def only(self, run: int) -> Tick:
        """What happens to one run, as the only one of a stack."""
        first = np.zeros(1, dtype=np.int64)
        named = [first[: np.count_nonzero(runs == run)] for runs in self[:3]]
        return Tick(*named, *[column[run : run + 1] for column in self[3:]])


def life(num_runs: int, ticks: int, seed: int = 2, freezes: Sequence[int] = ()) -> list[Tick]:
    """Random subsets of runs act and learn, and freeze at the ticks ``freezes``.

    Episodes last some six steps; a third of the behaviours is not known.
    """
    rng = np.random.default_rng(seed)
    everyone = np.arange(num_runs)

    def some(share: float) -> Runs:
        chosen = everyone[rng.random(num_runs) < share]
        return chosen if len(chosen) else everyone[:1]

    made = []
    for tick in range(ticks):
        ends = rng.random((2, num_runs)) < 0.08
        probability = rng.dirichlet(np.ones(NUM_ACTIONS), num_runs)
        probability[rng.random(num_runs) < 1 / 3] = np.nan
        freezing = some(0.5) if tick in freezes else everyone[:0]
        made.append(
            Tick(
                acting=everyone if tick % 4 == 0 else some(0.5),
                learning=everyone if tick % 5 == 0 else some(0.7),
                freezing=freezing,
                observation=rng.normal(size=(num_runs, 4)),
                next_observation=rng.normal(size=(num_runs, 4)),
                action=rng.integers(NUM_ACTIONS, size=num_runs),
                reward=rng.normal(size=num_runs),
                terminated=ends[0],
                truncated=ends[1],
                probability=probability,
            )
        )
    return made


class Acted(NamedTuple):
    """What a run did at a tick."""

    tick: int
    run: int
    action: int
    probability: list[float]
    values: list[float]


def drive(learner: BatchedLearner, ticks: Sequence[Tick]) -> list[Acted]:
    """Live through it; what was done, in order."""
    done = []
    for number, tick in enumerate(ticks):
        if len(tick.freezing):
            learner.freeze(tick.freezing)
        if len(tick.acting):
            values = learner.action_values(tick.acting, tick.observation[tick.acting])
            actions, probability = learner.act(tick.acting, tick.observation[tick.acting])
            columns = (tick.acting.tolist(), actions.tolist(), probability.tolist(), values.tolist())
            done += [Acted(number, run, *row) for run, *row in zip(*columns, strict=True)]
        if len(tick.learning):
            chosen: list[Any] = [column[tick.learning] for column in tick[3:]]
            seen, following, action, reward, terminated, truncated, known = chosen
            learner.learn(
                tick.learning,
                transitions(
                    seen,
                    following,
                    action=action,
                    reward=reward,
                    terminated=terminated,
                    truncated=truncated,
                    probability=known,
                ),
            )
            ended = tick.learning[terminated | truncated]
            if len(ended):
                learner.end_episode(ended)
    return done


def assert_same_state(one: Any, other: Any, place: str = "state") -> None:
    """Two state trees are equal, value for value."""
    match one:
        case dict():
            assert one.keys() == other.keys(), place
            for key, child in one.items():
                assert_same_state(child, other[key], f"{place}.{key}")
        case list():
            assert len(one) == len(other), place
            for i, child in enumerate(one):
                assert_same_state(child, other[i], f"{place}[{i}]")
        case np.ndarray():
            np.testing.assert_array_equal(one, other, err_msg=place, strict=True)
        case _:
            assert one == other, place


def part_of_run(state: Any, run: int, like: Any) -> Any:
    """The rows of one run in the state of a batched learner, as the state ``like`` of a batch of one has them.

    Memories are stored as far as the run that has most has filled them; a batch of one may have no frozen rows at all.
    """
    if like is None:
        return None
    match state:
        case dict():
            return {key: part_of_run(child, run, like[key]) for key, child in state.items()}
        case list():
            return [part_of_run(child, run, like[i]) for i, child in enumerate(state)]
        case np.ndarray():
            row = state[run : run + 1]
            return row[:, : like.shape[1]] if row.ndim > 1 else row
    return state
