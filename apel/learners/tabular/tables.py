"""The tables of many runs' learners side by side in arrays: what the compiled loops work on.

A tabular learner has one *member*, itself, or several that vote; member m of run r stands at position r · M + m of all
arrays that are marked ``[members]``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.finite_model import FiniteModel
from apel.experience.representations import Representation, state_rows
from apel.learners.base import State
from apel.learners.tabular.dyna_q import DynaQOptions
from apel.learners.tabular.q_learning import Decay, QLearningOptions, Switch
from apel.learners.tabular.voting import VotingOptions
from apel.numerics.streams import stream_of_seed

_NO_SWITCH = np.iinfo(np.int64).max
NO_VOTE = -1
_NO_VOTING = VotingOptions()


@dataclass(frozen=True)
class TabularMember:
    """A table of one run: its options, what it sees, and the 64-bit seed of its learner."""

    options: QLearningOptions
    representation: Representation
    seed: int


@dataclass(frozen=True)
class TabularLearner:
    """The learner of one run: a single member that acts, or members that vote (with the seed of the voting)."""

    members: tuple[TabularMember, ...]
    voting: VotingOptions | None = None
    seed: int = 0


class Tables(NamedTuple):
    """The learners of R runs, as arrays."""

    value: NDArray[np.float64]
    """``float64[members, rows, actions]``: Q."""
    frozen: NDArray[np.float64]
    """Q at the beginning of the epoch; no rows of members where policies are never frozen."""
    row: NDArray[np.int32]
    """``int32[row sets, states]``: the row of each state, once for each representation among the members."""
    row_set: NDArray[np.int64]
    """``int64[members]``: which of the row sets is the member's."""
    stream: NDArray[np.uint64]
    """``uint64[members, 2]``."""
    steps: NDArray[np.int64]
    """``int64[members]``: observed environment steps."""
    episode: NDArray[np.int64]
    """``int64[members]``: observed episodes; fewer than the run has where it learns from its own alone."""
    learning_rate: NDArray[np.float64]
    discount: NDArray[np.float64]
    exploration: NDArray[np.float64]
    """``float64[members, 2]``: ε before and after the switch, or at the start and the end of the decay."""
    switch_episode: NDArray[np.int64]
    decay_steps: NDArray[np.float64]
    """``float64[members]``: 0 for an ε that does not decay."""
    takes_first: NDArray[np.bool_]
    """``bool[members]``: of equally good actions take the first."""
    planning_steps: NDArray[np.int64]
    """``int64[members]``: 0 without a model."""
    model_row: NDArray[np.int32]
    """``int32[members, rows · actions]``: where each pair led, −1 for one that was never taken; no members without
    models. The same shape for the reward, whether it was terminal, and the list of pairs that were taken."""
    model_reward: NDArray[np.float64]
    model_terminal: NDArray[np.bool_]
    pair: NDArray[np.int32]
    num_pairs: NDArray[np.int64]
    method: NDArray[np.int64]
    """``int64[R]``: how the members vote; NO_VOTE for a learner that is its only member."""
    temperature: NDArray[np.float64]
    member_temperature: NDArray[np.float64]
    vote_stream: NDArray[np.uint64]
    """``uint64[R, 2]``."""
    num_members: int
    """M."""


_CHANGING = (
    "value", "frozen", "stream", "steps", "episode", "model_row", "model_reward", "model_terminal", "pair", "num_pairs",
)  # fmt: skip


def tables_state(tables: Tables) -> State:
    """All that changes while learning."""
    return {name: getattr(tables, name).copy() for name in (*_CHANGING, "vote_stream")}


def restore_tables(tables: Tables, state: State) -> None:
    """Go back to what `tables_state` returned."""
    for name in (*_CHANGING, "vote_stream"):
        getattr(tables, name)[...] = state[name]


def make_tables(model: FiniteModel, learners: Sequence[TabularLearner], *, freezes: bool) -> Tables:
    """The tables of one learner per run, all zero; every learner has the same number of members."""
    members = [member for learner in learners for member in learner.members]
    options = [member.options for member in members]
    views = list(dict.fromkeys(member.representation for member in members))
    values = model.feature_values()
    rows = np.stack([state_rows(view, model.features, values) for view in views])
    shape = len(members), int(rows.max()) + 1, model.num_actions
    planning = [option.planning_steps if isinstance(option, DynaQOptions) else 0 for option in options]
    pairs = (len(members) if any(planning) else 0, shape[1] * shape[2])
    explorations = [_exploration_columns(option) for option in options]
    votings = [learner.voting or _NO_VOTING for learner in learners]
    return Tables(
        value=np.zeros(shape),
        frozen=np.zeros((shape[0] if freezes else 0, *shape[1:])),
        row=rows,
        row_set=np.array([views.index(member.representation) for member in members], dtype=np.int64),
        stream=np.array([stream_of_seed(member.seed) for member in members], dtype=np.uint64),
        steps=np.zeros(len(members), dtype=np.int64),
        episode=np.zeros(len(members), dtype=np.int64),
        learning_rate=np.array([option.learning_rate for option in options]),
        discount=np.array([option.discount for option in options]),
        exploration=np.array([rates for rates, _, _ in explorations]),
        switch_episode=np.array([switch for _, switch, _ in explorations], dtype=np.int64),
        decay_steps=np.array([steps for _, _, steps in explorations]),
        takes_first=np.array([option.tie_breaking == "first" for option in options]),
        planning_steps=np.array(planning, dtype=np.int64),
        model_row=np.full(pairs, -1, dtype=np.int32),
        model_reward=np.zeros(pairs),
        model_terminal=np.zeros(pairs, dtype=np.bool_),
        pair=np.zeros(pairs, dtype=np.int32),
        num_pairs=np.zeros(len(members), dtype=np.int64),
        method=np.array([learner.voting.method_code if learner.voting else NO_VOTE for learner in learners]),
        temperature=np.array([voting.temperature for voting in votings]),
        member_temperature=np.array([voting.member_temperature for voting in votings]),
        vote_stream=np.array([stream_of_seed(learner.seed) for learner in learners], dtype=np.uint64),
        num_members=len(members) // len(learners),
    )


def _exploration_columns(options: QLearningOptions) -> tuple[tuple[float, float], int, float]:
    match options.exploration:
        case Decay(start, end, steps):
            return (start, end), _NO_SWITCH, steps
        case Switch(before, episode, after):
            return (before, after), episode, 0.0
        case float(rate):
            return (rate, rate), _NO_SWITCH, 0.0
