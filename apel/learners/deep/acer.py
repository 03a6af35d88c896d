"""Actor-critic with experience replay for discrete actions (Wang et al. 2017), for all runs of a shard at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass
from torch import Tensor

from apel.batched import Runs
from apel.learners.base import State
from apel.learners.deep.devices import LANES, DeviceName, open_device
from apel.learners.deep.draws import LearnerStreams, draw_categorical, softmax
from apel.learners.deep.encoding import Encoder, Encoding
from apel.learners.deep.networks import ActorCritic, NetworkOptions
from apel.learners.deep.options import Count, NonNegative, Positive, Share, Width
from apel.learners.deep.parameters import FrozenRows, RowAdam, Rows, clip_each_row, initial_rows
from apel.learners.deep.retrace import (
    entropy_gradient,
    policy_gradient,
    project_to_trust_region,
    retrace_coefficients,
    retrace_targets,
)
from apel.learners.deep.segments import SegmentMemory, Segments
from apel.learners.q_learning import OPTIONS_CONFIG
from apel.learners.single import SingleLearner
from apel.learners.stacked import Transitions


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
    batch_size: Width = 4
    replay_size: Width = 2500
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


def acer_options(preset: str = "paper", **options: Any) -> AcerOptions:
    """The options of a preset, with those that differ.

    Raises
    ------
    ValueError
        If there is no such preset.
    """
    if preset not in PRESETS:
        message = f"preset: found {preset!r}, expected one of {sorted(PRESETS)}"
        raise ValueError(message)
    return AcerOptions(**{**PRESETS[preset], **options})


class SegmentBatch(NamedTuple):
    """`Segments` as tensors, with a mask of the steps that are there."""

    observation: Tensor
    action: Tensor
    reward: Tensor
    behaviour: Tensor
    length: Tensor
    terminated: Tensor
    mask: Tensor


def acer_loss(
    network: ActorCritic, rows: Tensor, average_rows: Tensor | None, batch: SegmentBatch, options: AcerOptions
) -> Tensor:
    """The loss of each run, ``float32[A]``: its gradient is ACER's step, averaged over the steps of the batch."""
    grid, flat = batch.observation.shape[:3], batch.observation.flatten(1, 2)
    logits, values = (output.view(*grid, -1) for output in network(rows, flat))
    log_policy = torch.log_softmax(logits, -1)
    policy = log_policy.exp()
    frozen_policy, frozen_values = policy.detach(), values.detach()
    target = _targets(frozen_policy, frozen_values, batch, options)

    acting, taken = frozen_policy[:, :, :-1], batch.action.unsqueeze(-1)
    gradient = policy_gradient(
        acting, batch.behaviour, batch.action, frozen_values[:, :, :-1], target, options.truncation
    )
    gradient = gradient + options.entropy * entropy_gradient(acting)
    if average_rows is not None and options.trust_region is not None:
        with torch.no_grad():
            average = torch.softmax(network(average_rows, flat)[0], -1).view(*grid, -1)[:, :, :-1]
        gradient = project_to_trust_region(gradient, acting, average, options.trust_region.bound)
    actor = -(gradient * policy[:, :, :-1]).sum(-1)

    predicted = values[:, :, :-1].gather(-1, taken).squeeze(-1)
    if options.critic_loss == "square":
        critic = 0.5 * (target - predicted).square()
    else:
        critic = torch.nn.functional.huber_loss(predicted, target, reduction="none")
    losses = (actor + options.critic * critic) * batch.mask
    return losses.flatten(1).sum(1) / batch.mask.flatten(1).sum(1)


def _targets(policy: Tensor, values: Tensor, batch: SegmentBatch, options: AcerOptions) -> Tensor:
    state_value = (policy * values).sum(-1)
    taken = batch.action.unsqueeze(-1)
    policy_taken = policy[:, :, :-1].gather(-1, taken).squeeze(-1)
    behaviour_taken = batch.behaviour.gather(-1, taken).squeeze(-1)
    last = batch.length if options.bootstrap == "next_state" else batch.length - 1
    bootstrap = state_value.gather(-1, last.unsqueeze(-1)).squeeze(-1) * ~batch.terminated
    return retrace_targets(
        options.reward_scale * batch.reward,
        values[:, :, :-1].gather(-1, taken).squeeze(-1),
        state_value[:, :, :-1],
        retrace_coefficients(policy_taken, behaviour_taken),
        bootstrap,
        batch.length,
        options.discount,
    )


class StackedAcer:
    """ACER for R runs.

    Parameters
    ----------
    observation_space:
        What the learners see.
    num_actions:
        How many actions there are.
    seeds:
        A 64-bit seed per run: initial weights, actions and minibatches follow from it.
    options:
        ``preset`` (one of `PRESETS`), and those of `AcerOptions`.
    """

    off_policy: ClassVar[bool] = True

    def __init__(
        self, observation_space: spaces.Space[Any], num_actions: int, seeds: Sequence[int], **options: Any
    ) -> None:
        self.options = acer_options(**options)
        device = open_device(self.options.device)
        self._encoder = Encoder(observation_space, self.options.encoding)
        self._network = ActorCritic(self._encoder.shape, num_actions, self.options.network)
        self._rows = Rows(len(seeds), device, self.options.lanes)
        self._online = initial_rows(self._network.layout, seeds, device)
        self._average = self._online.clone() if self.options.trust_region else None
        self._frozen = FrozenRows(self._rows, len(seeds))
        self._adam = RowAdam(self._online, self.options.learning_rate, self.options.adam_epsilon)
        self._memory = SegmentMemory(
            len(seeds),
            self.options.replay_size,
            self.options.rollout,
            num_actions,
            self._encoder.observation_shape,
            self._encoder.storage_type,
        )
        self._streams = LearnerStreams(seeds)

    def act(self, runs: Runs, observation: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """See `StackedLearner`: an action drawn from the policy."""
        probability = self.action_values(runs, observation)
        return draw_categorical(probability, runs, self._streams.acting), probability

    def action_values(self, runs: Runs, observation: NDArray[Any]) -> NDArray[np.float64]:
        """π(·|s) of the policies that act."""
        return softmax(self._rows.forward(self._evaluate, runs, self._encoder(observation)))

    def learn(self, runs: Runs, transitions: Transitions) -> None:
        """Remember one step; update where it closed a segment."""
        closed = self._memory.add(runs, transitions)
        due = closed[self._memory.num_closed[closed] > self.options.learning_starts]
        for one_call in self._rows.calls(due):
            self._update(one_call, self._memory.newest(one_call))
            for _ in range(self.options.replay_ratio):
                self._update(one_call, self._memory.draw(one_call, self.options.batch_size, self._streams.sampling))

    def lag(self, runs: Runs) -> NDArray[np.int64]:
        """See `StackedLearner`."""
        return np.zeros(len(runs), dtype=np.int64)

    def end_episode(self, runs: Runs) -> None:
        """Nothing: the last step has closed the segment."""

    def freeze(self, runs: Runs) -> None:
        """Act on today's network until the next call."""
        self._frozen.freeze(self._online, runs)

    def state(self) -> State:
        """Networks, optimiser, memory and streams."""
        return {
            "online": self._rows.array(self._online),
            "average": self._rows.array(self._average),
            "frozen": self._frozen.state(),
            "adam": self._adam.state(),
            "memory": self._memory.state(),
            "streams": self._streams.state(),
        }

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        self._rows.restore(self._online, state["online"])
        self._average = self._rows.matrix(state["average"])
        self._frozen.restore(state["frozen"])
        self._adam.restore(state["adam"])
        self._memory.restore(state["memory"])
        self._streams.restore(state["streams"])

    def _evaluate(self, runs: Runs, inputs: Tensor) -> Tensor:
        return self._network(self._frozen.of(self._online, runs), inputs)[0]

    def _update(self, runs: Runs, segments: Segments) -> None:
        online = self._rows.of(self._online, runs).detach().requires_grad_()
        average = self._rows.of(self._average, runs) if self._average is not None else None
        loss = acer_loss(self._network, online, average, self._tensors(segments), self.options)
        (gradients,) = torch.autograd.grad(loss.sum(), online)
        if self.options.max_gradient_norm is not None:
            clip_each_row(gradients, self.options.max_gradient_norm)
        self._adam.step(runs, gradients)
        if self._average is not None and average is not None and self.options.trust_region:
            share = 1.0 - self.options.trust_region.average
            self._rows.write(self._average, runs, average.lerp(self._rows.of(self._online, runs), share))

    def _tensors(self, segments: Segments) -> SegmentBatch:
        mask = np.arange(self.options.rollout) < segments.length[..., None]
        return SegmentBatch(
            observation=self._rows.tensor(self._encoder(segments.observation)),
            action=self._rows.tensor(segments.action),
            reward=self._rows.tensor(segments.reward),
            behaviour=self._rows.tensor(segments.behaviour),
            length=self._rows.tensor(segments.length),
            terminated=self._rows.tensor(segments.terminated),
            mask=self._rows.tensor(mask.astype(np.float32)),
        )


class Acer(SingleLearner):
    """ACER for one run; see `StackedAcer` and `AcerOptions`."""

    stacked_type = StackedAcer
