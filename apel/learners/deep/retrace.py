"""What ACER computes of a segment (Wang et al. 2017, Algorithm 2; Algorithms 3 and 4 of the dissertation).

The dissertation's Algorithm 4, line 21, prints Q(x, aᵢ) − V where the paper has Qret − V in the first term, and Q(x,
aᵢ) where it has Q(x, a) in the second; the paper's form is used. Retrace cuts importance weights at 1, the policy's
gradient at c. Where μ of the behaviour is not known, Retrace becomes Tree-Backup (Munos et al. 2016, Table 1), which
takes π(a|x) for the weight, and the gradient the limit c → 0, in which all actions count and none needs a weight.
"""

from __future__ import annotations

import torch
from torch import Tensor

_LEAST_PROBABILITY = 1e-8


def retrace_coefficients(policy_taken: Tensor, behaviour_taken: Tensor) -> Tensor:
    """min(1, π(a|x) / μ(a|x)); π(a|x) where μ is NaN, not known."""
    weights = policy_taken / behaviour_taken.clamp(min=_LEAST_PROBABILITY)
    return torch.where(behaviour_taken.isnan(), policy_taken, weights.clamp(max=1.0))


def retrace_targets(
    reward: Tensor,
    action_value: Tensor,
    state_value: Tensor,
    coefficient: Tensor,
    bootstrap: Tensor,
    length: Tensor,
    discount: float,
) -> Tensor:
    """Qret of each step of each segment, ``[…, T]``.

    Qretᵢ = rᵢ + γ (ρ̄ᵢ₊₁ (Qretᵢ₊₁ − Q(xᵢ₊₁, aᵢ₊₁)) + V(xᵢ₊₁)), and rᵢ + γ · ``bootstrap`` at the last step.

    Parameters
    ----------
    reward, action_value, state_value, coefficient:
        ``[…, T]``: r, Q(x, a) of the action that was taken, V(x), ρ̄.
    bootstrap:
        ``[…]``: the value of the state after the last step, 0 where the episode terminated there.
    length:
        ``int64[…]``: steps of each segment; what stands beyond them is ignored, and its targets mean nothing.
    discount:
        γ.
    """
    targets = []
    following = bootstrap
    for i in reversed(range(reward.shape[-1])):
        target = reward[..., i] + discount * following
        targets.append(target)
        corrected = coefficient[..., i] * (target - action_value[..., i]) + state_value[..., i]
        following = torch.where(i < length, corrected, bootstrap)
    return torch.stack(targets[::-1], dim=-1)


def policy_gradient(
    policy: Tensor, behaviour: Tensor, action: Tensor, values: Tensor, target: Tensor, truncation: float
) -> Tensor:
    """The gradient g of ACER's objective in the policy's probabilities, ``[…, actions]``, for ascent.

    g = min(c, ρ(a)) ∇ log π(a) (Qret − V) + Σ_b [1 − c / ρ(b)]₊ π(b) ∇ log π(b) (Q(b) − V), where ∇ is taken in the
    vector π itself, so that ∇ log π(a) has 1 / π(a) at a and zeros elsewhere.

    Parameters
    ----------
    policy, behaviour, values:
        ``[…, actions]``: π, μ (NaN where not known), Q.
    action, target:
        ``[…]``: the action that was taken, Qret.
    truncation:
        c.
    """
    policy = policy.clamp(min=_LEAST_PROBABILITY)
    baseline = (policy * values).sum(-1)
    index = action.unsqueeze(-1)
    is_known = ~behaviour.gather(-1, index).isnan()
    behaviour_taken = behaviour.gather(-1, index).clamp(min=_LEAST_PROBABILITY)
    # min(c, π / μ) / π, without the quotient that would overflow.
    weight = torch.minimum(truncation / policy.gather(-1, index), 1.0 / behaviour_taken)
    taken = torch.where(is_known, weight * (target - baseline).unsqueeze(-1), torch.zeros_like(weight))
    share = torch.where(is_known, (1.0 - truncation * behaviour / policy).clamp(min=0.0), torch.ones_like(policy))
    correction = share * (values - baseline.unsqueeze(-1))
    return correction.scatter_add(-1, index, taken)


def entropy_gradient(policy: Tensor) -> Tensor:
    """The gradient of the entropy −Σ π log π in the probabilities, ``[…, actions]``."""
    return -1.0 - policy.clamp(min=_LEAST_PROBABILITY).log()


def project_to_trust_region(gradient: Tensor, policy: Tensor, average_policy: Tensor, bound: float) -> Tensor:
    """The vector z closest to g with kᵀ z ≤ δ, each ``[…, actions]``.

    k = ∇ KL(π_average ‖ π) = −π_average / π, in the probabilities, as in the paper and OpenAI Baselines;
    z = g − max(0, (kᵀ g − δ) / ‖k‖²) k. For every sample by itself: a mean over samples must come afterwards.
    """
    divergence = -average_policy / policy.clamp(min=_LEAST_PROBABILITY)
    excess = (divergence * gradient).sum(-1, keepdim=True) - bound
    scale = excess.clamp(min=0.0) / divergence.square().sum(-1, keepdim=True)
    return gradient - scale * divergence
