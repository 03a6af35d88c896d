"""Discrete soft actor-critic: targets by hand, and its updates against a plain loop over one run."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from torch import Tensor, nn

from apel.learners.deep.networks import NetworkOptions, q_network, twin_q
from apel.learners.deep.parameters import Layout
from apel.learners.deep.replay import Minibatch
from apel.learners.deep.sac import (
    BatchedSac,
    SacOptions,
    Temperature,
    critic_gradient,
    policy_gradient,
    rules_of,
    soft_target,
)
from tests.apel.learners.deep.memories import sampling_streams
from tests.apel.learners.deep.steps import runs_of, transitions
from tests.apel.splitmix import SplitMix64

SPACE = spaces.Box(-np.inf, np.inf, (3,))


def test_targets_by_hand() -> None:
    """Y = r + γ Σ π (min Q − α log π), with γ = 0 after the end.

    π = (¼, ¾), Q = (2, 4) and (5, 3), so (2, 3), α = ½: Σ π Q = 2.75 and the entropy is ¼ ln 4 + ¾ ln 4/3. r = 1.
    """
    policy, values = np.array([0.25, 0.75]), np.array([2.0, 4.0, 5.0, 3.0])
    entropy = 0.25 * math.log(4.0) + 0.75 * math.log(4.0 / 3.0)
    found = [soft_target(1.0, discount, 0.5, policy, np.log(policy), values) for discount in (0.5, 0.0)]
    assert found == pytest.approx([1.0 + 0.5 * (2.75 + 0.5 * entropy), 1.0])


def random_batch(rng: np.random.Generator, num_runs: int, size: int) -> Minibatch:
    grid = num_runs, size
    return Minibatch.empty(num_runs, size, 1, 6)._replace(
        action=rng.integers(3, size=grid),
        reward=rng.normal(size=grid).astype(np.float32),
        terminated=rng.random(grid) < 0.4,
        outputs=rng.normal(size=(*grid, 6)).astype(np.float32),
        next_outputs=rng.normal(size=(*grid, 6)).astype(np.float32),
    )


def temperatures(*alphas: float) -> Temperature:
    logarithms = np.log(np.array(alphas, dtype=np.float32))[:, None]
    rest = np.zeros_like(logarithms), np.zeros_like(logarithms), np.zeros(len(alphas), dtype=np.int64)
    return Temperature(logarithms, *rest)


def test_gradients_are_those_of_autograd() -> None:
    """Of the losses of critics and policy in their outputs, two runs with temperatures of their own."""
    rng = np.random.default_rng(3)
    batch, rules, alphas = random_batch(rng, 2, 5), rules_of(OPTIONS, 3), temperatures(0.3, 2.0)
    logits, next_logits = rng.normal(size=(2, 2, 5, 3)).astype(np.float32)
    critic_gradient(rules, alphas, runs_of(0, 1), next_logits, batch)
    found = np.zeros_like(logits)
    policy_gradient(rules, alphas, runs_of(0, 1), logits, batch.outputs, found)
    for run, alpha in enumerate((0.3, 2.0)):
        columns = (batch.outputs, batch.next_outputs, logits, next_logits, batch.reward)
        q, next_q, own, following, reward = (torch.tensor(column[run], dtype=torch.float64) for column in columns)
        log_policy = torch.log_softmax(following, 1)
        smaller = torch.minimum(next_q[:, :3], next_q[:, 3:])
        worth = (log_policy.exp() * (smaller - alpha * log_policy)).sum(1)
        target = reward + OPTIONS.discount * torch.tensor(~batch.terminated[run]) * worth
        q.requires_grad_()
        taken = q.view(5, 2, 3)[torch.arange(5), :, torch.tensor(batch.action[run])]
        (expected,) = torch.autograd.grad(0.5 * (taken - target[:, None]).square().mean(0).sum(), q)
        np.testing.assert_allclose(batch.gradient[run], expected.numpy(), atol=1e-6)
        own.requires_grad_()
        log_policy = torch.log_softmax(own, 1)
        smaller = torch.minimum(q[:, :3], q[:, 3:]).detach()
        loss = (log_policy.exp() * (alpha * log_policy - smaller)).sum(1).mean()
        (expected,) = torch.autograd.grad(loss, own)
        np.testing.assert_allclose(found[run], expected.numpy(), atol=1e-6)


OPTIONS = SacOptions(
    learning_rate=3e-3,
    discount=0.9,
    target_entropy=0.5,
    initial_temperature=0.4,
    target_average=0.1,
    replay_size=60,
    batch_size=8,
    learning_starts=20,
    train_every=2,
    network=NetworkOptions(hidden=(8,), activation="relu", initialisation="pytorch"),
)


def perceptron() -> nn.Sequential:
    return nn.Sequential(nn.Linear(3, 8), nn.ReLU(), nn.Linear(8, 3))


def load(modules: list[nn.Sequential], layout: Layout, row: NDArray[np.float32]) -> None:
    variables = [variable[0] for variable in layout.unpack(torch.from_numpy(row)[None])]
    linears = [module[i] for module in modules for i in (0, 2)]
    with torch.no_grad():
        for i, linear in enumerate(linears):
            linear.weight.copy_(variables[2 * i].t())
            linear.bias.copy_(variables[2 * i + 1])


def row_of(modules: list[nn.Sequential], layout: Layout) -> NDArray[np.float32]:
    row = torch.zeros(1, layout.size)
    linears = [module[i] for module in modules for i in (0, 2)]
    for i, linear in enumerate(linears):
        weight, bias = layout.unpack(row)[2 * i : 2 * i + 2]
        weight[0], bias[0] = linear.weight.detach().t(), linear.bias.detach()
    return row[0].numpy()


class PlainSac:
    """Critics, then the policy against the new critics, then α, then the target; both twins have one optimiser."""

    def __init__(self, policy: nn.Sequential, critics: list[nn.Sequential], seed: int) -> None:
        self.policy, self.critics = policy, critics
        self.targets = copy.deepcopy(critics)
        self.log_alpha = torch.tensor(math.log(OPTIONS.initial_temperature), requires_grad=True)
        both = [parameter for critic in critics for parameter in critic.parameters()]
        groups: list[Any] = [policy.parameters(), both, [self.log_alpha]]
        self._adams = [torch.optim.Adam(group, lr=OPTIONS.learning_rate) for group in groups]
        state, increment = sampling_streams([seed])[0]
        self._stream = SplitMix64(int(state), int(increment))
        self._memory: list[Any] = []
        self._t = 0

    def learn(self, step: Any) -> None:
        slot = self._t % OPTIONS.replay_size
        self._memory[slot : slot + 1] = [step]
        if self._t > OPTIONS.learning_starts and self._t % OPTIONS.train_every == 0:
            drawn = [self._memory[self._stream.integer(len(self._memory))] for _ in range(OPTIONS.batch_size)]
            columns = [torch.tensor(np.array(column), dtype=torch.float32) for column in zip(*drawn, strict=True)]
            self._train(columns[0], columns[1].long(), columns[2], columns[3], columns[4])
        self._t += 1

    def _train(self, seen: Tensor, action: Tensor, reward: Tensor, following: Tensor, terminated: Tensor) -> None:
        alpha = float(self.log_alpha.detach().exp())
        with torch.no_grad():
            policy = torch.softmax(self.policy(following), 1)
            values = torch.minimum(*[target(following) for target in self.targets])
            worth = (policy * (values - alpha * policy.log())).sum(1)
            wanted = reward + OPTIONS.discount * (1.0 - terminated) * worth
        errors = [critic(seen)[torch.arange(len(seen)), action] - wanted for critic in self.critics]
        self._step(1, sum(0.5 * error.square().mean() for error in errors))
        policy = torch.softmax(self.policy(seen), 1)
        with torch.no_grad():
            values = torch.minimum(*[critic(seen) for critic in self.critics])
        self._step(0, (policy * (alpha * policy.log() - values)).sum(1).mean())
        entropy = float(-(policy * policy.log()).detach().sum(1).mean())
        # J(log α) = log α · (H − H̄): α falls while the entropy is larger than it has to be.
        self._step(2, self.log_alpha * (entropy - OPTIONS.target_entropy * math.log(3.0)))
        with torch.no_grad():
            for target, critic in zip(self.targets, self.critics, strict=True):
                for old, new in zip(target.parameters(), critic.parameters(), strict=True):
                    old.copy_((1.0 - OPTIONS.target_average) * old + OPTIONS.target_average * new)

    def _step(self, which: int, loss: Any) -> None:
        self._adams[which].zero_grad()
        loss.backward()
        self._adams[which].step()


def matrices(learner: BatchedSac) -> list[NDArray[np.float32]]:
    """The policy, the critics, their targets, and log α."""
    state = learner.state()
    return [state["policy"]["online"], state["critics"]["online"], state["critics"]["other"], state["temperature"][0]]


def test_learning_is_that_of_the_plain_loop() -> None:
    """200 random transitions later the policy, both critics, their targets and log α are the same, to 1e-5."""
    options = {name: getattr(OPTIONS, name) for name in OPTIONS.__dataclass_fields__}
    learner = BatchedSac(SPACE, 3, [5], **options)
    policy_layout = Layout(q_network((3,), 3, OPTIONS.network))
    critic_layout = Layout(twin_q((3,), 3, OPTIONS.network))
    first = matrices(learner)
    policy, critics = perceptron(), [perceptron(), perceptron()]
    load([policy], policy_layout, first[0][0])
    load(critics, critic_layout, first[1][0])
    plain = PlainSac(policy, critics, 5)
    rng = np.random.default_rng(4)
    for t in range(200):
        seen, following = rng.normal(size=(2, 3))
        action, reward, terminated = int(rng.integers(3)), float(rng.normal()), bool(rng.random() < 0.2)
        step = transitions(
            [seen], [following], action=action, reward=reward, terminated=terminated, truncated=t % 7 == 0
        )
        learner.learn(runs_of(0), step)
        plain.learn((seen, action, reward, following, terminated))
    found = matrices(learner)
    expected = [
        row_of([plain.policy], policy_layout),
        row_of(plain.critics, critic_layout),
        row_of(plain.targets, critic_layout),
        plain.log_alpha.detach().numpy()[None],
    ]
    for one, other, before in zip(found, expected, first, strict=True):
        np.testing.assert_allclose(one[0], other, atol=1e-5, rtol=0.0)
        assert np.abs(one - before).max() > 0.05


def test_temperature_keeps_the_entropy_up() -> None:
    """α rises where the policy is more certain than it shall be, and falls where it is less."""
    found = []
    for target in (0.99, 0.1):
        options = {"learning_starts": 5, "batch_size": 8, "learning_rate": 1e-2, "network": OPTIONS.network}
        learner = BatchedSac(SPACE, 3, [5], target_entropy=target, initial_temperature=0.01, **options)
        rng = np.random.default_rng(4)
        for _ in range(100):
            seen, action = rng.normal(size=3), int(rng.integers(3))
            step = transitions([seen], [seen], action=action, reward=5.0 * (action == 1), terminated=True)
            learner.learn(runs_of(0), step)
        found.append(float(matrices(learner)[3][0, 0]))
    assert found[0] > math.log(0.01) > found[1]


def test_acts_at_random_before_it_learns() -> None:
    """Up to ``learning_starts`` observed steps, run by run, the policy is uniform; then it is the network's."""
    learner = BatchedSac(SPACE, 3, [5, 6], learning_starts=2)
    observation = np.ones((2, 3))
    policy = learner.action_values(runs_of(0, 1), observation)
    for _ in range(2):
        probability = learner.act(runs_of(0, 1), observation)[1]
        np.testing.assert_array_equal(probability, np.full((2, 3), 1 / 3))
        learner.learn(runs_of(1), transitions([[0.0] * 3], [[0.0] * 3]))
    probability = learner.act(runs_of(0, 1), observation)[1]
    np.testing.assert_array_equal(probability, [np.full(3, 1 / 3), policy[1]])


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("learning_rate", 0.0),
        ("discount", 1.1),
        ("target_entropy", 1.1),
        ("initial_temperature", 0.0),
        ("target_average", -0.1),
        ("replay_size", 0),
        ("batch_size", 0),
        ("learning_starts", -1),
        ("train_every", 0),
        ("encoding", "binary"),
        ("network", {"hidden": [0]}),
        ("device", "tpu"),
        ("speed", 1.0),
    ],
)
def test_options_out_of_range_are_refused(option: str, value: Any) -> None:
    """Every number has a range, and nothing unknown is taken; the error names the option."""
    with pytest.raises(ValueError, match=option):
        SacOptions(**{option: value})
