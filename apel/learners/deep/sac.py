"""Soft actor-critic for discrete actions (Christodoulou 2019), for all runs of a shard at once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar

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
from apel.learners.deep.networks import NetworkOptions, QNetwork, TwinQ
from apel.learners.deep.options import Count, Positive, Share, Width
from apel.learners.deep.parameters import FrozenRows, RowAdam, Rows, initial_rows
from apel.learners.deep.replay import Minibatch, Replay
from apel.learners.q_learning import OPTIONS_CONFIG
from apel.learners.single import SingleLearner
from apel.learners.stacked import Transitions

_CRITIC_SEED = 0x2545F4914F6CDD1D


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
    replay_size: Width = 50_000
    batch_size: Width = 64
    learning_starts: Count = 1000
    train_every: Width = 1
    encoding: Encoding = "raw"
    network: NetworkOptions = NetworkOptions(activation="relu", initialisation="pytorch")
    device: DeviceName = "cpu"
    lanes: Width = LANES


def soft_targets(
    log_policy: Tensor, values: Tensor, temperature: Tensor, reward: Tensor, terminated: Tensor, discount: float
) -> Tensor:
    """The targets y = r + γ (1 − terminated) Σ_a π(a|s′) (min Q_target(s′, a) − α log π(a|s′)), ``float32[A, B]``.

    ``log_policy`` and ``values`` (the smaller of both critics) are ``[A, B, actions]``, ``temperature`` ``[A, 1]``.
    """
    soft_value = (log_policy.exp() * (values - temperature.unsqueeze(-1) * log_policy)).sum(-1)
    return reward + discount * (1.0 - terminated) * soft_value


class StackedSac:
    """Discrete soft actor-critic for R runs.

    Parameters
    ----------
    observation_space:
        What the learners see.
    num_actions:
        How many actions there are.
    seeds:
        A 64-bit seed per run: initial weights, actions and minibatches follow from it.
    options:
        Those of `SacOptions`.
    """

    off_policy: ClassVar[bool] = True

    def __init__(
        self, observation_space: spaces.Space[Any], num_actions: int, seeds: Sequence[int], **options: Any
    ) -> None:
        self.options = SacOptions(**options)
        device = open_device(self.options.device)
        self._num_actions, num_runs = num_actions, len(seeds)
        self._encoder = Encoder(observation_space, self.options.encoding)
        shape, network = self._encoder.shape, self.options.network
        self._policy_network = QNetwork(shape, num_actions, network, (), dueling=False)
        self._critic_network = TwinQ(shape, num_actions, network)
        self._rows = Rows(num_runs, device, self.options.lanes)
        self._policy = initial_rows(self._policy_network.layout, seeds, device)
        self._critics = initial_rows(self._critic_network.layout, [seed ^ _CRITIC_SEED for seed in seeds], device)
        self._target = self._critics.clone()
        self._log_temperature = torch.full((num_runs, 1), math.log(self.options.initial_temperature), device=device)
        self._frozen = FrozenRows(self._rows, len(seeds))
        learned = (self._policy, self._critics, self._log_temperature)
        self._adams = [RowAdam(rows, self.options.learning_rate, self.options.adam_epsilon) for rows in learned]
        encoder = self._encoder
        size, shape = self.options.replay_size, encoder.observation_shape
        self._replay = Replay(num_runs, size, shape, encoder.storage_type, encoder.stack)
        self._streams = LearnerStreams(seeds)
        self._steps = np.zeros(num_runs, dtype=np.int64)

    def act(self, runs: Runs, observation: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """See `StackedLearner`: an action drawn from the policy."""
        probability = self.action_values(runs, observation)
        probability[self._steps[runs] < self.options.learning_starts] = 1.0 / self._num_actions
        return draw_categorical(probability, runs, self._streams.acting), probability

    def action_values(self, runs: Runs, observation: NDArray[Any]) -> NDArray[np.float64]:
        """π(·|s) of the policies that act."""
        return softmax(self._rows.forward(self._evaluate, runs, self._encoder(observation)))

    def learn(self, runs: Runs, transitions: Transitions) -> None:
        """Remember one step; update where it is time."""
        self._replay.add(runs, transitions)
        steps = self._steps[runs]
        self._steps[runs] += 1
        due = runs[(steps > self.options.learning_starts) & (steps % self.options.train_every == 0)]
        for one_call in self._rows.calls(due):
            slots = self._replay.draw(one_call, self.options.batch_size, self._streams.sampling)
            self._update(one_call, self._replay.take(one_call, slots))

    def lag(self, runs: Runs) -> NDArray[np.int64]:
        """See `StackedLearner`."""
        return -self._steps[runs] % self.options.train_every

    def end_episode(self, runs: Runs) -> None:
        """It counts steps, not episodes."""

    def freeze(self, runs: Runs) -> None:
        """Act on today's policy until the next call."""
        self._frozen.freeze(self._policy, runs)

    def state(self) -> State:
        """Networks, optimisers, memory, streams and clocks."""
        matrices = (self._policy, self._critics, self._target, self._log_temperature)
        return {
            "matrices": [self._rows.array(matrix) for matrix in matrices],
            "frozen": self._frozen.state(),
            "adams": [adam.state() for adam in self._adams],
            "replay": self._replay.state(),
            "streams": self._streams.state(),
            "steps": self._steps.copy(),
        }

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        matrices = (self._policy, self._critics, self._target, self._log_temperature)
        for matrix, array in zip(matrices, state["matrices"], strict=True):
            self._rows.restore(matrix, array)
        self._frozen.restore(state["frozen"])
        for adam, stored in zip(self._adams, state["adams"], strict=True):
            adam.restore(stored)
        self._replay.restore(state["replay"])
        self._streams.restore(state["streams"])
        self._steps = np.array(state["steps"])

    def _evaluate(self, runs: Runs, inputs: Tensor) -> Tensor:
        return self._policy_network(self._frozen.of(self._policy, runs), inputs)

    def _update(self, runs: Runs, batch: Minibatch) -> None:
        observation = self._rows.tensor(self._encoder(batch.observation))
        temperature = self._rows.of(self._log_temperature, runs).exp()
        self._update_critics(runs, batch, observation, temperature)
        entropy = self._update_policy(runs, observation, temperature)
        wanted = self.options.target_entropy * math.log(self._num_actions)
        self._adams[2].step(runs, entropy - wanted)
        moved = self._rows.of(self._target, runs).lerp(self._rows.of(self._critics, runs), self.options.target_average)
        self._rows.write(self._target, runs, moved)

    def _update_critics(self, runs: Runs, batch: Minibatch, observation: Tensor, temperature: Tensor) -> None:
        following = self._rows.tensor(self._encoder(batch.next_observation))
        action = self._rows.tensor(batch.action)[None, :, :, None]
        with torch.no_grad():
            log_policy = torch.log_softmax(self._policy_network(self._rows.of(self._policy, runs), following), -1)
            values = self._critic_network(self._rows.of(self._target, runs), following).amin(0)
            reward, terminated = self._rows.tensor(batch.reward), self._rows.tensor(batch.terminated)
            target = soft_targets(log_policy, values, temperature, reward, terminated, self.options.discount)
        rows = self._rows.of(self._critics, runs).detach().requires_grad_()
        predicted = self._critic_network(rows, observation)
        errors = predicted.gather(3, action.expand(len(predicted), -1, -1, -1)).squeeze(-1) - target
        (gradients,) = torch.autograd.grad(0.5 * errors.square().mean(-1).sum(), rows)
        self._adams[1].step(runs, gradients)

    def _update_policy(self, runs: Runs, observation: Tensor, temperature: Tensor) -> Tensor:
        """Descend in the policy's loss; the mean entropy before that, ``[A, 1]``."""
        with torch.no_grad():
            values = self._critic_network(self._rows.of(self._critics, runs), observation).amin(0)
        rows = self._rows.of(self._policy, runs).detach().requires_grad_()
        log_policy = torch.log_softmax(self._policy_network(rows, observation), -1)
        policy = log_policy.exp()
        loss = (policy * (temperature.unsqueeze(-1) * log_policy - values)).sum(-1).mean(-1).sum()
        (gradients,) = torch.autograd.grad(loss, rows)
        self._adams[0].step(runs, gradients)
        return -(policy * log_policy).detach().sum(-1).mean(-1, keepdim=True)


class DiscreteSac(SingleLearner):
    """Discrete soft actor-critic for one run; see `StackedSac` and `SacOptions`."""

    stacked_type = StackedSac
