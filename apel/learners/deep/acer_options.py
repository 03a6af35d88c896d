"""The options of ACER (Wang et al. 2017), and the settings of others as presets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic.dataclasses import dataclass

from apel.learners.deep.devices import LANES, DeviceName
from apel.learners.deep.encoding import Encoding
from apel.learners.deep.networks import NetworkOptions
from apel.learners.deep.options import Count, Memory, NonNegative, Positive, Share, Width
from apel.learners.tabular.q_learning import OPTIONS_CONFIG
from apel.numerics.near_names import did_you_mean


@dataclass(frozen=True, config=OPTIONS_CONFIG)
class TrustRegion:
    """How far a step may lead away from the average policy network (Wang et al. 2017, §3.3).

    Attributes
    ----------
    bound:
        δ on the linearised divergence, for each sample.
    average:
        θ_average ← average · θ_average + (1 − average) · θ after each update.
    """

    bound: Positive = 1.0
    average: Share = 0.99


@dataclass(frozen=True, config=OPTIONS_CONFIG)
class AcerOptions:
    """Options of ACER: learning rate, γ and width are the dissertation's, the rest is the paper's.

    Attributes
    ----------
    learning_rate, adam_epsilon:
        Of Adam.
    discount:
        γ.
    rollout:
        Steps of a segment, after each of which there is an update.
    truncation:
        c, where the policy gradient cuts importance weights.
    trust_region:
        None: there is none.
    entropy:
        Weight of the policy's entropy.
    critic:
        Weight of the critic's loss.
    critic_loss:
        Of Q against Qret: half the ``square``, or ``huber`` (linear beyond ±1).
    replay_ratio:
        Updates from memory after each on the newest segment.
    replay_count:
        Whether there are always so many, ``fixed``, or ``poisson``: so many on average, as in the paper's Algorithm 1
        (the dissertation's Algorithm 3).
    batch_size:
        Segments of an update from memory.
    replay_size:
        Segments that are remembered.
    learning_starts:
        Segments that must have been seen before any update.
    reward_scale:
        Rewards are multiplied by it.
    max_gradient_norm:
        Of all variables together; None: gradients are not clipped.
    bootstrap:
        The value after the last step of a segment: of the ``next_state``, or, as minimalRL has it, of the
        ``last_state`` that was acted in.
    encoding, network, device, lanes:
        As for DQN.
    """

    learning_rate: Positive = 2e-4
    adam_epsilon: Positive = 1e-8
    discount: Share = 0.98
    rollout: Width = 20
    truncation: Positive = 10.0
    trust_region: TrustRegion | None = TrustRegion()
    entropy: NonNegative = 0.001
    critic: Positive = 0.5
    critic_loss: Literal["square", "huber"] = "square"
    replay_ratio: Count = 4
    replay_count: Literal["fixed", "poisson"] = "fixed"
    batch_size: Width = 4
    replay_size: Memory = 2500
    learning_starts: Count = 50
    reward_scale: Positive = 1.0
    max_gradient_norm: Positive | None = 10.0
    bootstrap: Literal["next_state", "last_state"] = "next_state"
    encoding: Encoding = "raw"
    network: NetworkOptions = NetworkOptions(hidden=(256,), activation="relu", initialisation="pytorch")
    device: DeviceName = "cpu"
    lanes: Width = LANES


PRESETS: Mapping[str, Mapping[str, Any]] = {
    "paper": {},
    "minimalrl": {
        "rollout": 10,
        "truncation": 1.0,
        "trust_region": None,
        "entropy": 0.0,
        "critic": 1.0,
        "critic_loss": "huber",
        "replay_ratio": 1,
        "replay_size": 6000,
        "learning_starts": 500,
        "reward_scale": 0.01,
        "max_gradient_norm": None,
        "bootstrap": "last_state",
    },
}
"""``minimalrl`` is the short public implementation that the dissertation's numbers point to."""


_MAX_POISSON = 100
"""A mean whose distribution is summed from 0 on: e⁻¹⁰⁰ is still a number."""


def acer_options(preset: str = "paper", **options: Any) -> AcerOptions:
    """The options of a preset, with those that differ.

    Raises
    ------
    ValueError
        If there is no such preset, or too much is to be replayed for a Poisson distribution.
    """
    if preset not in PRESETS:
        message = f"preset: found {preset!r}, expected one of {sorted(PRESETS)}{did_you_mean(preset, PRESETS)}"
        raise ValueError(message)
    chosen = AcerOptions(**{**PRESETS[preset], **options})
    if chosen.replay_count == "poisson" and chosen.replay_ratio > _MAX_POISSON:
        message = f"replay_ratio: found {chosen.replay_ratio} for poisson, expected at most {_MAX_POISSON}"
        raise ValueError(message)
    return chosen
