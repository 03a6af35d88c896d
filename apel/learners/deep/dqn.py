"""Deep Q-networks (Mnih et al. 2015) as OpenAI Baselines runs them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.batched_environment import Runs
from apel.learners.banks.single import SingleLearner
from apel.learners.base import State
from apel.learners.deep.compiled_network import Descent
from apel.learners.deep.deep_learner import COPY, UPDATE, Algorithm, BatchedDeepLearner, Looking, Steps
from apel.learners.deep.dqn_options import DqnOptions
from apel.learners.deep.draws import Streams, draw_epsilon_greedy
from apel.learners.deep.encoding import Coding, Frames, encode_all
from apel.learners.deep.engines import ACTING, ONLINE, OTHER, descend, evaluate, evaluate_both, follow, predict
from apel.learners.deep.networks import q_network
from apel.learners.deep.own import own_part
from apel.learners.deep.prioritised import Priorities, Trees, draw_by_priority, reconsider, welcome
from apel.learners.deep.replay import Minibatch, ReplayMemory, Ring, draw, remember, size_of, take
from apel.numerics.compiled import njit


class Rules(NamedTuple):
    """`DqnOptions` as compiled code has them."""

    discount: float
    total_steps: int
    exploring_steps: int
    final_exploration: float
    learning_starts: int
    train_every: int
    target_update_every: int
    double: bool


class Core(NamedTuple):
    """What the learners of R runs have beside their networks."""

    rules: Rules
    coding: Coding
    streams: Streams
    steps: NDArray[np.int64]
    """``int64[R]``: how many were observed."""
    memory: Ring
    trees: Trees


class DqnArrays(NamedTuple):
    """The learners of R runs."""

    core: Core
    network: Any
    looking: Looking
    batch: Minibatch
    chooser: NDArray[np.float32]
    """``[A, B, actions]``: what chooses the actions of the targets."""
    errors: NDArray[np.float32]
    """``[A, B]``."""

    def act(self, *arguments: Any) -> None:
        """See `apel.learners.deep.deep_learner`."""
        act(self, *arguments)

    def learn(self, *arguments: Any) -> None:
        """See `apel.learners.deep.deep_learner`."""
        learn(self, *arguments)


@njit
def act(
    dqn: DqnArrays, runs: Runs, frames: Frames, actions: NDArray[np.int64], probability: NDArray[np.float64]
) -> None:
    """ε-greedy: write ``actions`` ``[A]``, and the ``probability`` ``[A, actions]`` of all."""
    encode_all(dqn.core.coding, frames, dqn.looking.inputs)
    evaluate(dqn.network, ACTING, runs, 1, dqn.looking.inputs, dqn.looking.outputs)
    choose(dqn.core, runs, dqn.looking.outputs, actions, probability)


@njit
def choose(core: Core, runs: Runs, values: Any, actions: NDArray[np.int64], probability: NDArray[np.float64]) -> None:
    """The actions of some runs, of which ``values`` ``[A, 1, actions]`` are Q."""
    for i in range(runs.shape[0]):
        epsilon = exploration(core.rules, core.steps[runs[i]])
        actions[i] = draw_epsilon_greedy(values[i, 0], epsilon, core.streams.acting[runs[i]], probability[i])


@njit
def exploration(rules: Rules, steps: int) -> float:
    """ε after so many observed steps."""
    return 1.0 + (rules.final_exploration - 1.0) * min(steps / rules.exploring_steps, 1.0)


@njit
def learn(dqn: DqnArrays, runs: Runs, steps: Steps) -> None:
    """Learn from steps, one after the other; of compiled networks."""
    for i in range(runs.shape[0]):
        due = note(dqn.core, runs[i], steps, i)
        if due & UPDATE:
            update(dqn, runs[i : i + 1])
        if due & COPY:
            follow(dqn.network, runs[i : i + 1], 1.0)


@njit
def note(core: Core, run: int, steps: Steps, i: int) -> int:
    """Remember one step; what is due after it."""
    memory, rules = core.memory, core.rules
    observation, following, is_own = steps.frames[i], steps.next_frames[i], steps.own[i]
    slot = remember(memory, run, observation, steps.action[i], steps.reward[i], following, steps.terminated[i], is_own)
    if core.trees.sums.shape[0] > 0:
        welcome(core.trees, run, slot, is_own)
    step = core.steps[run]
    core.steps[run] += 1
    if step <= rules.learning_starts:
        return 0
    trains, copies = step % rules.train_every == 0, step % rules.target_update_every == 0
    return (UPDATE if trains else 0) | (COPY if copies else 0)


@njit
def update(dqn: DqnArrays, runs: Runs) -> None:
    """One update of the network of each run."""
    batch, size = dqn.batch, dqn.batch.slots.shape[1]
    sample(dqn.core, runs, batch)
    choosing = ONLINE if dqn.core.rules.double else OTHER
    evaluate_both(dqn.network, OTHER, choosing, runs, size, batch.next_inputs, batch.next_outputs, dqn.chooser)
    predict(dqn.network, runs, size, batch.inputs, batch.outputs)
    td_errors(runs.shape[0], batch, dqn.chooser, dqn.core.rules.discount, dqn.errors)
    descend(dqn.network, runs, size, batch.inputs, batch.gradient)
    reprioritise(dqn.core.trees, runs, batch, dqn.errors)


@njit
def sample(core: Core, runs: Runs, batch: Minibatch) -> None:
    """Draw a minibatch of each run."""
    for i in range(runs.shape[0]):
        run, slots, stream = runs[i], batch.slots[i], core.streams.sampling[runs[i]]
        if core.trees.sums.shape[0] > 0:
            progress = (core.steps[run] - 1) / core.rules.total_steps  # of the step that is learned from
            size, part = size_of(core.memory, run), own_part(core.memory.own, run, slots.shape[0])
            draw_by_priority(core.trees, run, size, progress, part, stream, slots, batch.weight[i])
        else:
            draw(core.memory, run, stream, slots)
    take(core.memory, core.coding, runs, batch)


@njit
def td_errors(num_runs: int, batch: Minibatch, chooser: Any, discount: float, errors: Any) -> None:
    """Write Q(s, a) − y with y = r + γ (1 − terminated) Q_target(s′, a*), ``errors`` ``[A, B]``, and in
    ``batch.gradient`` that of the mean of their weighted Huber losses in Q(s, ·); y is no function of the network.

    a* is the best action by ``chooser`` ``[A, B, actions]``.
    """
    _, size, num_actions = chooser.shape
    for i in range(num_runs):
        for j in range(size):
            target = np.float64(batch.reward[i, j])
            if not batch.terminated[i, j]:
                target += discount * batch.next_outputs[i, j, np.argmax(chooser[i, j])]
            error = batch.outputs[i, j, batch.action[i, j]] - target
            errors[i, j] = error
            for a in range(num_actions):
                batch.gradient[i, j, a] = 0.0
            batch.gradient[i, j, batch.action[i, j]] = batch.weight[i, j] * min(max(error, -1.0), 1.0) / size


@njit
def reprioritise(trees: Trees, runs: Runs, batch: Minibatch, errors: Any) -> None:
    """Where replay is prioritised."""
    if trees.sums.shape[0] > 0:
        for i in range(runs.shape[0]):
            reconsider(trees, runs[i], batch.slots[i], errors[i])


@njit
def look(outputs: Any, values: NDArray[np.float64]) -> None:
    """Q(s, ·) as it is."""
    for i in range(values.shape[0]):
        for a in range(values.shape[1]):
            values[i, a] = outputs[i, 0, a]


class BatchedDqn(BatchedDeepLearner):
    """DQN for R runs; see `DqnOptions`."""

    algorithm = Algorithm(act, learn, note, update, look)
    options: DqnOptions

    def reserve(self, runs: Runs, steps: int) -> None:
        """See `BatchedDeepLearner`."""
        if self._replay.reserve(runs, steps):
            self.learner = self._assemble()

    def state(self) -> State:
        """Networks, optimiser, memory, streams and clocks."""
        return {
            **self._networks.state(),
            "replay": self._replay.state(),
            "priorities": self._priorities.state(),
            "streams": self._streams.state(),
            "steps": self._steps.copy(),
        }

    def _restore(self, state: State) -> None:
        self._networks.restore(state)
        self._replay.restore(state["replay"])
        self._priorities.restore(state["priorities"], self._replay.arrays.own.is_own)
        self._streams.restore(state["streams"])
        self._steps[:] = state["steps"]

    def _keep_own(self, part: int) -> None:
        self._replay.keep_own(part)
        if self.options.prioritized is not None:
            self._priorities.keep_own()

    def _read(self, **options: Any) -> DqnOptions:
        return DqnOptions(**options)

    def _build(self, seeds: Sequence[int]) -> None:
        chosen, encoder = self.options, self.encoder
        architecture = q_network(
            encoder.shape, self.num_actions, chosen.network, chosen.head_hidden, dueling=chosen.dueling
        )
        descent = Descent(chosen.learning_rate, chosen.adam_epsilon, chosen.max_gradient_norm or 0.0, by_variable=True)
        self._networks = self._network(architecture, seeds, descent, chosen.batch_size, has_other=True)
        self.acting = self._networks
        self._replay = ReplayMemory(len(seeds), chosen.replay_size, encoder.stack, encoder.frame_bytes)
        self._priorities = Priorities(len(seeds), chosen.replay_size, chosen.prioritized)
        self._rooms = self._looking(self.num_actions), self._minibatch(self.num_actions)

    def _assemble(self) -> DqnArrays:
        looking, batch = self._rooms
        memory, trees = self._replay.arrays, self._priorities.arrays
        return DqnArrays(
            core=Core(rules_of(self.options), self.encoder.coding, self._streams, self._steps, memory, trees),
            network=self._networks.arrays,
            looking=looking,
            batch=batch,
            chooser=np.zeros_like(batch.outputs),
            errors=np.zeros_like(batch.weight),
        )


def rules_of(options: DqnOptions) -> Rules:
    """The options as compiled code has them."""
    return Rules(
        discount=options.discount,
        total_steps=options.total_steps,
        exploring_steps=max(int(options.exploration_fraction * options.total_steps), 1),
        final_exploration=options.final_exploration,
        learning_starts=options.learning_starts,
        train_every=options.train_every,
        target_update_every=options.target_update_every,
        double=options.double,
    )


class Dqn(SingleLearner):
    """DQN for one run; see `BatchedDqn` and `DqnOptions`."""

    batched_type = BatchedDqn
