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
from torch import Tensor

from apel.learners.deep.retrace import (
    entropy_gradient,
    policy_gradient,
    project_to_trust_region,
    retrace_coefficients,
    retrace_targets,
)
from tests.apel.deep.plain_acer import Table, retrace

NAN = math.nan
SHARES = st.floats(0.02, 1.0)
VALUES = st.floats(-5.0, 5.0)


def real(numbers: Any) -> Tensor:
    return torch.tensor(numbers, dtype=torch.float64)


def policies(num_actions: int) -> st.SearchStrategy[Table]:
    return arrays(np.float64, num_actions, elements=SHARES).map(lambda shares: shares / shares.sum())


# The targets.

REWARDS, TAKEN, STATES, COEFFICIENTS = [1.0, 2.0, 4.0], [1.0, 3.0, 2.0], [0.5, 2.0, 1.0], [0.25, 0.5, 1.0]


@pytest.mark.parametrize(
    ("bootstrap", "expected"),
    [
        # γ = ½. Truncated, V(x₃) = 8: 4 + ½ · 8 = 8; 2 + ½ (1 (8 − 2) + 1) = 5.5; 1 + ½ (½ (5.5 − 3) + 2) = 2.625.
        (8.0, [2.625, 5.5, 8.0]),
        # Terminated: 4; 2 + ½ (1 (4 − 2) + 1) = 3.5; 1 + ½ (½ (3.5 − 3) + 2) = 2.125.
        (0.0, [2.125, 3.5, 4.0]),
    ],
)
def test_targets_of_three_steps_by_hand(bootstrap: float, expected: list[float]) -> None:
    """Qretᵢ = rᵢ + γ (ρ̄ᵢ₊₁ (Qretᵢ₊₁ − Q(xᵢ₊₁, aᵢ₊₁)) + V(xᵢ₊₁)); the first step's own ρ̄, Q and V play no part."""
    columns = [real(column) for column in (REWARDS, TAKEN, STATES, COEFFICIENTS)]
    found = retrace_targets(*columns, real(bootstrap), torch.tensor(3), 0.5)
    assert found.tolist() == expected


def test_shorter_segments_stand_beside_longer_ones() -> None:
    """What stands beyond a segment's length is ignored, whatever it is; its last step bootstraps where it ends.

    Two steps with V(x₂) = 8: 2 + ½ · 8 = 6; 1 + ½ (½ (6 − 3) + 2) = 2.75. One step: 1 + ½ · 8 = 5.
    """
    columns = [real([column] * 4) for column in (REWARDS, TAKEN, STATES, COEFFICIENTS)]
    for column in columns:
        column[1, 2:] = NAN
        column[2, 1:] = math.inf
    found = retrace_targets(*columns, real([8.0, 8.0, 8.0, 0.0]), torch.tensor([3, 2, 1, 3]), 0.5).tolist()
    assert found[0] == [2.625, 5.5, 8.0]
    assert found[1][:2] == [2.75, 6.0]
    assert found[2][0] == 5.0
    assert found[3] == [2.125, 3.5, 4.0]


def test_coefficients_by_hand() -> None:
    """ρ̄ = min(1, π / μ), the truncation at 1 and not at c; where μ is not known π itself (Tree-Backup)."""
    policy, behaviour = real([0.5, 0.2, 0.9, 0.3]), real([0.25, 0.4, NAN, 0.3])
    assert retrace_coefficients(policy, behaviour).tolist() == [1.0, 0.5, 0.9, 1.0]


def test_coefficients_where_the_behaviour_was_deterministic() -> None:
    """An action that μ excludes, or almost, counts fully; nothing is infinite or undefined."""
    policy, behaviour = torch.tensor([0.5, 0.0, 1e-30, 0.5]), torch.tensor([0.0, 0.0, 1e-30, 1e-40])
    found = retrace_coefficients(policy, behaviour)
    assert found.isfinite().all()
    assert found[0] == found[3] == 1.0


@st.composite
def segments(draw: st.DrawFn) -> tuple[Table, Table, float, int]:
    """``[4, T]``: rewards, Q(x, a), V(x), π / μ; a bootstrap value; a length."""
    longest = draw(st.integers(1, 7))
    columns = draw(arrays(np.float64, (3, longest), elements=VALUES))
    ratio = draw(arrays(np.float64, longest, elements=st.floats(0.0, 3.0)))
    return columns, ratio, draw(VALUES), draw(st.integers(1, longest))


@given(segments(), st.floats(0.0, 1.0))
def test_targets_are_those_of_the_plain_loop(segment: tuple[Table, Table, float, int], discount: float) -> None:
    """For any segment of any length, as the first of a batch of two."""
    columns, ratio, bootstrap, length = segment
    coefficient = retrace_coefficients(real(ratio), torch.ones(len(ratio), dtype=torch.float64))
    stacked = [real(np.stack([column, column])) for column in (*columns, coefficient.numpy())]
    found = retrace_targets(*stacked, real([bootstrap, 0.0]), torch.tensor([length, len(ratio)]), discount)
    first = [column[:length].tolist() for column in (*columns, np.minimum(ratio, 1.0))]
    assert found[0, :length].tolist() == pytest.approx(retrace(*first, bootstrap, discount))
    second = [column.tolist() for column in (*columns, np.minimum(ratio, 1.0))]
    assert found[1].tolist() == pytest.approx(retrace(*second, 0.0, discount))


@given(arrays(np.float64, (2, 6), elements=VALUES), VALUES, st.floats(0.0, 1.0))
def test_on_policy_targets_are_discounted_returns(columns: Table, bootstrap: float, discount: float) -> None:
    """With μ = π all ρ̄ = 1, and where Q(x, a) = V(x) nothing is left but Σ γᵗ rₜ + γᵀ V(x_T)."""
    reward, value = real(columns[0]), real(columns[1])
    coefficient = retrace_coefficients(real([0.3] * 6), real([0.3] * 6))
    found = retrace_targets(reward, value, value, coefficient, real(bootstrap), torch.tensor(6), discount)
    for first in range(6):
        rest = columns[0][first:]
        expected = sum(discount**t * r for t, r in enumerate(rest)) + discount ** len(rest) * bootstrap
        assert float(found[first]) == pytest.approx(expected, abs=1e-9)


@given(arrays(np.float64, (4, 3), elements=VALUES), st.lists(policies(3), min_size=4, max_size=4), VALUES)
def test_unknown_behaviour_gives_tree_backup(values: Table, chosen: list[Table], bootstrap: float) -> None:
    """Without μ: G = r + γ (Σ_{b ≠ a′} π(b|x′) Q(x′, b) + π(a′|x′) G′), as in Precup, Sutton & Singh 2000."""
    actions, reward, discount = [0, 2, 1, 1], [1.0, -1.0, 0.5, 2.0], 0.9
    policy = np.stack(chosen)
    steps = np.arange(4)
    taken = real(policy[steps, actions])
    columns = [reward, values[steps, actions], (policy * values).sum(1), retrace_coefficients(taken, real([NAN] * 4))]
    found = retrace_targets(*[torch.as_tensor(c) for c in columns], real(bootstrap), torch.tensor(4), discount)
    following, expected = bootstrap, []
    for t in reversed(range(4)):
        expected.insert(0, reward[t] + discount * following)
        others = sum(policy[t, b] * values[t, b] for b in range(3) if b != actions[t])
        following = others + policy[t, actions[t]] * expected[0]
    assert found.tolist() == pytest.approx(expected)


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
    found = policy_gradient(real(POLICY), real(behaviour), torch.tensor(0), real(ACTION_VALUES), real(3.0), truncation)
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
    found = policy_gradient(fixed, mu, torch.tensor(action), q, real(target), truncation)
    torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-9)


@given(policies(3), st.integers(0, 2), arrays(np.float64, 3, elements=VALUES), VALUES, st.floats(1.0, 50.0))
def test_no_correction_on_policy(policy: Table, action: int, values: Table, target: float, truncation: float) -> None:
    """With μ = π and c ≥ 1 only the action that was taken counts, with a weight of 1: (Qret − V) / π(a)."""
    pi = real(policy)
    found = policy_gradient(pi, pi, torch.tensor(action), real(values), real(target), truncation)
    expected = np.zeros(3)
    expected[action] = (target - policy @ values) / policy[action]
    assert found.tolist() == pytest.approx(expected.tolist(), abs=1e-9)


@given(policies(3), policies(3), st.integers(0, 2), arrays(np.float64, 3, elements=VALUES), VALUES)
def test_large_truncation_is_importance_sampling(
    policy: Table, behaviour: Table, action: int, values: Table, target: float
) -> None:
    """With c → ∞ there is no correction: ρ(a) ∇ log π(a) (Qret − V), so (Qret − V) / μ(a) for the action taken."""
    found = policy_gradient(
        real(policy), real(behaviour), torch.tensor(action), real(values), real(target), truncation=1e30
    )
    expected = np.zeros(3)
    expected[action] = (target - policy @ values) / behaviour[action]
    assert found.tolist() == pytest.approx(expected.tolist(), abs=1e-9)


@given(policies(3), policies(3), st.integers(0, 2), arrays(np.float64, 3, elements=VALUES), VALUES)
def test_unknown_behaviour_gives_the_all_action_gradient(
    policy: Table, behaviour: Table, action: int, values: Table, target: float
) -> None:
    """Without μ: Σ_b ∇π(b) (Q(b) − V), whatever the target; it is also the limit c → 0 with any μ."""
    pi, q, index = real(policy), real(values), torch.tensor(action)
    unknown = policy_gradient(pi, real([NAN] * 3), index, q, real(target), 10.0)
    assert unknown.tolist() == pytest.approx((values - policy @ values).tolist(), abs=1e-9)
    limit = policy_gradient(pi, real(behaviour), index, q, real(target), 1e-12)
    torch.testing.assert_close(unknown, limit, rtol=0.0, atol=1e-8)


def test_one_batch_holds_known_and_unknown_behaviours() -> None:
    """Each step is treated by itself."""
    pi, q = real([POLICY, POLICY]), real([ACTION_VALUES, ACTION_VALUES])
    mu = real([BEHAVIOUR, [NAN] * 3])
    found = policy_gradient(pi, mu, torch.tensor([0, 0]), q, real([3.0, 3.0]), 1.0)
    assert found[0].tolist() == pytest.approx([1.75, 0.0, 0.525])
    assert found[1].tolist() == pytest.approx([-0.9, 0.1, 2.1])


@pytest.mark.parametrize("policy", [[0.5, 0.5, 0.0], [1.0, 0.0, 0.0], [0.0, 1e-30, 1.0]])
@pytest.mark.parametrize("behaviour", [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1e-40, 1.0]])
@pytest.mark.parametrize("action", [0, 1, 2])
@pytest.mark.parametrize("truncation", [1.0, 10.0])
def test_impossible_actions_give_finite_gradients(
    policy: list[float], behaviour: list[float], action: int, truncation: float
) -> None:
    """μ(b) = 0, π(b) = 0 and both at once, taken or not, in single precision."""
    found = policy_gradient(
        torch.tensor(policy),
        torch.tensor(behaviour),
        torch.tensor(action),
        torch.tensor(ACTION_VALUES),
        torch.tensor(3.0),
        truncation,
    )
    assert found.isfinite().all()


def test_greedy_behaviour_corrects_what_it_never_does() -> None:
    """μ(b) = 0 means ρ(b) = ∞ and [1 − c/ρ(b)]₊ = 1: the whole advantage Q(b) − V counts.

    π = (½, ½), μ = (1, 0), a = 0, Q = (1, 3), V = 2, Qret = 4, c = 1: ρ(a) = ½, so ½ / ½ · (4 − 2) = 2 for a and
    no correction, 1 (3 − 2) = 1 for b.
    """
    found = policy_gradient(real([0.5, 0.5]), real([1.0, 0.0]), torch.tensor(0), real([1.0, 3.0]), real(4.0), 1.0)
    assert found.tolist() == pytest.approx([2.0, 1.0])


@given(policies(5))
def test_entropy_gradient_is_that_of_the_entropy(policy: Table) -> None:
    """∂ (−Σ π log π) / ∂π(b) = −1 − log π(b)."""
    moving = real(policy).requires_grad_()
    (expected,) = torch.autograd.grad(-(moving * moving.log()).sum(), moving)
    torch.testing.assert_close(entropy_gradient(real(policy)), expected)


# The trust region.


def test_projection_by_hand() -> None:
    """The projection of g is z = g − max(0, (kᵀg − δ) / ‖k‖²) k.

    π = (¼, ¾), π_average = (½, ½): k = (−2, −2/3), ‖k‖² = 40/9. g = (−3, 0): kᵀg = 6, the excess over δ = 1 is 5, its
    scale 5 · 9/40 = 9/8, z = (−3 + 9/4, 9/8 · 2/3) = (−¾, ¾). g = (3, 0): kᵀg = −6, z = g.
    """
    gradient = real([[-3.0, 0.0], [3.0, 0.0]])
    policy, average = real([[0.25, 0.75]] * 2), real([[0.5, 0.5]] * 2)
    found = project_to_trust_region(gradient, policy, average, 1.0)
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
    found = project_to_trust_region(real(gradient), real(policy), real(average), bound).numpy()
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
    z = project_to_trust_region(real(gradient), real(policy), real(average), bound).numpy()
    excess = k @ other - bound
    feasible = other if excess <= 0.0 else other - (excess + inside) / (k @ k) * k
    assert k @ z <= bound + 1e-9
    assert np.linalg.norm(feasible - gradient) >= np.linalg.norm(z - gradient) - 1e-9


def test_projection_is_of_each_sample() -> None:
    """A batch is projected sample by sample: a mean over samples must come afterwards."""
    rng = np.random.default_rng(3)
    policy, average = rng.dirichlet(np.ones(3), (4, 5)), rng.dirichlet(np.ones(3), (4, 5))
    gradient = rng.normal(size=(4, 5, 3))
    whole = project_to_trust_region(real(gradient), real(policy), real(average), 0.5)
    for i in range(4):
        for j in range(5):
            one = project_to_trust_region(real(gradient[i, j]), real(policy[i, j]), real(average[i, j]), 0.5)
            torch.testing.assert_close(whole[i, j], one, rtol=0.0, atol=0.0)
