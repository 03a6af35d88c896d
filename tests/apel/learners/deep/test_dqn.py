"""DQN: errors by hand, and the order of things against a plain loop over one run."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium import spaces

from apel.learners.deep.dqn import BatchedDqn, DqnOptions, exploration, rules_of, td_errors
from apel.learners.deep.networks import NetworkOptions, q_network
from apel.learners.deep.parameters import Layout
from apel.learners.deep.prioritised import PriorityOptions
from apel.learners.deep.replay import Minibatch
from tests.apel.learners.deep.plain_dqn import PlainDqn, PlainNetwork, Step
from tests.apel.learners.deep.steps import runs_of, transitions

SPACE = spaces.Box(-np.inf, np.inf, (3,))

# TD errors: of the online network Q(s₀, ·) = (1, 2) and Q(s₁, ·) = (5, 4), of the target network Q(s₁, ·) = (10, 20).


def batch(*, action: list[int], reward: list[float], terminated: list[bool]) -> Minibatch:
    """From s₀ to s₁."""
    size = len(action)
    return Minibatch.empty(1, size, 1, 2)._replace(
        action=np.array([action]),
        reward=np.array([reward], dtype=np.float32),
        terminated=np.array([terminated]),
        outputs=np.array([[[1.0, 2.0]] * size], dtype=np.float32),
        next_outputs=np.array([[[10.0, 20.0]] * size], dtype=np.float32),
    )


def errors_of(steps: Minibatch, chooser: list[float], discount: float) -> list[list[float]]:
    errors = np.zeros_like(steps.reward)
    td_errors(1, steps, np.array([[chooser] * steps.slots.shape[1]], dtype=np.float32), discount, errors)
    return errors.tolist()


@pytest.mark.parametrize(
    ("double", "discount", "expected"),
    [
        # The online network prefers a = 0 in s₁, worth 10: 2 − (1 + ½ · 10) = −4, 1 − (−3 + ½ · 10) = −1. Terminated:
        # 2 − 1.
        (True, 0.5, [-4.0, -1.0, 1.0]),
        # The target network prefers a = 1, worth 20: 2 − 11, 1 − 7.
        (False, 0.5, [-9.0, -6.0, 1.0]),
        (True, 1.0, [-9.0, -6.0, 1.0]),
        (False, 0.0, [1.0, 4.0, 1.0]),
    ],
)
def test_errors_by_hand(double: bool, discount: float, expected: list[float]) -> None:
    """Q(s, a) − (r + γ (1 − terminated) Q_target(s′, a*)), a* = argmax Q_online(s′, ·) with ``double``."""
    steps = batch(action=[1, 0, 1], reward=[1.0, -3.0, 1.0], terminated=[False, False, True])
    assert errors_of(steps, [5.0, 4.0] if double else [10.0, 20.0], discount) == [expected]


def test_gradient_is_that_of_the_weighted_huber_losses() -> None:
    """Of their mean, in Q(s, ·): w · clip(error, ±1) / B at the action that was taken, by autograd too."""
    steps = batch(action=[1, 0, 1, 0], reward=[1.0, -3.75, 1.25, 30.0], terminated=[False, False, True, True])
    steps.weight[:] = [[1.0, 0.5, 2.0, 0.25]]
    errors = errors_of(steps, [5.0, 4.0], 0.5)
    assert errors == [[-4.0, -0.25, 0.75, -29.0]]
    expected = [[0.0, -0.25], [-0.25 * 0.5 / 4, 0.0], [0.0, 0.75 * 2.0 / 4], [-0.25 / 4, 0.0]]
    assert steps.gradient[0].tolist() == expected
    outputs = torch.tensor(steps.outputs[0], requires_grad=True)
    predicted = outputs.gather(1, torch.tensor(steps.action[0])[:, None])[:, 0]
    targets = torch.tensor(steps.outputs[0, range(4), steps.action[0]]) - torch.tensor(errors[0])
    losses = torch.nn.functional.huber_loss(predicted, targets, reduction="none")
    (gradient,) = torch.autograd.grad((torch.tensor(steps.weight[0]) * losses).mean(), outputs)
    assert gradient.tolist() == expected


# Exploration.


@pytest.mark.parametrize(("steps", "expected"), [(0, 1.0), (5_000, 0.51), (10_000, 0.02), (10**9, 0.02)])
def test_exploration_falls_linearly(steps: int, expected: float) -> None:
    """From 1 to 0.02 over a tenth of 100 000 steps, the defaults: (1 + 0.02) / 2 half-way."""
    assert exploration(rules_of(DqnOptions()), steps) == pytest.approx(expected)


def test_exploration_counts_observed_steps() -> None:
    """At step t the probabilities are those of ε(t), whoever's steps were observed, run by run.

    ε falls from 1 to 0 over 4 steps: with 2 actions the worse one has ε / 2.
    """
    options = {"total_steps": 8, "exploration_fraction": 0.5, "final_exploration": 0.0}
    learner = BatchedDqn(SPACE, 2, [1, 2], **options)
    found = []
    for _ in range(6):
        probability = learner.act(runs_of(0, 1), np.zeros((2, 3)))[1]
        found.append(probability.min(axis=1).tolist())
        learner.learn(runs_of(1), transitions([[0.0] * 3], [[0.0] * 3], num_actions=2))
    assert found == [[0.5, pytest.approx(0.5 * max(1.0 - t / 4, 0.0))] for t in range(6)]


def test_greedy_action_is_the_best() -> None:
    """With ε = 0 the action with the largest value is certain, and the values are those that the policy acts on."""
    learner = BatchedDqn(SPACE, 4, [1, 2, 3], total_steps=1, exploration_fraction=1.0, final_exploration=0.0)
    runs = runs_of(0, 1, 2)
    learner.learn(runs, transitions(np.zeros((3, 3)), np.zeros((3, 3)), num_actions=4))
    observation = np.random.default_rng(1).normal(size=(3, 3))
    best = learner.action_values(runs, observation).argmax(axis=1)
    action, probability = learner.act(runs, observation)
    assert action.tolist() == best.tolist()
    np.testing.assert_array_equal(probability, np.eye(4)[best])


# The order of things.

SMALL = DqnOptions(
    learning_rate=2e-3,
    discount=0.9,
    total_steps=500,
    replay_size=100,
    batch_size=8,
    learning_starts=50,
    train_every=3,
    target_update_every=20,
    head_hidden=(6,),
    max_gradient_norm=0.05,
    network=NetworkOptions(hidden=(8,)),
)


def random_steps(count: int, seed: int = 4) -> list[Step]:
    rng = np.random.default_rng(seed)
    return [
        Step(
            observation=rng.normal(size=3),
            action=int(rng.integers(3)),
            reward=float(rng.normal(scale=2.0)),
            next_observation=rng.normal(size=3),
            terminated=bool(rng.random() < 0.2),
        )
        for _ in range(count)
    ]


def plain_of(learner: BatchedDqn, options: DqnOptions, seed: int) -> tuple[PlainDqn, Layout]:
    """The oracle with the learner's first weights."""
    network = Layout(q_network((3,), 3, options.network, options.head_hidden, dueling=options.dueling))
    online, target = (PlainNetwork(3, 8, 6, 3, dueling=options.dueling) for _ in range(2))
    state = learner.state()
    online.load(network, state["online"][0])
    target.load(network, state["other"][0])
    return PlainDqn(online, target, options, seed), network


def as_mapping(options: DqnOptions) -> dict[str, Any]:
    return {name: getattr(options, name) for name in options.__dataclass_fields__}


def observe(learner: BatchedDqn, step: Step, *, truncated: bool = False) -> None:
    learner.learn(
        runs_of(0),
        transitions(
            [step.observation],
            [step.next_observation],
            action=step.action,
            reward=step.reward,
            terminated=step.terminated,
            truncated=truncated,
        ),
    )


@pytest.mark.parametrize(
    "options",
    [
        SMALL,
        replace(SMALL, double=False, dueling=False),
        replace(SMALL, max_gradient_norm=None, train_every=1, adam_epsilon=1e-3),
        replace(SMALL, prioritized=PriorityOptions(correction=1.0)),
        replace(SMALL, prioritized=PriorityOptions()),
        replace(SMALL, prioritized=PriorityOptions(exponent=0.9, correction=0.8, epsilon=0.1), train_every=2),
    ],
    ids=["uniform", "plain", "unclipped", "fully corrected", "prioritised", "strongly prioritised"],
)
def test_learning_is_that_of_the_plain_loop(options: DqnOptions) -> None:
    """300 random transitions later both networks have the same parameters, to 1e-5.

    Remember; train on a draw of what is remembered where t > ``learning_starts`` is a multiple of ``train_every``; copy
    where it is a multiple of ``target_update_every``; β and ε at t; then t ← t + 1.
    """
    learner = BatchedDqn(SPACE, 3, [9], **as_mapping(options))
    plain, network = plain_of(learner, options, 9)
    first = learner.state()["online"][0]
    for t, step in enumerate(random_steps(300)):
        observe(learner, step, truncated=t % 13 == 0)
        plain.learn(step)
        if t == options.learning_starts:
            np.testing.assert_array_equal(learner.state()["online"][0], first)
    state = learner.state()
    assert plain.updates == sum(t % options.train_every == 0 for t in range(51, 300))
    assert np.abs(state["online"][0] - first).max() > 0.05
    np.testing.assert_allclose(state["online"][0], plain.online.row(network), atol=1e-5, rtol=0.0)
    np.testing.assert_allclose(state["other"][0], plain.target.row(network), atol=1e-5, rtol=0.0)
    assert np.abs(state["online"][0] - state["other"][0]).max() > 1e-4


def test_updates_and_copies_come_at_their_steps() -> None:
    """With learning from t > 5, training at multiples of 2 and copies at multiples of 4: t counts from 0."""
    learner = BatchedDqn(SPACE, 3, [9], learning_starts=5, train_every=2, target_update_every=4, batch_size=2)
    trained, copied = [], []
    before = learner.state()
    for t, step in enumerate(random_steps(13)):
        observe(learner, step)
        after = learner.state()
        trained += [t] * (not np.array_equal(after["online"], before["online"]))
        copied += [t] * (not np.array_equal(after["other"], before["other"]))
        if t in copied:
            # First the training, then the copy.
            np.testing.assert_array_equal(after["other"], after["online"])
        before = after
    assert trained == [6, 8, 10, 12]
    assert copied == [8, 12]


# Options.


def test_defaults_are_those_of_baselines() -> None:
    """OpenAI Baselines' ``deepq`` for vectors: deepq.learn, build_graph and ``mlp``."""
    options = DqnOptions()
    assert (options.learning_rate, options.adam_epsilon, options.discount) == (5e-4, 1e-8, 1.0)
    assert (options.total_steps, options.exploration_fraction, options.final_exploration) == (100_000, 0.1, 0.02)
    assert (options.replay_size, options.batch_size, options.learning_starts) == (50_000, 32, 1000)
    assert (options.train_every, options.target_update_every, options.max_gradient_norm) == (1, 500, 10.0)
    assert (options.double, options.dueling, options.head_hidden) == (True, True, (256,))
    assert options.prioritized is None
    assert options.network == NetworkOptions(hidden=(64, 64), activation="tanh", initialisation="orthogonal")


def test_options_may_come_as_data() -> None:
    """Nested options are made from mappings, as an experiment file gives them."""
    learner = BatchedDqn(SPACE, 2, [1], prioritized={"exponent": 0.5}, network={"hidden": [8, 4]}, head_hidden=[3])
    assert learner.options.prioritized == PriorityOptions(exponent=0.5)
    assert learner.options.network == NetworkOptions(hidden=(8, 4))
    assert learner.options.head_hidden == (3,)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("learning_rate", 0.0),
        ("learning_rate", math.nan),
        ("learning_rate", math.inf),
        ("adam_epsilon", 0.0),
        ("discount", 1.1),
        ("discount", -0.1),
        ("total_steps", 0),
        ("total_steps", 10.5),
        ("exploration_fraction", 1.1),
        ("final_exploration", -0.1),
        ("replay_size", 0),
        ("batch_size", 0),
        ("learning_starts", -1),
        ("train_every", 0),
        ("target_update_every", 0),
        ("head_hidden", (0,)),
        ("max_gradient_norm", 0.0),
        ("prioritized", {"exponent": -1.0}),
        ("prioritized", {"speed": 1.0}),
        ("encoding", "binary"),
        ("network", {"hidden": (0,)}),
        ("device", "tpu"),
        ("speed", 1.0),
    ],
)
def test_options_out_of_range_are_refused(option: str, value: Any) -> None:
    """Every number has a range, and nothing unknown is taken; the error names the option."""
    with pytest.raises(ValueError, match=option):
        BatchedDqn(SPACE, 2, [1], **{option: value})


def test_missing_devices_are_refused() -> None:
    """A GPU that this machine does not have is an error from the beginning, which says what there is."""
    with pytest.raises(ValueError, match="found 'cuda:63', expected one that this process sees: cpu or"):
        BatchedDqn(SPACE, 2, [1], device="cuda:63")
