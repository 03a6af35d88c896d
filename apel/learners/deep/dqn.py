"""Deep Q-networks (Mnih et al. 2015) as OpenAI Baselines runs them, for all runs of a shard at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass
from torch import Tensor

from apel.batched import Runs
from apel.learners.base import State
from apel.learners.deep.devices import LANES, DeviceName, open_device
from apel.learners.deep.draws import LearnerStreams, draw_epsilon_greedy
from apel.learners.deep.encoding import Encoder, Encoding
from apel.learners.deep.networks import NetworkOptions, QNetwork
from apel.learners.deep.options import Count, Positive, Share, Width
from apel.learners.deep.parameters import FrozenRows, RowAdam, Rows, clip_each_variable, initial_rows
from apel.learners.deep.prioritised import Priorities, PriorityOptions
from apel.learners.deep.replay import Minibatch, Replay
from apel.learners.q_learning import OPTIONS_CONFIG
from apel.learners.single import SingleLearner
from apel.learners.stacked import Transitions


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
    replay_size: Width = 50_000
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

    def exploration(self, steps: NDArray[np.int64]) -> NDArray[np.float64]:
        """ε after so many observed steps, ``float64[A]``."""
        horizon = max(int(self.exploration_fraction * self.total_steps), 1)
        return 1.0 + (self.final_exploration - 1.0) * np.minimum(steps / horizon, 1.0)


class Batch(NamedTuple):
    """A minibatch as tensors, B transitions of each of A runs."""

    observation: Tensor
    action: Tensor
    reward: Tensor
    next_observation: Tensor
    terminated: Tensor
    weight: Tensor


def td_errors(network: QNetwork, online: Tensor, target: Tensor, batch: Batch, options: DqnOptions) -> Tensor:
    """``float32[A, B]``: Q(s, a) − y with y = r + γ (1 − terminated) Q_target(s′, a*); the gradient is that of Q alone.

    a* is the online network's choice with ``double``, else the target's.
    """
    with torch.no_grad():
        following = network(target, batch.next_observation)
        chooser = network(online, batch.next_observation) if options.double else following
        best = following.gather(2, chooser.argmax(-1, keepdim=True)).squeeze(-1)
        wanted = batch.reward + options.discount * (1.0 - batch.terminated) * best
    predicted = network(online, batch.observation).gather(2, batch.action.unsqueeze(-1)).squeeze(-1)
    return predicted - wanted


class StackedDqn:
    """DQN for R runs.

    Parameters
    ----------
    observation_space:
        What the learners see.
    num_actions:
        How many actions there are.
    seeds:
        A 64-bit seed per run: initial weights, exploration and minibatches follow from it.
    options:
        Those of `DqnOptions`.
    """

    off_policy: ClassVar[bool] = True

    def __init__(
        self, observation_space: spaces.Space[Any], num_actions: int, seeds: Sequence[int], **options: Any
    ) -> None:
        self.options = DqnOptions(**options)
        device = open_device(self.options.device)
        self._encoder = Encoder(observation_space, self.options.encoding)
        self._network = QNetwork(
            self._encoder.shape,
            num_actions,
            self.options.network,
            self.options.head_hidden,
            dueling=self.options.dueling,
        )
        self._rows = Rows(len(seeds), device, self.options.lanes)
        self._online = initial_rows(self._network.layout, seeds, device)
        self._target = self._online.clone()
        self._frozen = FrozenRows(self._rows, len(seeds))
        self._adam = RowAdam(self._online, self.options.learning_rate, self.options.adam_epsilon)
        encoder = self._encoder
        size, shape = self.options.replay_size, encoder.observation_shape
        self._replay = Replay(len(seeds), size, shape, encoder.storage_type, encoder.stack)
        prioritized = self.options.prioritized
        self._priorities = Priorities(len(seeds), self.options.replay_size, prioritized) if prioritized else None
        self._streams = LearnerStreams(seeds)
        self._steps = np.zeros(len(seeds), dtype=np.int64)

    def act(self, runs: Runs, observation: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """See `StackedLearner`: ε-greedy."""
        exploration = self.options.exploration(self._steps[runs])
        return draw_epsilon_greedy(self._values(runs, observation), exploration, runs, self._streams.acting)

    def action_values(self, runs: Runs, observation: NDArray[Any]) -> NDArray[np.float64]:
        """Q(s, ·) of the policies that act."""
        return self._values(runs, observation).astype(np.float64)

    def learn(self, runs: Runs, transitions: Transitions) -> None:
        """Remember one step; update the network, and copy it, where it is time."""
        slots = self._replay.add(runs, transitions)
        if self._priorities:
            self._priorities.add(runs, slots)
        steps, options = self._steps[runs], self.options
        self._steps[runs] += 1
        begun = steps > options.learning_starts
        due = runs[begun & (steps % options.train_every == 0)]
        for one_call in self._rows.calls(due):
            self._update(one_call)
        copied = runs[begun & (steps % options.target_update_every == 0)]
        if len(copied):
            self._rows.copy(self._target, self._online, copied)

    def lag(self, runs: Runs) -> NDArray[np.int64]:
        """See `StackedLearner`."""
        return -self._steps[runs] % self.options.train_every

    def end_episode(self, runs: Runs) -> None:
        """DQN counts steps, not episodes."""

    def freeze(self, runs: Runs) -> None:
        """Act on today's network until the next call."""
        self._frozen.freeze(self._online, runs)

    def state(self) -> State:
        """Networks, optimiser, memory, streams and clocks."""
        return {
            "online": self._rows.array(self._online),
            "target": self._rows.array(self._target),
            "frozen": self._frozen.state(),
            "adam": self._adam.state(),
            "replay": self._replay.state(),
            "priorities": self._priorities.state() if self._priorities else None,
            "streams": self._streams.state(),
            "steps": self._steps.copy(),
        }

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        self._rows.restore(self._online, state["online"])
        self._rows.restore(self._target, state["target"])
        self._frozen.restore(state["frozen"])
        self._adam.restore(state["adam"])
        self._replay.restore(state["replay"])
        if self._priorities:
            self._priorities.restore(state["priorities"])
        self._streams.restore(state["streams"])
        self._steps = np.array(state["steps"])

    def _values(self, runs: Runs, observation: NDArray[Any]) -> NDArray[np.float32]:
        return self._rows.forward(self._evaluate, runs, self._encoder(observation))

    def _evaluate(self, runs: Runs, inputs: Tensor) -> Tensor:
        return self._network(self._frozen.of(self._online, runs), inputs)

    def _update(self, runs: Runs) -> None:
        slots, weights = self._draw(runs)
        batch = self._tensors(self._replay.take(runs, slots), weights)
        online = self._rows.of(self._online, runs).detach().requires_grad_()
        errors = td_errors(self._network, online, self._rows.of(self._target, runs), batch, self.options)
        losses = torch.nn.functional.huber_loss(errors, torch.zeros_like(errors), reduction="none")
        loss = (batch.weight * losses).mean(1).sum()
        (gradients,) = torch.autograd.grad(loss, online)
        if self.options.max_gradient_norm is not None:
            clip_each_variable(gradients, self._network.layout, self.options.max_gradient_norm)
        self._adam.step(runs, gradients)
        if self._priorities:
            self._priorities.update(runs, slots, errors.detach()[: len(runs)].cpu().numpy())

    def _draw(self, runs: Runs) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        size = self.options.batch_size
        if not self._priorities:
            return self._replay.draw(runs, size, self._streams.sampling), np.ones((len(runs), size), dtype=np.float32)
        progress = (self._steps[runs] - 1) / self.options.total_steps  # of the step that is learned from
        correction = self._priorities.correction(progress)
        return self._priorities.draw(runs, self._replay.size, size, correction, self._streams.sampling)

    def _tensors(self, batch: Minibatch, weights: NDArray[np.float32]) -> Batch:
        return Batch(
            observation=self._rows.tensor(self._encoder(batch.observation)),
            action=self._rows.tensor(batch.action),
            reward=self._rows.tensor(batch.reward),
            next_observation=self._rows.tensor(self._encoder(batch.next_observation)),
            terminated=self._rows.tensor(batch.terminated),
            weight=self._rows.tensor(weights),
        )


class Dqn(SingleLearner):
    """DQN for one run; see `StackedDqn` and `DqnOptions`."""

    stacked_type = StackedDqn
