"""DQN of one run with PyTorch's modules, its Adam and a list for a memory, as OpenAI Baselines has it: an oracle."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from apel.learners.deep.dqn import DqnOptions
from apel.learners.deep.parameters import Layout
from tests.apel.learners.deep.memories import sampling_streams
from tests.apel.splitmix import SplitMix64


class Step(NamedTuple):
    """One transition of the run."""

    observation: NDArray[Any]
    action: int
    reward: float
    next_observation: NDArray[Any]
    terminated: bool


class PlainNetwork(nn.Module):
    """One tanh layer, then a head for advantages and, with ``dueling``, one for the value: a ReLU layer each."""

    def __init__(self, inputs: int, hidden: int, head: int, num_actions: int, *, dueling: bool) -> None:
        super().__init__()
        self.body = nn.Linear(inputs, hidden)
        self.advantage = nn.ModuleList([nn.Linear(hidden, head), nn.Linear(head, num_actions)])
        self.value = nn.ModuleList([nn.Linear(hidden, head), nn.Linear(head, 1)] if dueling else [])

    def forward(self, x: Tensor) -> Tensor:
        """Q."""
        features = torch.tanh(self.body(x))
        advantage = self.advantage[1](torch.relu(self.advantage[0](features)))
        if not len(self.value):
            return advantage
        value = self.value[1](torch.relu(self.value[0](features)))
        return value + advantage - advantage.mean(1, keepdim=True)

    def linears(self) -> list[nn.Linear]:
        """In the order of the learner's variables."""
        return [self.body, *self.advantage, *self.value]

    def load(self, layout: Layout, row: NDArray[np.float32]) -> None:
        """Take the weights of a row of parameters."""
        variables = layout.unpack(torch.from_numpy(row)[None])
        with torch.no_grad():
            for i, linear in enumerate(self.linears()):
                linear.weight.copy_(variables[2 * i][0].t())
                linear.bias.copy_(variables[2 * i + 1][0])

    def row(self, layout: Layout) -> NDArray[np.float32]:
        """The row of parameters that holds its weights."""
        row = torch.zeros(1, layout.size)
        variables = layout.unpack(row)
        for i, linear in enumerate(self.linears()):
            variables[2 * i][0] = linear.weight.detach().t()
            variables[2 * i + 1][0] = linear.bias.detach()
        return row[0].numpy()


class PlainDqn:
    """`learn` follows the body of the loop in Baselines' deepq, after the step of the environment."""

    def __init__(self, online: PlainNetwork, target: PlainNetwork, options: DqnOptions, seed: int) -> None:
        self.online, self.target, self.options = online, target, options
        self._adam = torch.optim.Adam(online.parameters(), lr=options.learning_rate, eps=options.adam_epsilon)
        state, increment = sampling_streams([seed])[0]
        self._stream = SplitMix64(int(state), int(increment))
        self._memory: list[Step] = []
        self._priority: list[float] = []
        self._largest = 1.0
        self.t = 0
        self.updates = 0

    def learn(self, step: Step) -> None:
        """One observed step: remember, train, copy."""
        slot = self.t % self.options.replay_size
        if slot == len(self._memory):
            self._memory.append(step)
            self._priority.append(self._largest)
        else:
            self._memory[slot], self._priority[slot] = step, self._largest
        if self.t > self.options.learning_starts and self.t % self.options.train_every == 0:
            self._train()
        if self.t > self.options.learning_starts and self.t % self.options.target_update_every == 0:
            self.target.load_state_dict(self.online.state_dict())
        self.t += 1

    def _train(self) -> None:
        slots, weights = self._prioritised() if self.options.prioritized else self._uniform()
        batch = [self._memory[slot] for slot in slots]
        errors = self._errors(batch)
        # Huber with δ = 1.
        losses = torch.where(errors.abs() < 1.0, 0.5 * errors.square(), errors.abs() - 0.5)
        self._adam.zero_grad()
        (torch.tensor(weights, dtype=torch.float32) * losses).mean().backward()
        self._clip()
        self._adam.step()
        self.updates += 1
        if self.options.prioritized:
            for slot, error in zip(slots, errors.tolist(), strict=True):
                self._priority[slot] = abs(error) + self.options.prioritized.epsilon
                self._largest = max(self._largest, self._priority[slot])

    def _errors(self, batch: list[Step]) -> Tensor:
        seen = torch.tensor(np.array([step.observation for step in batch]), dtype=torch.float32)
        following = torch.tensor(np.array([step.next_observation for step in batch]), dtype=torch.float32)
        predicted = self.online(seen)
        errors = []
        with torch.no_grad():
            values = self.target(following)
            choices = (self.online(following) if self.options.double else values).argmax(1)
        for i, step in enumerate(batch):
            value = 0.0 if step.terminated else float(values[i, choices[i]])
            errors.append(predicted[i, step.action] - (step.reward + self.options.discount * value))
        return torch.stack(errors)

    def _clip(self) -> None:
        limit = self.options.max_gradient_norm
        if limit is None:
            return
        for parameter in self.online.parameters():
            assert parameter.grad is not None
            norm = float(parameter.grad.norm())
            if norm > limit:
                parameter.grad *= limit / norm

    def _uniform(self) -> tuple[list[int], list[float]]:
        slots = [self._stream.integer(len(self._memory)) for _ in range(self.options.batch_size)]
        return slots, [1.0] * len(slots)

    def _prioritised(self) -> tuple[list[int], list[float]]:
        options, size = self.options.prioritized, self.options.batch_size
        assert options is not None
        masses = np.array(self._priority) ** options.exponent
        cumulative = np.cumsum(masses)
        marks = [(j + self._stream.uniform()) / size * cumulative[-1] for j in range(size)]
        slots = [int(np.searchsorted(cumulative, mark, side="right")) for mark in marks]
        share = masses / masses.sum() * len(masses)
        progress = min(self.t / self.options.total_steps, 1.0)
        correction = options.correction + (1.0 - options.correction) * progress
        weights = share**-correction
        return slots, [float(weights[slot] / weights.max()) for slot in slots]
