"""Tabular Q-learning (Algorithm 2, Eq. 2.8): its options, and the plain learner of one run.

The compiled bank of the same algorithm is `apel.learners.banks.compiled`; both draw the same numbers in the same order,
and tests hold one against the other.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from apel.learners.base import State, Transition
from apel.learners.supported_spaces import TABLES, SupportedSpaces
from apel.numerics.streams import integer, stream_of_seed, uniform

OPTIONS_CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False)
_Probability = Annotated[float, Field(ge=0.0, le=1.0)]


@dataclass(frozen=True, config=OPTIONS_CONFIG)
class Decay:
    """ε(t) = end + (start − end) · exp(−t / steps), t counted in observed environment steps."""

    start: _Probability
    end: _Probability
    steps: Annotated[float, Field(gt=0.0)]


@dataclass(frozen=True, config=OPTIONS_CONFIG)
class Switch:
    """ε is ``before`` in the episodes 0 … ``episode`` − 1 and ``after`` from then on (§4.2.2)."""

    before: _Probability
    episode: Annotated[int, Field(ge=0)]
    after: _Probability


@dataclass(frozen=True, config=OPTIONS_CONFIG)
class QLearningOptions:
    """Options of Q-learning; the defaults are those of the dissertation's maze experiments (§4.3.1).

    Attributes
    ----------
    learning_rate:
        α, 0 < α ≤ 1.
    discount:
        γ, 0 ≤ γ ≤ 1.
    exploration:
        ε of the ε-greedy policy: constant, decaying, or switched at an episode.
    tie_breaking:
        Among equally good actions take a ``random`` one, or the ``first``.
    """

    learning_rate: Annotated[float, Field(gt=0.0, le=1.0)] = 0.1
    discount: Annotated[float, Field(ge=0.0, le=1.0)] = 1.0
    exploration: _Probability | Decay | Switch = 0.1
    tie_breaking: Literal["random", "first"] = "random"

    def exploration_rate(self, episode: int, steps: int) -> float:
        """ε in episode ``episode``, after ``steps`` observed environment steps."""
        match self.exploration:
            case Decay(start, end, scale):
                return end + (start - end) * math.exp(-steps / scale)
            case Switch(before, switch_episode, after):
                return before if episode < switch_episode else after
            case float(rate):
                return rate


Table = defaultdict[tuple[int, ...], NDArray[np.float64]]


class QLearning:
    """Q-learning with a table, an ε-greedy policy, and values that start at zero.

    Learns Q(s, a) ← Q(s, a) + α (r + γ max Q(s′, ·) − Q(s, a)) (Eq. 2.8); V of a terminal state is zero, a truncated
    episode bootstraps.

    Parameters
    ----------
    observation_space:
        Discrete, MultiDiscrete or MultiBinary.
    action_space:
        Discrete.
    seed:
        64-bit seed of its exploration.
    options:
        Those of `QLearningOptions`.
    """

    off_policy: ClassVar[bool] = True
    supported_spaces: ClassVar[SupportedSpaces] = TABLES
    options_type: ClassVar[type[QLearningOptions]] = QLearningOptions

    def __init__(self, observation_space: spaces.Space[Any], action_space: Any, seed: int, **options: Any) -> None:
        if not isinstance(observation_space, spaces.Discrete | spaces.MultiDiscrete | spaces.MultiBinary):
            message = (
                f"a table needs finitely many states: found the observation space {observation_space}, expected a "
                "discrete one, or a representation with bins"
            )
            raise ValueError(message)
        self.options = self.options_type(**options)
        self.num_actions = int(action_space.n)
        self.first_action = int(action_space.start)
        self.table: Table = defaultdict(self._zeros)
        self.frozen: Table | None = None
        self.stream = stream_of_seed(seed)
        self.episode = 0
        self.steps = 0

    def act(self, observation: Any) -> tuple[int, NDArray[np.float64]]:
        """ε-greedy: an action, and the probabilities of all."""
        values = self.action_values(observation)
        exploration = self.options.exploration_rate(self.episode, self.steps)
        greedy = np.flatnonzero(values == values.max())
        if self.options.tie_breaking == "first":
            greedy = greedy[:1]
        probability = np.full(self.num_actions, exploration / self.num_actions)
        probability[greedy] += (1.0 - exploration) / len(greedy)
        if uniform(self.stream) < exploration:
            action = integer(self.stream, self.num_actions)
        elif len(greedy) == 1:
            action = int(greedy[0])
        else:
            action = int(greedy[integer(self.stream, len(greedy))])
        return action + self.first_action, probability

    def action_values(self, observation: Any) -> NDArray[np.float64]:
        """Q(s, ·) ``float64[actions]``, as it was when the policy was frozen if it ever was."""
        table = self.table if self.frozen is None else self.frozen
        values = table.get(observation_key(observation))  # which, unlike table[…], adds no row
        return self._zeros() if values is None else values.copy()

    def freeze(self) -> None:
        """Act on today's table until the next call."""
        self.frozen = defaultdict(self._zeros, {key: values.copy() for key, values in self.table.items()})

    def learn(self, transition: Transition) -> None:
        """Eq. 2.8 for one step."""
        next_key = None if transition.terminated else observation_key(transition.next_observation)
        action = transition.action - self.first_action
        self.update(observation_key(transition.observation), action, transition.reward, next_key)
        self.steps += 1

    def update(self, key: tuple[int, ...], action: int, reward: float, next_key: tuple[int, ...] | None) -> None:
        """Eq. 2.8; no next state where the episode terminated."""
        next_value = 0.0 if next_key is None else float(self.table[next_key].max())
        target = reward + self.options.discount * next_value
        self.table[key][action] += self.options.learning_rate * (target - self.table[key][action])

    def end_episode(self) -> None:
        """Advance the episode clock."""
        self.episode += 1

    def state(self) -> State:
        """Table, stream and clocks."""
        return {
            "table": self._packed(self.table),
            "frozen": None if self.frozen is None else self._packed(self.frozen),
            "stream": self.stream.copy(),
            "episode": self.episode,
            "steps": self.steps,
        }

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        self.table = self._unpacked(state["table"])
        self.frozen = None if state["frozen"] is None else self._unpacked(state["frozen"])
        self.stream = state["stream"].copy()
        self.episode = state["episode"]
        self.steps = state["steps"]

    def begin_from(self, state: State) -> None:
        """Begin with the table of another one, see `apel.learners.starting.Beginner`."""
        mine = {"stream": self.stream, "episode": self.episode, "frozen": None}
        self.restore({**state, **mine})

    def _packed(self, table: Table) -> State:
        values = np.array(list(table.values())).reshape(-1, self.num_actions)
        return {"keys": packed_keys(list(table)), "values": values}

    def _unpacked(self, packed: State) -> Table:
        rows = zip(unpacked_keys(packed["keys"]), packed["values"], strict=True)
        return defaultdict(self._zeros, {key: np.array(values) for key, values in rows})

    def _zeros(self) -> NDArray[np.float64]:
        return np.zeros(self.num_actions)


def packed_keys(keys: Sequence[tuple[int, ...]]) -> NDArray[np.int64]:
    """``int64[keys, variables]``."""
    return np.array(keys, dtype=np.int64).reshape(len(keys), len(keys[0]) if keys else 0)


def unpacked_keys(packed: NDArray[np.int64]) -> list[tuple[int, ...]]:
    """What `packed_keys` was given."""
    return [tuple(key) for key in np.asarray(packed).tolist()]


def observation_key(observation: Any) -> tuple[int, ...]:
    """A finite observation as the key of a table."""
    return tuple(np.asarray(observation, dtype=np.int64).ravel().tolist())
