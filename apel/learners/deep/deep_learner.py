"""What deep learners have in common: observations in, actions out, and one algorithm on either engine.

An algorithm is a few functions over arrays (`Algorithm`). On the processor all of them are compiled, and whatever a
learner is told, one step of several runs or a whole episode of one, is one call, in which each run is computed by
itself. For PyTorch's networks the same functions run as plain Python, with the runs of a call together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.dynamics.batched_environment import Runs
from apel.learners.banks.batched_learner import NO_ERRORS, Transitions
from apel.learners.base import State
from apel.learners.deep.compiled_network import CompiledNetwork, Descent
from apel.learners.deep.devices import is_compiled_for, quick_to_reach
from apel.learners.deep.draws import Streams
from apel.learners.deep.encoding import Encoder, Frames, encode_all
from apel.learners.deep.engines import ACTING, evaluate, follow
from apel.learners.deep.networks import Architecture
from apel.learners.deep.replay import Minibatch
from apel.learners.own_share import own_part_of
from apel.numerics.compiled import njit

UPDATE, COPY = 1, 2
"""What may be due after a step: an update of the network, and a copy to the other one."""


class Steps(NamedTuple):
    """Steps of A runs, or A steps of one after the other, as memories store them."""

    frames: Frames
    action: NDArray[np.int64]
    reward: NDArray[np.float64]
    next_frames: Frames
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    probability: NDArray[np.float64]
    """``float64[A, actions]``: μ(·|s) of whoever acted; NaN where it is not known."""
    own: NDArray[np.bool_]
    """Whether the learner acted itself."""


class Looking(NamedTuple):
    """Room for one input of each run, ``float32[R, 1, inputs]``, and its outputs."""

    inputs: NDArray[np.float32]
    outputs: NDArray[np.float32]


class Algorithm(NamedTuple):
    """The functions of an algorithm, compiled ones; their ``py_func`` run on PyTorch's networks."""

    act: Any
    """``(learner, runs, frames, actions, probability)``: writes the last two."""
    learn: Any
    """``(learner, runs, steps)``: of compiled networks; a run may be named for several steps in turn."""
    note: Any
    """``(core, run, steps, i)``: remember a step; what is due after it."""
    update: Any
    """``(learner, runs)``: one update of each."""
    look: Any
    """``(outputs, values)``: what the policy acts on, of the outputs ``[A, 1, …]`` of the acting network."""


@njit
def _evaluate_acting(network: Any, runs: Runs, inputs: Any, outputs: Any) -> None:
    evaluate(network, ACTING, runs, 1, inputs, outputs)


class BatchedDeepLearner:
    """A deep learner for R runs.

    Parameters
    ----------
    observation_space:
        What the learners see.
    num_actions:
        How many actions there are.
    seeds:
        A 64-bit seed per run: initial weights, actions and minibatches follow from it.
    options:
        Those of the algorithm.

    Attributes
    ----------
    learner:
        The algorithm's own arrays, as compiled code works on them.
    acting:
        The networks that act.
    num_actions:
        How many actions there are.
    num_runs:
        R.
    """

    off_policy: ClassVar[bool] = True
    errors: ClassVar[Mapping[int, BaseException]] = NO_ERRORS
    algorithm: ClassVar[Algorithm]
    options: Any
    learner: Any

    def __init__(
        self, observation_space: spaces.Space[Any], num_actions: int, seeds: Sequence[int], **options: Any
    ) -> None:
        self.num_actions, self.num_runs = num_actions, len(seeds)
        self._streams = Streams.of_seeds(seeds)
        self._steps = np.zeros(len(seeds), dtype=np.int64)
        self._acted = np.zeros(len(seeds), dtype=np.bool_)
        self.options = self._read(**options)
        self.encoder = Encoder(observation_space, self.options.encoding)
        self.acting: Any = None
        self._build(seeds)
        self.learner = self._assemble()

    def act(self, runs: Runs, observation: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """See `BatchedLearner`."""
        actions, probability = np.empty(len(runs), dtype=np.int64), np.empty((len(runs), self.num_actions))
        self._acted[runs] = True
        self._run(self.algorithm.act)(self.learner, runs, self.encoder.stored(observation), actions, probability)
        return actions, probability

    def action_values(self, runs: Runs, observation: NDArray[Any]) -> NDArray[np.float64]:
        """See `BatchedLearner`: Q(s, ·) of values' learners, π(·|s) of policies'."""
        looking, network = self.learner.looking, self.acting.arrays
        encode_all(self.encoder.coding, self.encoder.stored(observation), looking.inputs)
        self._run(_evaluate_acting)(network, runs, looking.inputs, looking.outputs)
        values = np.empty((len(runs), self.num_actions))
        self.algorithm.look(looking.outputs, values)
        return values

    def learn(self, runs: Runs, transitions: Transitions) -> None:
        """Learn from one step of each run; of compiled networks a run may be named for several steps in turn."""
        _, action, reward, _, *rest = transitions
        # What comes from another process cannot be written to, and would be compiled for once more.
        own: list[Any] = [np.require(column, requirements=["C", "W"]) for column in (action, reward, *rest)]
        seen, following = (self.encoder.stored(one) for one in (transitions.observation, transitions.next_observation))
        steps = Steps(seen, own[0], own[1], following, own[2], own[3], own[4], self._acted[runs])
        self._acted[runs] = False
        self.reserve(runs, len(runs) if self.is_alone else 1)
        if self.is_alone:
            self.algorithm.learn(self.learner, runs, steps)
        else:
            self._learn_together(runs, steps)

    @property
    def is_compiled(self) -> bool:
        """Whether this project's own code multiplies its networks."""
        return isinstance(self.acting, CompiledNetwork)

    @property
    def is_alone(self) -> bool:
        """Whether each run is computed by itself, so that none gains from another's company."""
        return self.is_compiled

    def reserve(self, runs: Runs, steps: int) -> None:
        """See to room for so many steps of each of ``runs``."""

    def end_episode(self, runs: Runs) -> None:
        """The last step has said so."""

    def lag(self, runs: Runs) -> NDArray[np.int64]:
        """See `BatchedLearner`."""
        every = 1 if self.is_alone else getattr(self.options, "train_every", 1)
        return -self._steps[runs] % every

    def freeze(self, runs: Runs) -> None:
        """Act on today's network until the next call."""
        self.acting.freeze(runs)
        self.learner = self._assemble()

    def replay_own(self, share: float) -> None:
        """See `HasReplayMemory`: a step is own if `act` was called before it."""
        self._keep_own(own_part_of(self.options.batch_size, share))
        self.learner = self._assemble()

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        self._restore(state)
        self._acted[:] = False
        self.learner = self._assemble()

    def _run(self, function: Any) -> Callable[..., Any]:
        """A function of the algorithm, as the engine needs it."""
        return function if self.is_alone else function.py_func

    def _learn_together(self, runs: Runs, steps: Steps) -> None:
        note = self.algorithm.note
        due = np.array([note(self.learner.core, run, steps, i) for i, run in enumerate(runs.tolist())])
        for one_call in self.acting.calls(runs[due & UPDATE > 0]):
            self.algorithm.update.py_func(self.learner, one_call)
        copied = runs[due & COPY > 0]
        if len(copied):
            follow(self.acting.arrays, copied, 1.0)

    def _network(
        self, architecture: Architecture, seeds: Sequence[int], descent: Descent, batch_size: int, *, has_other: bool
    ) -> Any:
        """The networks of all runs, on the engine that fits."""
        if is_compiled_for(self.options.device):
            return CompiledNetwork(architecture, seeds, descent, batch_size, has_other=has_other)
        # Loading PyTorch takes seconds, which compiled networks need not spend.
        from apel.learners.deep.stacked_network import StackedNetwork

        options = self.options.device, self.options.lanes
        return StackedNetwork(architecture, seeds, descent, *options, has_other=has_other)

    def _looking(self, num_outputs: int) -> Looking:
        shape = self.num_runs, 1
        inputs = np.zeros((*shape, int(np.prod(self.encoder.shape))), dtype=np.float32)
        return Looking(quick_to_reach(self.options.device, inputs), np.zeros((*shape, num_outputs), dtype=np.float32))

    def _minibatch(self, num_outputs: int) -> Minibatch:
        rows = 1 if self.is_alone else self.num_runs
        batch = Minibatch.empty(rows, self.options.batch_size, int(np.prod(self.encoder.shape)), num_outputs)
        inputs, next_inputs = (quick_to_reach(self.options.device, one) for one in (batch.inputs, batch.next_inputs))
        return batch._replace(inputs=inputs, next_inputs=next_inputs)

    def _read(self, **options: Any) -> Any:
        """The options."""
        raise NotImplementedError

    def _build(self, seeds: Sequence[int]) -> None:
        """Make networks and memories; those that act as ``_acting``."""
        raise NotImplementedError

    def _assemble(self) -> Any:
        """What compiled code works on, after some of it had to be replaced."""
        raise NotImplementedError

    def _keep_own(self, part: int) -> None:
        """From now on draw so many of each minibatch from what is own."""
        raise NotImplementedError

    def state(self) -> State:
        """Everything needed to go on exactly here, by run."""
        raise NotImplementedError

    def _restore(self, state: State) -> None:
        raise NotImplementedError
