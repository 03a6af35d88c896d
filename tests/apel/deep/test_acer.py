"""ACER: the order of its updates against a plain loop over one run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium import spaces
from torch import Tensor

from apel.learners.deep.acer import AcerOptions, SegmentBatch, StackedAcer, TrustRegion, acer_loss, acer_options
from apel.learners.deep.draws import sampling_streams
from apel.learners.deep.networks import ActorCritic, NetworkOptions
from apel.learners.stacked import Transitions
from tests.apel.deep.steps import runs_of, transitions
from tests.apel.splitmix import SplitMix64

SPACE = spaces.Box(-np.inf, np.inf, (3,))
OPTIONS = AcerOptions(
    learning_rate=3e-3,
    rollout=4,
    batch_size=3,
    replay_size=10,
    replay_ratio=2,
    learning_starts=5,
    max_gradient_norm=0.2,
    trust_region=TrustRegion(bound=0.1, average=0.8),
    network=NetworkOptions(hidden=(8,), activation="relu", initialisation="pytorch"),
)


class PlainAcer:
    """Lists of steps; the loss is `acer_loss`, which has tests of its own, of one run."""

    def __init__(self, row: Tensor, options: AcerOptions, seed: int) -> None:
        self.options = options
        self.row = torch.nn.Parameter(row.clone())
        self.average = row.clone()
        self.updates = 0
        self._network = ActorCritic((3,), 3, options.network)
        self._adam = torch.optim.Adam([self.row], lr=options.learning_rate, eps=options.adam_epsilon)
        state, increment = sampling_streams([seed])[0]
        self._stream = SplitMix64(int(state), int(increment))
        self._open: list[Transitions] = []
        self._closed: list[list[Transitions]] = []

    def learn(self, step: Transitions) -> None:
        self._open.append(step)
        if not (len(self._open) == self.options.rollout or step.terminated[0] or step.truncated[0]):
            return
        self._closed = [*self._closed, self._open][-self.options.replay_size :]
        self._open = []
        if len(self._closed) > self.options.learning_starts:
            self._update(self._closed[-1:])
            for _ in range(self.options.replay_ratio):
                # Counted back from the newest.
                drawn = [self._stream.integer(len(self._closed)) for _ in range(self.options.batch_size)]
                self._update([self._closed[-1 - age] for age in drawn])

    def _update(self, segments: list[list[Transitions]]) -> None:
        region, average = self.options.trust_region, self.average[None] if self.options.trust_region else None
        (loss,) = acer_loss(self._network, self.row[None], average, self._batch(segments), self.options)
        self._adam.zero_grad()
        loss.backward()
        if self.options.max_gradient_norm is not None:
            torch.nn.utils.clip_grad_norm_([self.row], self.options.max_gradient_norm)
        self._adam.step()
        if region is not None:
            self.average = region.average * self.average + (1.0 - region.average) * self.row.detach()
        self.updates += 1

    def _batch(self, segments: list[list[Transitions]]) -> SegmentBatch:
        """Segments beside each other; the steps that are not there are the last one once more."""
        longest = self.options.rollout
        padded = [segment + segment[-1:] * (longest - len(segment)) for segment in segments]
        states = [[*[step.observation[0] for step in one], one[-1].next_observation[0]] for one in padded]
        for segment, one in zip(segments, states, strict=True):
            one[len(segment)] = segment[-1].next_observation[0]

        def column(name: str, kind: Any) -> Tensor:
            return torch.tensor(np.array([[[getattr(step, name)[0] for step in one] for one in padded]]), dtype=kind)

        length = torch.tensor([[len(segment) for segment in segments]])
        return SegmentBatch(
            observation=torch.tensor(np.array([states]), dtype=torch.float32),
            action=column("action", torch.int64),
            reward=column("reward", torch.float32),
            behaviour=column("probability", torch.float32),
            length=length,
            terminated=column("terminated", torch.bool)[:, :, -1],
            mask=(torch.arange(longest) < length[..., None]).float(),
        )


def random_step(rng: np.random.Generator) -> Transitions:
    known = rng.dirichlet(np.ones(3)) if rng.random() < 0.7 else np.full(3, np.nan)
    return transitions(
        rng.normal(size=(1, 3)),
        rng.normal(size=(1, 3)),
        action=int(rng.integers(3)),
        reward=float(rng.normal()),
        terminated=rng.random() < 0.1,
        truncated=rng.random() < 0.1,
        probability=[known],
    )


def as_mapping(options: AcerOptions) -> dict[str, Any]:
    return {name: getattr(options, name) for name in options.__dataclass_fields__}


SHARED = ("learning_rate", "rollout", "learning_starts", "network")
MINIMAL = acer_options("minimalrl", **{name: getattr(OPTIONS, name) for name in SHARED})


@pytest.mark.parametrize(
    "options",
    [OPTIONS, replace(OPTIONS, max_gradient_norm=None, replay_ratio=0, batch_size=1), MINIMAL],
    ids=["paper", "newest alone", "minimalrl"],
)
def test_learning_is_that_of_the_plain_loop(options: AcerOptions) -> None:
    """150 random transitions later the network and its average are the same, to 1e-5.

    Where more than ``learning_starts`` segments have been closed, each that is closed brings one update on itself and
    ``replay_ratio`` on segments from memory; the gradient of all variables together is clipped; the average follows.
    """
    learner = StackedAcer(SPACE, 3, [9], **as_mapping(options))
    first = learner.state()["online"][0]
    plain = PlainAcer(torch.from_numpy(first), options, 9)
    rng = np.random.default_rng(5)
    for _ in range(150):
        step = random_step(rng)
        learner.learn(runs_of(0), step)
        plain.learn(step)
    state = learner.state()
    assert plain.updates == state["adam"]["step"][0]
    assert plain.updates % (1 + options.replay_ratio) == 0
    assert np.abs(state["online"][0] - first).max() > 0.03
    np.testing.assert_allclose(state["online"][0], plain.row.detach().numpy(), atol=1e-5, rtol=0.0)
    if options.trust_region is None:
        assert state["average"] is None
    else:
        np.testing.assert_allclose(state["average"][0], plain.average.numpy(), atol=1e-5, rtol=0.0)


def test_learns_at_the_end_of_segments() -> None:
    """At steps 4, 8, … of an episode and at its end, after ``learning_starts`` other segments: 1 + 2 updates."""
    learner = StackedAcer(SPACE, 3, [9], **as_mapping(replace(OPTIONS, learning_starts=1)))
    rng = np.random.default_rng(5)
    updates = []
    for t in range(12):
        step = random_step(rng)._replace(terminated=np.array([t == 9]), truncated=np.array([False]))
        learner.learn(runs_of(0), step)
        updates.append(float(learner.state()["adam"]["step"][0]))
    # Segments end with steps 3, 7, 9 (counted from 0); the next one is still open.
    assert updates == [0.0] * 7 + [3.0] * 2 + [6.0] * 3


def test_average_follows() -> None:
    """θ_average ← ¾ θ_average + ¼ θ after each update, from θ in the beginning."""
    options = replace(OPTIONS, trust_region=TrustRegion(average=0.75), replay_ratio=0, learning_starts=0, rollout=1)
    learner = StackedAcer(SPACE, 3, [9, 10], **as_mapping(options))
    rng = np.random.default_rng(5)
    before = learner.state()
    np.testing.assert_array_equal(before["average"], before["online"])
    for _ in range(3):
        learner.learn(runs_of(1), random_step(rng))
        after = learner.state()
        expected = 0.75 * before["average"][1] + 0.25 * after["online"][1]
        np.testing.assert_allclose(after["average"][1], expected, atol=1e-6)
        np.testing.assert_array_equal(after["average"][0], before["average"][0])
        before = after
