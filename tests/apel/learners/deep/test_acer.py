"""ACER: the order of its updates against a plain loop over one run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from scipy import stats

from apel.learners.banks.batched_learner import Transitions
from apel.learners.deep.acer import BatchedAcer, loss_of
from apel.learners.deep.acer_options import AcerOptions, TrustRegion, acer_options
from apel.learners.deep.networks import NetworkOptions, actor_critic
from apel.learners.deep.parameters import Layout
from apel.learners.deep.retrace import acer_gradient
from apel.learners.deep.segments import SegmentBatch
from tests.apel.learners.deep.memories import sampling_streams
from tests.apel.learners.deep.steps import runs_of, transitions
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
    """Lists of steps, PyTorch's modules and optimiser; the gradient is `acer_gradient`, which has tests of its own."""

    def __init__(self, row: NDArray[np.float32], options: AcerOptions, seed: int) -> None:
        self.options, self.layout = options, Layout(actor_critic((3,), 3, options.network))
        self.variables = [torch.nn.Parameter(one[0].clone()) for one in self.layout.unpack(torch.from_numpy(row)[None])]
        self.average = [one.detach().clone() for one in self.variables]
        self.updates = 0
        self._adam = torch.optim.Adam(self.variables, lr=options.learning_rate, eps=options.adam_epsilon)
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
            count = self.options.replay_ratio
            if self.options.replay_count == "poisson":
                count = int(stats.poisson(count).ppf(self._stream.uniform()))
            for _ in range(count):
                # Counted back from the newest.
                drawn = [self._stream.integer(len(self._closed)) for _ in range(self.options.batch_size)]
                self._update([self._closed[-1 - age] for age in drawn])

    def row(self, variables: Any) -> NDArray[np.float32]:
        found = np.zeros((1, self.layout.size), dtype=np.float32)
        for place, variable in zip(self.layout.unpack(found), variables, strict=True):
            place[0] = variable.detach().numpy()
        return found[0]

    def _update(self, segments: list[list[Transitions]]) -> None:
        states = [[*[step.observation[0] for step in one], one[-1].next_observation[0]] for one in segments]
        inputs = torch.tensor(np.concatenate(states), dtype=torch.float32)
        outputs = self._values(self.variables, inputs)
        with torch.no_grad():
            average = self._values(self.average, inputs)
        batch = self._batch(segments, outputs.detach().numpy(), average.numpy())
        acer_gradient(loss_of(self.options), batch, 1, len(segments))
        self._adam.zero_grad()
        outputs.backward(torch.from_numpy(batch.gradient[0]))
        if self.options.max_gradient_norm is not None:
            torch.nn.utils.clip_grad_norm_(self.variables, self.options.max_gradient_norm)
        self._adam.step()
        if region := self.options.trust_region:
            pairs = zip(self.average, self.variables, strict=True)
            self.average = [region.average * old + (1.0 - region.average) * new.detach() for old, new in pairs]
        self.updates += 1

    def _values(self, variables: Any, x: Any) -> Any:
        return torch.relu(x @ variables[0] + variables[1]) @ variables[2] + variables[3]

    def _batch(self, segments: list[list[Transitions]], outputs: Any, average: Any) -> SegmentBatch:
        batch = SegmentBatch.empty(1, len(segments), self.options.rollout, 3, 3)
        rows = len(outputs)
        batch = batch._replace(
            **{name: getattr(batch, name)[:, :rows].copy() for name in ("action", "reward", "behaviour", "gradient")}
        )
        begin = 0
        for j, segment in enumerate(segments):
            for t, step in enumerate(segment):
                batch.action[0, begin + t], batch.reward[0, begin + t] = step.action[0], step.reward[0]
                batch.behaviour[0, begin + t] = step.probability[0]
            batch.terminated[0, j] = segment[-1].terminated[0]
            begin += len(segment) + 1
            batch.begin[0, j + 1] = begin
        return batch._replace(outputs=outputs[None], average=average[None])


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
    [
        OPTIONS,
        replace(OPTIONS, max_gradient_norm=None, replay_ratio=0, batch_size=1),
        MINIMAL,
        replace(OPTIONS, replay_count="poisson"),
    ],
    ids=["paper", "newest alone", "minimalrl", "Poisson"],
)
def test_learning_is_that_of_the_plain_loop(options: AcerOptions) -> None:
    """150 random transitions later the network and its average are the same, to 1e-5.

    Where more than ``learning_starts`` segments have been closed, each that is closed brings one update on itself and
    ``replay_ratio`` on segments from memory, or so many on average; the gradient of all variables together is clipped;
    the average follows.
    """
    learner = BatchedAcer(SPACE, 3, [9], **as_mapping(options))
    first = learner.state()["online"][0]
    plain = PlainAcer(first, options, 9)
    rng = np.random.default_rng(5)
    for _ in range(150):
        step = random_step(rng)
        learner.learn(runs_of(0), step)
        plain.learn(step)
    state = learner.state()
    assert plain.updates == state["adam"]["clock"][0]
    assert (plain.updates % (1 + options.replay_ratio) == 0) == (options.replay_count == "fixed")
    assert np.abs(state["online"][0] - first).max() > 0.03
    np.testing.assert_allclose(state["online"][0], plain.row(plain.variables), atol=1e-5, rtol=0.0)
    if options.trust_region is None:
        assert state["other"] is None
    else:
        np.testing.assert_allclose(state["other"][0], plain.row(plain.average), atol=1e-5, rtol=0.0)


def test_learns_at_the_end_of_segments() -> None:
    """At steps 4, 8, … of an episode and at its end, after ``learning_starts`` other segments: 1 + 2 updates."""
    learner = BatchedAcer(SPACE, 3, [9], **as_mapping(replace(OPTIONS, learning_starts=1)))
    rng = np.random.default_rng(5)
    updates = []
    for t in range(12):
        step = random_step(rng)._replace(terminated=np.array([t == 9]), truncated=np.array([False]))
        learner.learn(runs_of(0), step)
        updates.append(float(learner.state()["adam"]["clock"][0]))
    # Segments end with steps 3, 7, 9 (counted from 0); the next one is still open.
    assert updates == [0.0] * 7 + [3.0] * 2 + [6.0] * 3


def test_average_follows() -> None:
    """θ_average ← ¾ θ_average + ¼ θ after each update, from θ in the beginning."""
    options = replace(OPTIONS, trust_region=TrustRegion(average=0.75), replay_ratio=0, learning_starts=0, rollout=1)
    learner = BatchedAcer(SPACE, 3, [9, 10], **as_mapping(options))
    rng = np.random.default_rng(5)
    before = learner.state()
    np.testing.assert_array_equal(before["other"], before["online"])
    for _ in range(3):
        learner.learn(runs_of(1), random_step(rng))
        after = learner.state()
        expected = 0.75 * before["other"][1] + 0.25 * after["online"][1]
        np.testing.assert_allclose(after["other"][1], expected, atol=1e-6)
        np.testing.assert_array_equal(after["other"][0], before["other"][0])
        before = after
