"""The options of DQN."""

from __future__ import annotations

from pydantic.dataclasses import dataclass

from apel.learners.deep.devices import LANES, DeviceName
from apel.learners.deep.encoding import Encoding
from apel.learners.deep.networks import NetworkOptions
from apel.learners.deep.options import Count, Memory, Positive, Share, Width
from apel.learners.deep.prioritised import PriorityOptions
from apel.learners.tabular.q_learning import OPTIONS_CONFIG


@dataclass(frozen=True, config=OPTIONS_CONFIG)
class DqnOptions:
    """Options of DQN; the defaults are those of OpenAI Baselines' ``deepq`` for vectors.

    Attributes
    ----------
    learning_rate, adam_epsilon:
        Of Adam.
    discount:
        γ.
    total_steps:
        Over so many observed environment steps the schedules run.
    exploration_fraction, final_exploration:
        ε falls linearly from 1 to ``final_exploration`` over this fraction of ``total_steps``, and stays there.
    replay_size, batch_size:
        Transitions that are remembered, and those of one update.
    learning_starts:
        Updates begin after so many observed steps.
    train_every:
        Observed steps from update to update.
    target_update_every:
        Observed steps from copy to copy of the target network.
    double:
        The online network chooses the action of the target (van Hasselt, Guez & Silver 2016).
    dueling, head_hidden:
        Separate heads for the state's value and the advantages, and the units of their hidden layers.
    max_gradient_norm:
        Of each variable; None: gradients are not clipped.
    prioritized:
        Prioritised replay; None: uniform.
    encoding:
        How observations go into the network, see `Encoder`.
    network:
        The body.
    device:
        ``cpu``, ``cuda`` or ``cuda:n``.
    lanes:
        On other devices than the CPU, the number of runs in one call; there it may change the last bits of a result.
    """

    learning_rate: Positive = 5e-4
    adam_epsilon: Positive = 1e-8
    discount: Share = 1.0
    total_steps: Width = 100_000
    exploration_fraction: Share = 0.1
    final_exploration: Share = 0.02
    replay_size: Memory = 50_000
    batch_size: Width = 32
    learning_starts: Count = 1000
    train_every: Width = 1
    target_update_every: Width = 500
    double: bool = True
    dueling: bool = True
    head_hidden: tuple[Width, ...] = (256,)
    max_gradient_norm: Positive | None = 10.0
    prioritized: PriorityOptions | None = None
    encoding: Encoding = "raw"
    network: NetworkOptions = NetworkOptions()
    device: DeviceName = "cpu"
    lanes: Width = LANES
