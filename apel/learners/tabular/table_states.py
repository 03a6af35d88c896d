"""The state of one run's tables as that of the plain learner (`QLearning`, `DynaQ`, `Voting`), and the other way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.finite_model import FiniteModel
from apel.experience.representations import Representation, state_rows
from apel.learners.base import State
from apel.learners.tabular.dyna_q import DynaQOptions
from apel.learners.tabular.q_learning import unpacked_keys
from apel.learners.tabular.tables import Tables, TabularLearner, TabularMember


class TableStates:
    """Reads and writes the tables of the runs of a shard.

    Parameters
    ----------
    tables, learners:
        Of all runs.
    model:
        Of any run: all have the same observations.
    """

    def __init__(self, tables: Tables, learners: Sequence[TabularLearner], model: FiniteModel) -> None:
        self._tables, self._learners, self._model = tables, learners, model
        self._values = model.feature_values()
        self._keys: dict[Representation, NDArray[np.int64]] = {}

    def of_run(self, run: int) -> State:
        """What the plain learner's ``state()`` is after the same episodes."""
        learner = self._learners[run]
        states = [
            self._member_state(run * len(learner.members) + i, member) for i, member in enumerate(learner.members)
        ]
        if learner.voting is None:
            return states[0]
        return {"members": states, "stream": self._tables.vote_stream[run].copy()}

    def begin(self, run: int, state: State) -> None:
        """Let a run's learner begin with what a plain one has learned (`apel.learners.starting.Beginner`).

        What that knows of states that this environment does not have is left aside.
        """
        learner = self._learners[run]
        states = [state] if learner.voting is None else state["members"]
        for i, (member, stored) in enumerate(zip(learner.members, states, strict=True)):
            self._begin_member(run * len(learner.members) + i, member, stored)

    def _member_state(self, at: int, member: TabularMember) -> State:
        tables, keys = self._tables, self._keys_of(member)
        state: State = {
            "table": _table_state(tables.value[at], keys),
            "frozen": _table_state(tables.frozen[at], keys) if len(tables.frozen) else None,
            "stream": tables.stream[at].copy(),
            "episode": int(tables.episode[at]),
            "steps": int(tables.steps[at]),
        }
        if isinstance(member.options, DynaQOptions):
            state["model"] = self._model_state(at, keys)
        return state

    def _model_state(self, at: int, keys: NDArray[np.int64]) -> State:
        tables = self._tables
        pairs = tables.pair[at, : tables.num_pairs[at]]
        rows, actions = np.divmod(pairs, tables.value.shape[2])
        terminal = tables.model_terminal[at, pairs]
        return {
            "keys": keys[rows],
            "actions": actions.astype(np.int64),
            "rewards": tables.model_reward[at, pairs],
            "terminal": terminal,
            "next_keys": keys[tables.model_row[at, pairs[~terminal]]],
        }

    def _begin_member(self, at: int, member: TabularMember, state: State) -> None:
        tables, keys = self._tables, self._keys_of(member)
        row_of = {key: row for row, key in enumerate(unpacked_keys(keys))}
        table = state["table"]
        for key, values in zip(unpacked_keys(table["keys"]), table["values"], strict=True):
            if key in row_of:
                tables.value[at, row_of[key]] = values
        tables.steps[at] = state["steps"]
        if isinstance(member.options, DynaQOptions):
            self._begin_model(at, row_of, state["model"])

    def _begin_model(self, at: int, row_of: dict[tuple[int, ...], int], model: State) -> None:
        tables, ends = self._tables, iter(unpacked_keys(model["next_keys"]))
        columns = (unpacked_keys(model["keys"]), *(model[name].tolist() for name in ("actions", "rewards", "terminal")))
        for key, action, reward, terminal in zip(*columns, strict=True):
            end = key if terminal else next(ends)  # where an episode ended, the next state's value is not asked for
            if key not in row_of or end not in row_of:
                continue
            pair = row_of[key] * tables.value.shape[2] + action
            tables.pair[at, tables.num_pairs[at]] = pair
            tables.num_pairs[at] += 1
            tables.model_row[at, pair], tables.model_terminal[at, pair] = row_of[end], terminal
            tables.model_reward[at, pair] = reward

    def _keys_of(self, member: TabularMember) -> NDArray[np.int64]:
        """``int64[rows, variables]``: what the member sees where it uses each of its rows."""
        seen = member.representation
        if seen not in self._keys:
            rows = state_rows(seen, self._model.features, self._values)
            visible = seen.visible(self._model.features)
            keys = np.zeros((int(rows.max()) + 1, len(visible)), dtype=np.int64)
            keys[rows] = self._values[:, visible]
            self._keys[seen] = keys
        return self._keys[seen]


def _table_state(values: NDArray[np.float64], keys: NDArray[np.int64]) -> State:
    """Of the rows that are not as they were at the beginning; fewer rows than the shard's tables have are used where
    members see differently.
    """
    rows = np.flatnonzero(values[: len(keys)].any(axis=1))
    return {"keys": keys[rows], "values": values[rows].copy()}
