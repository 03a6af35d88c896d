"""Soft actor-critic for discrete actions (Christodoulou 2019)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.batched_environment import Runs
from apel.learners.banks.single import SingleLearner
from apel.learners.base import State
from apel.learners.deep.acer import choose, look
from apel.learners.deep.arithmetic import exp, softmax
from apel.learners.deep.compiled_network import Descent
from apel.learners.deep.deep_learner import UPDATE, Algorithm, BatchedDeepLearner, Looking, Steps
from apel.learners.deep.draws import Streams
from apel.learners.deep.encoding import Coding, Frames, encode_all
from apel.learners.deep.engines import ACTING, ONLINE, OTHER, descend, evaluate, follow, predict
from apel.learners.deep.networks import q_network, twin_q
from apel.learners.deep.passes import adam
from apel.learners.deep.replay import Minibatch, ReplayMemory, Ring, draw, remember, take
from apel.learners.deep.sac_options import SacOptions
from apel.numerics.compiled import njit

_CRITIC_SEED = 0x2545F4914F6CDD1D


class Rules(NamedTuple):
    """`SacOptions` as compiled code has them."""

    discount: float
    target_entropy: float
    """Of the policy, in nats."""
    target_average: float
    learning_starts: int
    train_every: int
    learning_rate: float
    epsilon: float


class Temperature(NamedTuple):
    """log α of R runs, and its optimiser's moments, ``float32[R, 1]`` each."""

    logarithm: NDArray[np.float32]
    mean: NDArray[np.float32]
    square: NDArray[np.float32]
    clock: NDArray[np.int64]
    """``int64[R]``."""


class Core(NamedTuple):
    """What the learners of R runs have beside their networks."""

    rules: Rules
    coding: Coding
    streams: Streams
    steps: NDArray[np.int64]
    """``int64[R]``: how many were observed."""
    memory: Ring
    temperature: Temperature


class SacArrays(NamedTuple):
    """The learners of R runs."""

    core: Core
    policy: Any
    critics: Any
    looking: Looking
    batch: Minibatch
    """Its outputs are those of both critics, ``[A, B, 2 · actions]``."""
    logits: NDArray[np.float32]
    """``[A, B, actions]``: of the policy."""
    policy_gradient: NDArray[np.float32]

    def act(self, *arguments: Any) -> None:
        """See `apel.learners.deep.deep_learner`."""
        act(self, *arguments)

    def learn(self, *arguments: Any) -> None:
        """See `apel.learners.deep.deep_learner`."""
        learn(self, *arguments)


@njit
def act(sac: SacArrays, runs: Runs, frames: Frames, actions: NDArray[np.int64], probability: Any) -> None:
    """Draw from the policy: write ``actions`` ``[A]``, and the ``probability`` ``[A, actions]`` of all."""
    encode_all(sac.core.coding, frames, sac.looking.inputs)
    evaluate(sac.policy, ACTING, runs, 1, sac.looking.inputs, sac.looking.outputs)
    look(sac.looking.outputs, probability)
    begin_at_random(sac.core, runs, probability)
    choose(sac.core.streams, runs, probability, actions)


@njit
def begin_at_random(core: Core, runs: Runs, probability: Any) -> None:
    """Uniform probabilities for those that do not learn yet."""
    for i in range(runs.shape[0]):
        if core.steps[runs[i]] < core.rules.learning_starts:
            probability[i] = 1.0 / probability.shape[1]


@njit
def learn(sac: SacArrays, runs: Runs, steps: Steps) -> None:
    """Learn from steps, one after the other; of compiled networks."""
    for i in range(runs.shape[0]):
        if note(sac.core, runs[i], steps, i) & UPDATE:
            update(sac, runs[i : i + 1])


@njit
def note(core: Core, run: int, steps: Steps, i: int) -> int:
    """Remember one step; what is due after it."""
    observation, following = steps.frames[i], steps.next_frames[i]
    columns = steps.action[i], steps.reward[i], following, steps.terminated[i], steps.own[i]
    remember(core.memory, run, observation, *columns)
    step = core.steps[run]
    core.steps[run] += 1
    return UPDATE if step > core.rules.learning_starts and step % core.rules.train_every == 0 else 0


@njit
def update(sac: SacArrays, runs: Runs) -> None:
    """The critics, then the policy against the new critics, then α, then the target."""
    core, batch, size = sac.core, sac.batch, sac.batch.slots.shape[1]
    sample(core, runs, batch)
    evaluate(sac.policy, ONLINE, runs, size, batch.next_inputs, sac.logits)
    evaluate(sac.critics, OTHER, runs, size, batch.next_inputs, batch.next_outputs)
    predict(sac.critics, runs, size, batch.inputs, batch.outputs)
    critic_gradient(core.rules, core.temperature, runs, sac.logits, batch)
    descend(sac.critics, runs, size, batch.inputs, batch.gradient)
    evaluate(sac.critics, ONLINE, runs, size, batch.inputs, batch.outputs)
    predict(sac.policy, runs, size, batch.inputs, sac.logits)
    policy_gradient(core.rules, core.temperature, runs, sac.logits, batch.outputs, sac.policy_gradient)
    descend(sac.policy, runs, size, batch.inputs, sac.policy_gradient)
    follow(sac.critics, runs, core.rules.target_average)


@njit
def sample(core: Core, runs: Runs, batch: Minibatch) -> None:
    """Draw a minibatch of each run."""
    for i in range(runs.shape[0]):
        draw(core.memory, runs[i], core.streams.sampling[runs[i]], batch.slots[i])
    take(core.memory, core.coding, runs, batch)


@njit
def _read_policy(logits: Any, policy: NDArray[np.float64], logarithms: NDArray[np.float64]) -> None:
    shift = softmax(logits, policy)
    for a in range(policy.shape[0]):
        logarithms[a] = np.float64(logits[a]) - shift


@njit
def soft_target(reward: float, discount: float, temperature: float, policy: Any, logarithms: Any, values: Any) -> float:
    """The target y = r + γ Σ_a π(a|s′) (min Q_target(s′, a) − α log π(a|s′)), of both critics' ``values``; γ is 0 after
    the end.
    """
    num_actions, worth = policy.shape[0], 0.0
    for a in range(num_actions):
        smaller = np.float64(min(values[a], values[num_actions + a]))
        worth += policy[a] * (smaller - temperature * logarithms[a])
    return reward + discount * worth


@njit
def critic_gradient(rules: Rules, temperature: Temperature, runs: Runs, next_logits: Any, batch: Minibatch) -> None:
    """Write ``batch.gradient``: of the mean of both critics' halved squared errors, in their outputs."""
    _, size, num_actions = next_logits.shape
    policy, logarithms = np.empty(num_actions), np.empty(num_actions)
    for i in range(runs.shape[0]):
        alpha = exp(np.float64(temperature.logarithm[runs[i], 0]))
        for j in range(size):
            _read_policy(next_logits[i, j], policy, logarithms)
            discount = 0.0 if batch.terminated[i, j] else rules.discount
            reward, values = np.float64(batch.reward[i, j]), batch.next_outputs[i, j]
            target = soft_target(reward, discount, alpha, policy, logarithms, values)
            batch.gradient[i, j] = 0.0
            for k in range(2):
                place = k * num_actions + batch.action[i, j]
                batch.gradient[i, j, place] = (batch.outputs[i, j, place] - target) / size


@njit
def policy_gradient(
    rules: Rules, temperature: Temperature, runs: Runs, logits: Any, values: Any, gradient: Any
) -> None:
    """Write the ``gradient`` ``[A, B, actions]`` of the mean of Σ π (α log π − min Q) in the logits; and step log α
    against the difference of the mean entropy to the target.
    """
    _, size, num_actions = logits.shape
    policy, logarithms, cost = np.empty(num_actions), np.empty(num_actions), np.empty(num_actions)
    for i in range(runs.shape[0]):
        alpha, entropy = exp(np.float64(temperature.logarithm[runs[i], 0])), 0.0
        for j in range(size):
            _read_policy(logits[i, j], policy, logarithms)
            mean = 0.0
            for a in range(num_actions):
                smaller = np.float64(min(values[i, j, a], values[i, j, num_actions + a]))
                cost[a] = alpha * logarithms[a] - smaller
                mean += policy[a] * cost[a]
                entropy -= policy[a] * logarithms[a] / size
            for a in range(num_actions):
                gradient[i, j, a] = policy[a] * (cost[a] - mean) / size
        _step_temperature(rules, temperature, runs[i], entropy - rules.target_entropy)


@njit
def _step_temperature(rules: Rules, temperature: Temperature, run: int, slope: float) -> None:
    gradient = np.full(1, slope, dtype=np.float32)
    temperature.clock[run] += 1
    logarithm, mean, square = temperature.logarithm[run], temperature.mean[run], temperature.square[run]
    adam(temperature.clock[run], rules.learning_rate, rules.epsilon, gradient, logarithm, mean, square)


class BatchedSac(BatchedDeepLearner):
    """Discrete soft actor-critic for R runs; see `SacOptions`."""

    algorithm = Algorithm(act, learn, note, update, look)
    options: SacOptions

    def reserve(self, runs: Runs, steps: int) -> None:
        """See `BatchedDeepLearner`."""
        if self._replay.reserve(runs, steps):
            self.learner = self._assemble()

    def state(self) -> State:
        """Networks, optimisers, memory, streams and clocks."""
        return {
            "policy": self.acting.state(),
            "critics": self._critics.state(),
            "temperature": [array.copy() for array in self._temperature],
            "replay": self._replay.state(),
            "streams": self._streams.state(),
            "steps": self._steps.copy(),
        }

    def _restore(self, state: State) -> None:
        self.acting.restore(state["policy"])
        self._critics.restore(state["critics"])
        arrays: tuple[NDArray[Any], ...] = self._temperature
        for array, stored in zip(arrays, state["temperature"], strict=True):
            array[:] = stored
        self._replay.restore(state["replay"])
        self._streams.restore(state["streams"])
        self._steps[:] = state["steps"]

    def _keep_own(self, part: int) -> None:
        self._replay.keep_own(part)

    def _read(self, **options: Any) -> SacOptions:
        return SacOptions(**options)

    def _build(self, seeds: Sequence[int]) -> None:
        chosen, encoder, num_actions = self.options, self.encoder, self.num_actions
        descent, size = Descent(chosen.learning_rate, chosen.adam_epsilon), chosen.batch_size
        policy = q_network(encoder.shape, num_actions, chosen.network)
        self.acting = self._network(policy, seeds, descent, size, has_other=False)
        critics = twin_q(encoder.shape, num_actions, chosen.network)
        others = [seed ^ _CRITIC_SEED for seed in seeds]
        self._critics = self._network(critics, others, descent, size, has_other=True)
        logarithm = np.full((len(seeds), 1), math.log(chosen.initial_temperature), dtype=np.float32)
        clock = np.zeros(len(seeds), dtype=np.int64)
        self._temperature = Temperature(logarithm, np.zeros_like(logarithm), np.zeros_like(logarithm), clock)
        self._replay = ReplayMemory(len(seeds), chosen.replay_size, encoder.stack, encoder.frame_bytes)
        self._rooms = self._looking(num_actions), self._minibatch(2 * num_actions)

    def _assemble(self) -> SacArrays:
        chosen, (looking, batch) = self.options, self._rooms
        rules, memory, temperature = rules_of(chosen, self.num_actions), self._replay.arrays, self._temperature
        logits = np.zeros((*batch.slots.shape, self.num_actions), dtype=np.float32)
        return SacArrays(
            core=Core(rules, self.encoder.coding, self._streams, self._steps, memory, temperature),
            policy=self.acting.arrays,
            critics=self._critics.arrays,
            looking=looking,
            batch=batch,
            logits=logits,
            policy_gradient=np.zeros_like(logits),
        )


def rules_of(options: SacOptions, num_actions: int) -> Rules:
    """The options as compiled code has them."""
    return Rules(
        discount=options.discount,
        target_entropy=options.target_entropy * math.log(num_actions),
        target_average=options.target_average,
        learning_starts=options.learning_starts,
        train_every=options.train_every,
        learning_rate=options.learning_rate,
        epsilon=options.adam_epsilon,
    )


class DiscreteSac(SingleLearner):
    """Discrete soft actor-critic for one run; see `BatchedSac` and `SacOptions`."""

    batched_type = BatchedSac
