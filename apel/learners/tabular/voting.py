"""Voting ensembles as one learner that holds its members (§2.5.1; Wiering & van Hasselt 2008, *Ensemble algorithms in
reinforcement learning*).

At every step each member says what it thinks of each action; a rule makes one preference p(a) per action of it, and the
action is drawn from a Boltzmann distribution over the preferences. There is no ε: members explore only by disagreeing,
and by what the temperature lets through. All members learn from every step.

======================== ============================================================= =====================
method                   preference p(a)                                               policy π(a) ∝
======================== ============================================================= =====================
majority                 number of members whose best action is a (Eq. 2.10)           exp(p(a) / τ)
rank                     sum over members of a's rank, best m … worst 1 (Eq. 2.11)     exp(p(a) / τ)
boltzmann_addition       sum over members of πʲ(a)                                     p(a)^(1/τ)
boltzmann_multiplication product over members of πʲ(a)                                 p(a)^(1/τ)
linear                   Σⱼ wⱼ Qʲ(a), with learned weights w                           exp(p(a) / τ)
======================== ============================================================= =====================

with πʲ(a) ∝ exp(Qʲ(a) / τₘ). (Eq. 2.9 as printed has its temperature inside the preference.) Best actions that are
equally good are drawn from; equal values share their mean rank.

The linear combination is that of Marivate & Littman (2013), *An ensemble of linearly combined reinforcement-learning
agents*, as §2.5.1 tells of it: its weights, at first 1/M each, are learned by TD-learning on the combination. With
δ = r + γ maxₐ p(s′, a) − p(s, a) they become w + α δ Q(s, a) / |Q(s, a)|², where Q is the vector of the members'
values. The division is ours (normalised least mean squares, Nagumo & Noda 1967): returns have any size, and α none.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.experience.representations import View
from apel.learners.answers import action_values_of
from apel.learners.base import Freezable, HasActionValues, Learner, State, Transition
from apel.learners.starting import begin
from apel.learners.supported_spaces import ANYTHING_SEEN, SupportedSpaces
from apel.learners.tabular.q_learning import OPTIONS_CONFIG
from apel.numerics.compiled import njit
from apel.numerics.streams import Stream, categorical, integer, stream_of_seed

MAJORITY, RANK, ADDITION, MULTIPLICATION = range(4)
_METHODS = ("majority", "rank", "boltzmann_addition", "boltzmann_multiplication")
LINEAR = "linear"
"""The method whose combination is learned, and which has no compiled form."""


@dataclass(frozen=True, config=OPTIONS_CONFIG)
class VotingOptions:
    """Options of a voting ensemble.

    Attributes
    ----------
    method:
        How the members' opinions become one.
    temperature:
        τ > 0 of the policy over preferences; the default is the dissertation's for majority voting (§4.3.5).
    member_temperature:
        τₘ > 0 of the members' own Boltzmann policies, for the two Boltzmann methods.
    weight_learning_rate, discount:
        α in [0, 1] and γ, for the weights of the linear combination.
    """

    method: Literal["majority", "rank", "boltzmann_addition", "boltzmann_multiplication", "linear"] = "majority"
    temperature: Annotated[float, Field(gt=0.0)] = 0.1
    member_temperature: Annotated[float, Field(gt=0.0)] = 0.1
    weight_learning_rate: Annotated[float, Field(ge=0.0, le=1.0)] = 0.01
    discount: Annotated[float, Field(ge=0.0, le=1.0)] = 1.0

    @property
    def method_code(self) -> int:
        """The method as compiled code knows it."""
        return _METHODS.index(self.method)


@njit(inline="always")
def _vote(values: NDArray[np.float64], stream: Stream, draws: bool, preference: NDArray[np.float64]) -> None:
    """One vote for a best action of ``values`` (``float64[actions]``): a random one, or the first."""
    best, ties, last = values[0], 1, 0
    for action in range(1, values.shape[0]):
        if values[action] > best:
            best, ties = values[action], 1
        elif values[action] == best:
            ties += 1
    position = integer(stream, ties) if draws and ties > 1 else 0
    for action in range(values.shape[0]):
        if values[action] == best:
            if position == 0:
                last = action
            position -= 1
    preference[last] += 1.0


@njit(inline="always")
def _add_ranks(values: NDArray[np.float64], preference: NDArray[np.float64]) -> None:
    for action in range(values.shape[0]):
        lower, equal = 0, 0
        for other in range(values.shape[0]):
            lower += values[other] < values[action]
            equal += values[other] == values[action]
        preference[action] += lower + 0.5 * (equal + 1)


@njit(inline="always")
def _log_normaliser(values: NDArray[np.float64], temperature: float) -> tuple[float, float]:
    """The largest of ``values``, and log Σ exp((values − largest) / temperature)."""
    largest, total = values[0], 0.0
    for action in range(1, values.shape[0]):
        largest = max(largest, values[action])
    for action in range(values.shape[0]):
        total += math.exp((values[action] - largest) / temperature)
    return largest, math.log(total)


@njit
def preferences(
    values: NDArray[np.float64],
    method: int,
    member_temperature: float,
    stream: Stream,
    draws: bool,
    preference: NDArray[np.float64],
) -> None:
    """Write the preferences: p(a) of the majority and rank methods, log p(a) of the two Boltzmann methods.

    ``values`` is ``float64[members, actions]``, ``preference`` ``float64[actions]``; ``stream`` is drawn from only by
    majority voting, and only if ``draws``.
    """
    preference[:] = 0.0
    for member in range(values.shape[0]):
        row = values[member]
        if method == MAJORITY:
            _vote(row, stream, draws, preference)
        elif method == RANK:
            _add_ranks(row, preference)
        else:
            largest, normaliser = _log_normaliser(row, member_temperature)
            for action in range(row.shape[0]):
                logarithm = (row[action] - largest) / member_temperature - normaliser
                preference[action] += logarithm if method == MULTIPLICATION else math.exp(logarithm)
    if method == ADDITION:
        for action in range(preference.shape[0]):
            preference[action] = math.log(preference[action])


@njit
def boltzmann(preference: NDArray[np.float64], temperature: float) -> None:
    """Turn preferences ``float64[actions]`` into π(a) ∝ exp(p(a) / τ), in place."""
    largest, normaliser = _log_normaliser(preference, temperature)
    for action in range(preference.shape[0]):
        preference[action] = math.exp((preference[action] - largest) / temperature - normaliser)


class Member(NamedTuple):
    """A learner that votes, with its view of the raw observation."""

    learner: Learner
    view: View


class Voting:
    """Several learners that vote on every action.

    Parameters
    ----------
    observation_space, action_space, seed:
        As of every learner; the seed is that of the voting, members have their own.
    members:
        At least one; each must be off-policy and have action values.
    options:
        Those of `VotingOptions`.
    """

    off_policy: ClassVar[bool] = True
    supported_spaces: ClassVar[SupportedSpaces] = ANYTHING_SEEN

    def __init__(
        self, observation_space: Any, action_space: Any, seed: int, members: Sequence[Member] = (), **options: Any
    ) -> None:
        self.options = VotingOptions(**options)
        if not members:
            message = "members: found none, expected at least one learner"
            raise ValueError(message)
        for member in members:
            if not isinstance(member.learner, HasActionValues) or not member.learner.off_policy:
                name = type(member.learner).__name__
                message = f"members: found {name}, expected off-policy learners with action values"
                raise ValueError(message)
        self.members = tuple(members)
        self.first_action = int(action_space.start)
        self.num_actions = int(action_space.n)
        self.stream = stream_of_seed(seed)
        self.weights = np.full(len(self.members), 1 / len(self.members))
        """``float64[members]``, of the linear combination."""

    def act(self, observation: Any) -> tuple[int, NDArray[np.float64]]:
        """An action, and the probabilities of all, given the votes."""
        probability = self._preferences(observation, draws=True)
        boltzmann(probability, self.options.temperature)
        return int(categorical(self.stream, probability)) + self.first_action, probability

    def action_values(self, observation: Any) -> NDArray[np.float64]:
        """The preferences, ``float64[actions]`` (their logarithms for the Boltzmann methods)."""
        return self._preferences(observation, draws=False)

    def learn(self, transition: Transition) -> None:
        """Every member learns, and the weights of a linear combination before them."""
        if self.options.method == LINEAR:
            self._learn_weights(transition)
        for learner, view in self.members:
            mu = cast("NDArray[np.float64] | None", transition.probability)
            learner.learn(
                transition._replace(
                    observation=_own(view(transition.observation)),
                    next_observation=_own(view(transition.next_observation)),
                    probability=None if mu is None else mu.copy(),
                )
            )

    def end_episode(self) -> None:
        """For every member."""
        for learner, _ in self.members:
            learner.end_episode()

    def freeze(self) -> None:
        """Every member acts on what it knows today."""
        if self.options.method == LINEAR:
            message = "found a linear combination, expected a vote without weights that go on learning"
            raise TypeError(message)
        for learner, _ in self.members:
            if not isinstance(learner, Freezable):
                message = f"found the member {type(learner).__name__}, expected learners that can be frozen"
                raise TypeError(message)
            learner.freeze()

    def state(self) -> State:
        """The members' states and the stream, and the weights of a linear combination."""
        weights = {"weights": self.weights.copy()} if self.options.method == LINEAR else {}
        return {"members": [learner.state() for learner, _ in self.members], "stream": self.stream.copy(), **weights}

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        for (learner, _), stored in zip(self.members, state["members"], strict=True):
            learner.restore(stored)
        self.stream = state["stream"].copy()
        if self.options.method == LINEAR:
            self.weights = state["weights"].copy()

    def begin_from(self, state: State) -> None:
        """Every member begins with what one of another vote knows, see `apel.learners.starting.Beginner`."""
        for (learner, _), stored in zip(self.members, state["members"], strict=True):
            begin(learner, stored)
        if self.options.method == LINEAR and "weights" in state:
            self.weights = state["weights"].copy()

    def _learn_weights(self, transition: Transition) -> None:
        """See the top of this module."""
        options, taken = self.options, transition.action - self.first_action
        values = self._opinions(transition.observation)[:, taken]
        size = float(values @ values)
        if size == 0.0:
            return
        target = transition.reward
        if not transition.terminated:
            target += options.discount * float(np.max(self.weights @ self._opinions(transition.next_observation)))
        error = target - float(self.weights @ values)
        self.weights = self.weights + options.weight_learning_rate * error * values / size

    def _opinions(self, observation: Any) -> NDArray[np.float64]:
        """``float64[members, actions]``."""
        members = [(cast("HasActionValues", learner), view) for learner, view in self.members]
        count = self.num_actions
        return np.stack(
            [action_values_of(learner.action_values(_own(view(observation))), count) for learner, view in members]
        )

    def _preferences(self, observation: Any, *, draws: bool) -> NDArray[np.float64]:
        values, options = self._opinions(observation), self.options
        if options.method == LINEAR:
            return np.asarray(self.weights @ values)
        preference = np.empty(self.num_actions)
        preferences(values, options.method_code, options.member_temperature, self.stream, draws, preference)
        return preference


def _own(seen: Any) -> Any:
    """What one member sees, so that nothing that it writes there is seen by the next one."""
    return copy.deepcopy(seen) if isinstance(seen, np.ndarray | dict | tuple) else seen
