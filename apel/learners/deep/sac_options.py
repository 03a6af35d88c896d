"""The options of discrete soft actor-critic."""

from __future__ import annotations

from pydantic.dataclasses import dataclass

from apel.learners.deep.devices import LANES, DeviceName
from apel.learners.deep.encoding import Encoding
from apel.learners.deep.networks import NetworkOptions
from apel.learners.deep.options import Count, Memory, Positive, Share, Width
from apel.learners.tabular.q_learning import OPTIONS_CONFIG


@dataclass(frozen=True, config=OPTIONS_CONFIG)
class SacOptions:
    """Options of discrete soft actor-critic.

    Attributes
    ----------
    learning_rate, adam_epsilon:
        Of Adam, for the policy, the critics and the temperature.
    discount:
        γ.
    target_entropy:
        The policy's entropy is steered to this share of the largest possible, log |A|.
    initial_temperature:
        α at the beginning.
    target_average:
        τ: θ_target ← (1 − τ) θ_target + τ θ after each update.
    replay_size, batch_size, learning_starts, train_every:
        As for DQN; before ``learning_starts`` observed steps it acts uniformly at random.
    encoding, network, device, lanes:
        As for DQN; the policy and the critics have a network of this kind each.
    """

    learning_rate: Positive = 3e-4
    adam_epsilon: Positive = 1e-8
    discount: Share = 0.99
    target_entropy: Share = 0.3
    initial_temperature: Positive = 1.0
    target_average: Share = 0.005
    replay_size: Memory = 50_000
    batch_size: Width = 64
    learning_starts: Count = 1000
    train_every: Width = 1
    encoding: Encoding = "raw"
    network: NetworkOptions = NetworkOptions(activation="relu", initialisation="pytorch")
    device: DeviceName = "cpu"
    lanes: Width = LANES
