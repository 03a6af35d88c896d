"""ACER's step one segment and one number at a time, written from the paper: an oracle for `apel.learners.deep.acer`.

Everything but the policy and the Q-values that are being moved is computed beforehand, and is a number here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Table = NDArray[np.float64]


@dataclass(frozen=True)
class Segment:
    """T steps; ``states`` has one more."""

    states: Sequence[int]
    actions: Sequence[int]
    rewards: Sequence[float]
    behaviour: Sequence[Sequence[float] | None]
    """μ(·|s) of each step, None where it is not known."""
    terminated: bool


@dataclass(frozen=True)
class Rule:
    """The options that the rule depends on."""

    discount: float
    truncation: float
    bound: float | None
    entropy: float
    critic: float
    huber: bool
    reward_scale: float
    bootstraps_from_last: bool


def softmax(logits: Table) -> Table:
    """π of logits."""
    weights = np.exp(logits - logits.max())
    return weights / weights.sum()


def retrace(
    rewards: Sequence[float],
    taken_values: Sequence[float],
    state_values: Sequence[float],
    coefficients: Sequence[float],
    bootstrap: float,
    discount: float,
) -> list[float]:
    """Qret, backwards: Algorithm 2's Qret ← r + γ Qret; then Qret ← ρ̄ (Qret − Q(x, a)) + V(x)."""
    targets: list[float] = []
    following = bootstrap
    for r, q, v, rho in reversed(list(zip(rewards, taken_values, state_values, coefficients, strict=True))):
        targets.insert(0, r + discount * following)
        following = rho * (targets[0] - q) + v
    return targets


def targets_of(segment: Segment, logits: Table, values: Table, rule: Rule) -> list[float]:
    """Qret of each step."""
    policy = [softmax(logits[s]) for s in segment.states]
    state_values = [float(p @ values[s]) for p, s in zip(policy, segment.states, strict=True)]
    steps = range(len(segment.actions))
    coefficients = []
    for t in steps:
        behaviour, action = segment.behaviour[t], segment.actions[t]
        weight = policy[t][action] if behaviour is None else min(1.0, policy[t][action] / behaviour[action])
        coefficients.append(float(weight))
    bootstrap = 0.0 if segment.terminated else state_values[-2 if rule.bootstraps_from_last else -1]
    return retrace(
        [rule.reward_scale * r for r in segment.rewards],
        [float(values[segment.states[t]][segment.actions[t]]) for t in steps],
        state_values[:-1],
        coefficients,
        bootstrap,
        rule.discount,
    )


def log_weights(policy: Table, values: Table, behaviour: Table | None, action: int, target: float, rule: Rule) -> Table:
    """What ∇ log π(b) is multiplied by, for each b."""
    baseline = float(policy @ values)
    if behaviour is None:
        return policy * (values - baseline)
    weights = np.zeros_like(policy)
    for b in range(len(policy)):
        ratio = math.inf if behaviour[b] == 0.0 else policy[b] / behaviour[b]
        weights[b] = max(0.0, 1.0 - rule.truncation / ratio) * policy[b] * (values[b] - baseline)
    weights[action] += min(rule.truncation, policy[action] / behaviour[action]) * (target - baseline)
    return weights


def project(gradient: Table, policy: Table, average: Table, bound: float) -> Table:
    """The solution of min ‖z − g‖² subject to kᵀz ≤ δ, k = −π_average / π."""
    k = -average / policy
    excess = float(k @ gradient) - bound
    return gradient if excess <= 0.0 else gradient - excess / float(k @ k) * k


class Surrogate:
    """A loss whose gradient at the tables that it was made of is ACER's step; everything else in it is a number."""

    def __init__(
        self, segments: Sequence[Segment], logits: Table, values: Table, average_logits: Table, rule: Rule
    ) -> None:
        self._rule = rule
        self._steps: list[tuple[int, int, float, Table]] = []
        for segment in segments:
            targets = targets_of(segment, logits, values, rule)
            for t, target in enumerate(targets):
                state, action, known = segment.states[t], segment.actions[t], segment.behaviour[t]
                policy = softmax(logits[state])
                behaviour = None if known is None else np.array(known)
                weights = log_weights(policy, values[state], behaviour, action, target, rule)
                if rule.bound is not None:
                    # In the probabilities: ∂ log π(b) / ∂π(b) = 1 / π(b), ∂H / ∂π(b) = −1 − log π(b).
                    gradient = weights / policy + rule.entropy * (-1.0 - np.log(policy))
                    weights = project(gradient, policy, softmax(average_logits[state]), rule.bound) * policy
                self._steps.append((state, action, target, weights))

    def __call__(self, logits: Table, values: Table) -> float:
        """Its value at other tables."""
        total = 0.0
        for state, action, target, weights in self._steps:
            log_policy = np.log(softmax(logits[state]))
            total -= float(weights @ log_policy)
            if self._rule.bound is None:
                total += self._rule.entropy * float(np.exp(log_policy) @ log_policy)
            total += self._rule.critic * self._critic(target - values[state][action])
        return total / len(self._steps)

    def _critic(self, error: float) -> float:
        if self._rule.huber and abs(error) > 1.0:
            return abs(error) - 0.5
        return 0.5 * error**2
