"""Actor-critic with experience replay for discrete actions (Wang et al. 2017)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.batched_environment import Runs
from apel.learners.banks.single import SingleLearner
from apel.learners.base import State
from apel.learners.deep.acer_options import AcerOptions, acer_options
from apel.learners.deep.arithmetic import softmax
from apel.learners.deep.compiled_network import Descent
from apel.learners.deep.deep_learner import UPDATE, Algorithm, BatchedDeepLearner, Looking, Steps
from apel.learners.deep.draws import Streams
from apel.learners.deep.encoding import Coding, Frames, encode_all
from apel.learners.deep.engines import ACTING, OTHER, descend, evaluate, follow, predict
from apel.learners.deep.networks import actor_critic
from apel.learners.deep.retrace import Loss, acer_gradient
from apel.learners.deep.segments import SegmentBatch, SegmentMemory, Segments, append, draw_segments, take_newest
from apel.numerics.compiled import njit
from apel.numerics.streams import categorical, poisson


class Rules(NamedTuple):
    """`AcerOptions` as compiled code has them, but for the loss."""

    learning_starts: int
    replay_ratio: int
    replays_poisson: bool
    batch_size: int
    average: float
    """How much of the average network stays in each update."""
    rows_per_segment: int
    """Where several runs share a call: so many, whatever is in them, so that nobody's rounding depends on how many
    others have. 0: as many as there are.
    """


class Core(NamedTuple):
    """What the learners of R runs have beside their networks."""

    rules: Rules
    loss: Loss
    coding: Coding
    streams: Streams
    memory: Segments


class AcerArrays(NamedTuple):
    """The learners of R runs."""

    core: Core
    network: Any
    looking: Looking
    batch: SegmentBatch

    def act(self, *arguments: Any) -> None:
        """See `apel.learners.deep.deep_learner`."""
        act(self, *arguments)

    def learn(self, *arguments: Any) -> None:
        """See `apel.learners.deep.deep_learner`."""
        learn(self, *arguments)


@njit
def act(acer: AcerArrays, runs: Runs, frames: Frames, actions: NDArray[np.int64], probability: Any) -> None:
    """Draw from the policy: write ``actions`` ``[A]``, and the ``probability`` ``[A, actions]`` of all."""
    encode_all(acer.core.coding, frames, acer.looking.inputs)
    evaluate(acer.network, ACTING, runs, 1, acer.looking.inputs, acer.looking.outputs)
    look(acer.looking.outputs, probability)
    choose(acer.core.streams, runs, probability, actions)


@njit
def look(outputs: Any, probability: Any) -> None:
    """The policy of each run."""
    for i in range(probability.shape[0]):
        softmax(outputs[i, 0, : probability.shape[1]], probability[i])


@njit
def choose(streams: Streams, runs: Runs, probability: Any, actions: NDArray[np.int64]) -> None:
    """Draw an action of each run."""
    for i in range(runs.shape[0]):
        actions[i] = categorical(streams.acting[runs[i]], probability[i])


@njit
def learn(acer: AcerArrays, runs: Runs, steps: Steps) -> None:
    """Learn from steps, one after the other; of compiled networks."""
    for i in range(runs.shape[0]):
        if note(acer.core, runs[i], steps, i) & UPDATE:
            update(acer, runs[i : i + 1])


@njit
def note(core: Core, run: int, steps: Steps, i: int) -> int:
    """Remember one step; what is due after it."""
    is_closed = append(core.memory, run, steps, i)
    return UPDATE if is_closed and core.memory.closed[run] > core.rules.learning_starts else 0


@njit
def update(acer: AcerArrays, runs: Runs) -> None:
    """One update of each run on its newest segment, and some on others from memory (see `take_newest` for whose)."""
    core, batch, rules = acer.core, acer.batch, acer.core.rules
    counts = np.zeros(runs.shape[0], dtype=np.int64)
    repeat, learning = 0, runs
    while learning.shape[0] > 0:
        if repeat == 0:
            size, rows = 1, take_newest(core.memory, core.coding, learning, core.streams.sampling, batch)
            count_replays(core, runs, counts)
        else:
            size = rules.batch_size
            rows = draw_segments(core.memory, core.coding, learning, size, core.streams.sampling, batch)
        rows = size * rules.rows_per_segment if rules.rows_per_segment > 0 else rows
        has_region = core.loss.bound < np.inf
        if has_region:
            evaluate(acer.network, OTHER, learning, rows, batch.inputs, batch.average)
        predict(acer.network, learning, rows, batch.inputs, batch.outputs)
        acer_gradient(core.loss, batch, learning.shape[0], size)
        descend(acer.network, learning, rows, batch.inputs, batch.gradient)
        if has_region:
            follow(acer.network, learning, 1.0 - rules.average)
        learning = runs[counts > repeat]
        repeat += 1


@njit
def count_replays(core: Core, runs: Runs, counts: NDArray[np.int64]) -> None:
    """Write how many updates from memory are due in each run."""
    for i in range(runs.shape[0]):
        ratio = core.rules.replay_ratio
        counts[i] = poisson(core.streams.sampling[runs[i]], ratio) if core.rules.replays_poisson else ratio


class BatchedAcer(BatchedDeepLearner):
    """ACER for R runs.

    Its options are ``preset`` (one of `PRESETS`), and those of `AcerOptions`.
    """

    algorithm = Algorithm(act, learn, note, update, look)
    options: AcerOptions

    def state(self) -> State:
        """Networks, optimiser, memory and streams."""
        return {**self._networks.state(), "memory": self._memory.state(), "streams": self._streams.state()}

    def _restore(self, state: State) -> None:
        self._networks.restore(state)
        self._memory.restore(state["memory"])
        self._streams.restore(state["streams"])

    def replay_own(self, share: float) -> None:
        """See `HasReplayMemory`: of segments, and not without ``replay_ratio``."""
        if self.options.replay_ratio == 0:
            message = "replay_ratio: found 0, expected at least 1 for a share of what is replayed"
            raise ValueError(message)
        super().replay_own(share)

    def _keep_own(self, part: int) -> None:
        self._memory.keep_own(part)

    def _read(self, **options: Any) -> AcerOptions:
        return acer_options(**options)

    def _build(self, seeds: Sequence[int]) -> None:
        chosen, encoder, num_actions = self.options, self.encoder, self.num_actions
        architecture = actor_critic(encoder.shape, num_actions, chosen.network)
        descent = Descent(chosen.learning_rate, chosen.adam_epsilon, chosen.max_gradient_norm or 0.0)
        size, length = max(chosen.batch_size, 1), chosen.rollout
        has_other = chosen.trust_region is not None
        rows = size * (length + 1)
        self._networks = self._network(architecture, seeds, descent, rows, has_other=has_other)
        self.acting = self._networks
        frames = encoder.stack, encoder.frame_bytes
        self._memory = SegmentMemory(len(seeds), chosen.replay_size, length, num_actions, frames)
        num_inputs = int(np.prod(encoder.shape))
        batch = SegmentBatch.empty(1 if self.is_alone else len(seeds), size, length, num_inputs, num_actions)
        self._rooms = self._looking(2 * num_actions), batch

    def _assemble(self) -> AcerArrays:
        chosen, region = self.options, self.options.trust_region
        rules = Rules(
            learning_starts=chosen.learning_starts,
            replay_ratio=chosen.replay_ratio,
            replays_poisson=chosen.replay_count == "poisson",
            batch_size=chosen.batch_size,
            average=region.average if region else 1.0,
            rows_per_segment=0 if self.is_alone else chosen.rollout + 1,
        )
        core = Core(rules, loss_of(chosen), self.encoder.coding, self._streams, self._memory.arrays)
        return AcerArrays(core, self._networks.arrays, *self._rooms)


def loss_of(options: AcerOptions) -> Loss:
    """What is descended in."""
    return Loss(
        discount=options.discount,
        truncation=options.truncation,
        bound=options.trust_region.bound if options.trust_region else np.inf,
        entropy=options.entropy,
        critic=options.critic,
        huber=options.critic_loss == "huber",
        reward_scale=options.reward_scale,
        bootstraps_next=options.bootstrap == "next_state",
    )


class Acer(SingleLearner):
    """ACER for one run; see `BatchedAcer` and `AcerOptions`."""

    batched_type = BatchedAcer
