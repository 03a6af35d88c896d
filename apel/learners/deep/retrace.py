"""What ACER computes of a segment (Wang et al. 2017, Algorithm 2; Algorithms 3 and 4 of the dissertation).

The dissertation's Algorithm 4, line 21, prints Q(x, aᵢ) − V where the paper has Qret − V in the first term, and Q(x,
aᵢ) where it has Q(x, a) in the second; the paper's form is used. Retrace cuts importance weights at 1, the policy's
gradient at c. Where μ of the behaviour is not known, Retrace becomes Tree-Backup (Munos et al. 2016, Table 1), which
takes π(a|x) for the weight, and the gradient the limit c → 0, in which all actions count and none needs a weight.

Everything is a closed form of a few numbers, in double precision.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.learners.deep.arithmetic import log, softmax
from apel.numerics.compiled import njit

_LEAST_PROBABILITY = 1e-8
Row = NDArray[np.float64]
"""``float64[actions]``."""


class Loss(NamedTuple):
    """What ACER descends in; see `AcerOptions`."""

    discount: float
    truncation: float
    bound: float
    """Of the trust region; infinite where there is none."""
    entropy: float
    critic: float
    huber: bool
    reward_scale: float
    bootstraps_next: bool


@njit
def retrace_weight(policy_taken: float, behaviour_taken: float) -> float:
    """min(1, π(a|x) / μ(a|x)); π(a|x) where μ is NaN, not known."""
    if np.isnan(behaviour_taken):
        return policy_taken
    return min(1.0, policy_taken / max(behaviour_taken, _LEAST_PROBABILITY))


@njit
def policy_gradient(
    policy: Row, behaviour: Any, action: int, values: Row, target: float, truncation: float, gradient: Row
) -> None:
    """Write the gradient g of ACER's objective in the policy's probabilities, for ascent.

    g = min(c, ρ(a)) ∇ log π(a) (Qret − V) + Σ_b [1 − c / ρ(b)]₊ π(b) ∇ log π(b) (Q(b) − V), where ∇ is taken in the
    vector π itself, so that ∇ log π(a) has 1 / π(a) at a and zeros elsewhere.
    """
    baseline = 0.0
    for b in range(policy.shape[0]):
        baseline += max(policy[b], _LEAST_PROBABILITY) * values[b]
    is_known = not np.isnan(behaviour[action])
    for b in range(policy.shape[0]):
        share = 1.0
        if is_known:
            share = max(0.0, 1.0 - truncation * behaviour[b] / max(policy[b], _LEAST_PROBABILITY))
        gradient[b] = share * (values[b] - baseline)
    if is_known:
        # min(c, π / μ) / π, without the quotient that would overflow.
        taken = max(policy[action], _LEAST_PROBABILITY)
        weight = min(truncation / taken, 1.0 / max(np.float64(behaviour[action]), _LEAST_PROBABILITY))
        gradient[action] += weight * (target - baseline)


@njit
def add_entropy_gradient(policy: Row, weight: float, gradient: Row) -> None:
    """Add that of the entropy −Σ π log π in the probabilities."""
    for b in range(policy.shape[0]):
        gradient[b] -= weight * (1.0 + log(max(policy[b], _LEAST_PROBABILITY)))


@njit
def project_to_trust_region(gradient: Row, policy: Row, average_policy: Row, bound: float) -> None:
    """Make of g the vector z closest to it with kᵀ z ≤ δ.

    k = ∇ KL(π_average ‖ π) = −π_average / π, in the probabilities, as in the paper and OpenAI Baselines;
    z = g − max(0, (kᵀ g − δ) / ‖k‖²) k. For every sample by itself: a mean over samples must come afterwards.
    """
    excess, square = -bound, 0.0
    for b in range(policy.shape[0]):
        k = -average_policy[b] / max(policy[b], _LEAST_PROBABILITY)
        excess += k * gradient[b]
        square += k * k
    if excess > 0.0:
        for b in range(policy.shape[0]):
            gradient[b] += excess / square * average_policy[b] / max(policy[b], _LEAST_PROBABILITY)


@njit
def acer_gradient(loss: Loss, batch: Any, num_runs: int, num_segments: int) -> None:
    """Write ``batch.gradient`` of a `SegmentBatch`: that of ACER's loss, averaged over the steps, in the outputs."""
    num_actions = batch.outputs.shape[2] // 2
    room = np.empty((4, num_actions))
    for i in range(num_runs):
        end = batch.begin[i, num_segments]
        batch.gradient[i] = 0.0
        share = 1.0 / (end - num_segments)
        for j in range(num_segments):
            _segment_gradient(loss, batch, i, j, share, room)


@njit
def _read(outputs: Any, policy: Row, values: Row) -> float:
    """Write π and Q of a state; V."""
    num_actions = policy.shape[0]
    softmax(outputs[:num_actions], policy)
    total = 0.0
    for a in range(num_actions):
        values[a] = outputs[num_actions + a]
        total += policy[a] * values[a]
    return total


@njit
def _segment_gradient(loss: Loss, batch: Any, i: int, j: int, share: float, room: Any) -> None:
    """Of one segment, from its last step to its first:
    Qretᵢ = rᵢ + γ (ρ̄ᵢ₊₁ (Qretᵢ₊₁ − Q(xᵢ₊₁, aᵢ₊₁)) + V(xᵢ₊₁)), and rᵢ + γ V of the state after it at the last step.
    """
    policy, values, gradient, average = room[0], room[1], room[2], room[3]
    first, last = batch.begin[i, j], batch.begin[i, j + 1] - 1
    following = 0.0
    if not batch.terminated[i, j]:
        following = _read(batch.outputs[i, last if loss.bootstraps_next else last - 1], policy, values)
    for t in range(last - 1, first - 1, -1):
        state_value = _read(batch.outputs[i, t], policy, values)
        action, behaviour = batch.action[i, t], batch.behaviour[i, t]
        target = loss.reward_scale * batch.reward[i, t] + loss.discount * following
        policy_gradient(policy, behaviour, action, values, target, loss.truncation, gradient)
        if loss.entropy > 0.0:
            add_entropy_gradient(policy, loss.entropy, gradient)
        if loss.bound < np.inf:
            softmax(batch.average[i, t, : policy.shape[0]], average)
            project_to_trust_region(gradient, policy, average, loss.bound)
        error = values[action] - target
        _write(policy, gradient, share, batch.gradient[i, t])
        critic = min(max(error, -1.0), 1.0) if loss.huber else error
        batch.gradient[i, t, policy.shape[0] + action] = share * loss.critic * critic
        following = state_value - retrace_weight(policy[action], np.float64(behaviour[action])) * error


@njit
def _write(policy: Row, gradient: Row, share: float, outputs: Any) -> None:
    """From an ascent in the probabilities to a descent in the logits."""
    mean = 0.0
    for b in range(policy.shape[0]):
        mean += policy[b] * gradient[b]
    for b in range(policy.shape[0]):
        outputs[b] = -share * policy[b] * (gradient[b] - mean)
