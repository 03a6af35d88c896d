"""ACER's targets and gradients (Wang et al. 2017, Algorithm 2): by hand, as laws, against a plain loop."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from torch import Tensor

from apel.learners.deep import retrace as kernels
from tests.apel.learners.deep.plain_acer import Table

NAN = math.nan
SHARES = st.floats(0.02, 1.0)
VALUES = st.floats(-5.0, 5.0)


def real(numbers: Any) -> Tensor:
    return torch.tensor(numbers, dtype=torch.float64)


def policies(num_actions: int) -> st.SearchStrategy[Table]:
    return arrays(np.float64, num_actions, elements=SHARES).map(lambda shares: shares / shares.sum())


def policy_gradient(
    policy: Any, behaviour: Any, action: int, values: Any, target: float, truncation: float
) -> NDArray[np.float64]:
    """Of one step."""
    gradient = np.empty(len(policy))
    arrays = [np.asarray(one, dtype=np.float64) for one in (policy, behaviour, values)]
    kernels.policy_gradient(arrays[0], arrays[1], action, arrays[2], float(target), truncation, gradient)
    return gradient


def project_to_trust_region(gradient: Any, policy: Any, average: Any, bound: float) -> NDArray[np.float64]:
    """Of one step."""
    found = np.array(gradient, dtype=np.float64)
    kernels.project_to_trust_region(found, np.array(policy), np.array(average), bound)
    return found


# Importance weights.


def test_coefficients_by_hand() -> None:
    """ρ̄ = min(1, π / μ), the truncation at 1 and not at c; where μ is not known π itself (Tree-Backup)."""
    pairs = [(0.5, 0.25), (0.2, 0.4), (0.9, NAN), (0.3, 0.3)]
    assert [kernels.retrace_weight(*pair) for pair in pairs] == [1.0, 0.5, 0.9, 1.0]


def test_coefficients_where_the_behaviour_was_deterministic() -> None:
    """An action that μ excludes, or almost, counts fully; nothing is infinite or undefined."""
    pairs = [(0.5, 0.0), (0.0, 0.0), (1e-30, 1e-30), (0.5, 1e-40)]
    found = [kernels.retrace_weight(*pair) for pair in pairs]
    assert np.isfinite(found).all()
    assert found[0] == found[3] == 1.0


# The gradient in the probabilities.

POLICY, BEHAVIOUR, ACTION_VALUES = [0.5, 0.3, 0.2], [0.25, 0.6, 0.15], [1.0, 2.0, 4.0]


@pytest.mark.parametrize(
    ("truncation", "behaviour", "expected"),
    [
        # V = 0.5 + 0.6 + 0.8 = 1.9, a = 0, Qret = 3, ρ = (2, ½, 4/3). c = 1: min(1, 2) / 0.5 · 1.1 = 2.2 for a;
        # [1 − 1/ρ]₊ = (½, 0, ¼) times Q − V = (−0.9, 0.1, 2.1).
        (1.0, BEHAVIOUR, [2.2 - 0.45, 0.0, 0.525]),
        # c = ½: 0.5 / 0.5 · 1.1 for a; [1 − ½/ρ]₊ = (¾, 0, 5/8).
        (0.5, BEHAVIOUR, [1.1 - 0.675, 0.0, 1.3125]),
        # c = 10: 2 / 0.5 · 1.1 for a, no correction.
        (10.0, BEHAVIOUR, [4.4, 0.0, 0.0]),
        # μ not known: Q − V.
        (10.0, [NAN] * 3, [-0.9, 0.1, 2.1]),
    ],
)
def test_policy_gradient_by_hand(truncation: float, behaviour: list[float], expected: list[float]) -> None:
    """∇J = min(c, ρ(a)) ∇ log π(a) (Qret − V) + Σ_b [1 − c/ρ(b)]₊ π(b) ∇ log π(b) (Q(b) − V), ∇ in π."""
    found = policy_gradient(POLICY, behaviour, 0, ACTION_VALUES, 3.0, truncation)
    assert found.tolist() == pytest.approx(expected)


@given(
    policies(4), policies(4), st.integers(0, 3), arrays(np.float64, 4, elements=VALUES), VALUES, st.floats(0.05, 20.0)
)
def test_policy_gradient_is_that_of_the_surrogate(
    policy: Table, behaviour: Table, action: int, values: Table, target: float, truncation: float
) -> None:
    """With the weights held fixed, g is the derivative of Σ min(c, ρ) log π(a) (Qret − V) + … in π."""
    moving = real(policy).requires_grad_()
    fixed, mu, q = real(policy), real(behaviour), real(values)
    ratio, baseline = fixed / mu, (fixed * q).sum()
    first = ratio[action].clamp(max=truncation) * moving[action].log() * (target - baseline)
    correction = (1.0 - truncation / ratio).clamp(min=0.0) * fixed * moving.log() * (q - baseline)
    (expected,) = torch.autograd.grad(first + correction.sum(), moving)
    found = policy_gradient(policy, behaviour, action, values, target, truncation)
    np.testing.assert_allclose(found, expected.numpy(), rtol=1e-9, atol=1e-9)


@given(policies(3), st.integers(0, 2), arrays(np.float64, 3, elements=VALUES), VALUES, st.floats(1.0, 50.0))
def test_no_correction_on_policy(policy: Table, action: int, values: Table, target: float, truncation: float) -> None:
    """With μ = π and c ≥ 1 only the action that was taken counts, with a weight of 1: (Qret − V) / π(a)."""
    found = policy_gradient(policy, policy, action, values, target, truncation)
    expected = np.zeros(3)
    expected[action] = (target - policy @ values) / policy[action]
    assert found.tolist() == pytest.approx(expected.tolist(), abs=1e-9)


@given(policies(3), policies(3), st.integers(0, 2), arrays(np.float64, 3, elements=VALUES), VALUES)
def test_large_truncation_is_importance_sampling(
    policy: Table, behaviour: Table, action: int, values: Table, target: float
) -> None:
    """With c → ∞ there is no correction: ρ(a) ∇ log π(a) (Qret − V), so (Qret − V) / μ(a) for the action taken."""
    found = policy_gradient(policy, behaviour, action, values, target, truncation=1e30)
    expected = np.zeros(3)
    expected[action] = (target - policy @ values) / behaviour[action]
    assert found.tolist() == pytest.approx(expected.tolist(), abs=1e-9)


@given(policies(3), policies(3), st.integers(0, 2), arrays(np.float64, 3, elements=VALUES), VALUES)
def test_unknown_behaviour_gives_the_all_action_gradient(
    policy: Table, behaviour: Table, action: int, values: Table, target: float
) -> None:
    """Without μ: Σ_b ∇π(b) (Q(b) − V), whatever the target; it is also the limit c → 0 with any μ."""
    unknown = policy_gradient(policy, [NAN] * 3, action, values, target, 10.0)
    assert unknown.tolist() == pytest.approx((values - policy @ values).tolist(), abs=1e-9)
    limit = policy_gradient(policy, behaviour, action, values, target, 1e-12)
    np.testing.assert_allclose(unknown, limit, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("policy", [[0.5, 0.5, 0.0], [1.0, 0.0, 0.0], [0.0, 1e-30, 1.0]])
@pytest.mark.parametrize("behaviour", [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1e-40, 1.0]])
@pytest.mark.parametrize("action", [0, 1, 2])
@pytest.mark.parametrize("truncation", [1.0, 10.0])
def test_impossible_actions_give_finite_gradients(
    policy: list[float], behaviour: list[float], action: int, truncation: float
) -> None:
    """μ(b) = 0, π(b) = 0 and both at once, taken or not."""
    found = policy_gradient(policy, behaviour, action, ACTION_VALUES, 3.0, truncation)
    assert np.isfinite(found).all()


def test_greedy_behaviour_corrects_what_it_never_does() -> None:
    """μ(b) = 0 means ρ(b) = ∞ and [1 − c/ρ(b)]₊ = 1: the whole advantage Q(b) − V counts.

    π = (½, ½), μ = (1, 0), a = 0, Q = (1, 3), V = 2, Qret = 4, c = 1: ρ(a) = ½, so ½ / ½ · (4 − 2) = 2 for a and
    no correction, 1 (3 − 2) = 1 for b.
    """
    found = policy_gradient([0.5, 0.5], [1.0, 0.0], 0, [1.0, 3.0], 4.0, 1.0)
    assert found.tolist() == pytest.approx([2.0, 1.0])


@given(policies(5))
def test_entropy_gradient_is_that_of_the_entropy(policy: Table) -> None:
    """∂ (−Σ π log π) / ∂π(b) = −1 − log π(b)."""
    moving = real(policy).requires_grad_()
    (expected,) = torch.autograd.grad(-(moving * moving.log()).sum(), moving)
    found = np.zeros(5)
    kernels.add_entropy_gradient(policy, 1.0, found)
    np.testing.assert_allclose(found, expected.numpy())


# The trust region.


def test_projection_by_hand() -> None:
    """The projection of g is z = g − max(0, (kᵀg − δ) / ‖k‖²) k.

    π = (¼, ¾), π_average = (½, ½): k = (−2, −2/3), ‖k‖² = 40/9. g = (−3, 0): kᵀg = 6, the excess over δ = 1 is 5, its
    scale 5 · 9/40 = 9/8, z = (−3 + 9/4, 9/8 · 2/3) = (−¾, ¾). g = (3, 0): kᵀg = −6, z = g.
    """
    found = [project_to_trust_region(g, [0.25, 0.75], [0.5, 0.5], 1.0) for g in ([-3.0, 0.0], [3.0, 0.0])]
    assert found[0].tolist() == pytest.approx([-0.75, 0.75])
    assert found[1].tolist() == [3.0, 0.0]


def divergence_gradient(average: Table, policy: Table) -> Table:
    """Of KL(π_average ‖ π) = Σ π_average log(π_average / π) in π, by central differences."""

    def divergence(f: Table) -> float:
        return float((average * np.log(average / f)).sum())

    width = 1e-6
    steps = width * np.eye(len(policy))
    return np.array([(divergence(policy + h) - divergence(policy - h)) / (2 * width) for h in steps])


@given(policies(3), policies(3), arrays(np.float64, 3, elements=VALUES), st.floats(0.05, 3.0))
def test_projection_goes_along_the_gradient_of_the_divergence(
    policy: Table, average: Table, gradient: Table, bound: float
) -> None:
    """The vector k is the gradient of KL(π_average ‖ π) in π; z = g while kᵀg ≤ δ, and kᵀz = δ where it is not."""
    k = divergence_gradient(average, policy)
    found = project_to_trust_region(gradient, policy, average, bound)
    if k @ gradient <= bound - 1e-5:
        assert found.tolist() == gradient.tolist()
    elif k @ gradient >= bound + 1e-5:
        assert (-average / policy) @ found == pytest.approx(bound, abs=1e-9)
        moved = gradient - found
        assert moved @ k > 0.0
        across = moved - moved @ k / (k @ k) * k
        assert np.linalg.norm(across) <= 1e-4 * np.linalg.norm(moved)


@given(
    policies(4),
    policies(4),
    arrays(np.float64, 4, elements=VALUES),
    arrays(np.float64, 4, elements=VALUES),
    st.floats(0.05, 3.0),
    st.floats(0.0, 1.0),
)
def test_projection_is_the_closest_point(
    policy: Table, average: Table, gradient: Table, other: Table, bound: float, inside: float
) -> None:
    """No vector y with kᵀy ≤ δ is closer to g than z is."""
    k = -average / policy
    z = project_to_trust_region(gradient, policy, average, bound)
    excess = k @ other - bound
    feasible = other if excess <= 0.0 else other - (excess + inside) / (k @ k) * k
    assert k @ z <= bound + 1e-9
    assert np.linalg.norm(feasible - gradient) >= np.linalg.norm(z - gradient) - 1e-9
