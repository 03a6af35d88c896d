"""Off-policy algorithms of stable-baselines3 with a discrete action space, as base learners.

SB3's algorithms own their loop: ``learn()`` steps an environment, stores, and trains. Here the ensemble owns the loop,
and SB3's ``collect_rollouts`` is called for one step at a time on an environment that shows the transition it was
given. So what a step does, from truncation to target updates, is SB3's code and not a copy of it; of ``learn()`` itself
only the rule when to train is written again.

SB3 draws from the process's random streams (``random``, ``numpy``, ``torch``). Each learner has random states of its
own, which are the process's while one of its calls runs, and only then.

Source: Raffin et al. 2021, *Stable-Baselines3: Reliable reinforcement learning implementations*, JMLR 22(268).
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.learners.base import State, Transition
from apel.learners.process_randomness import ProcessRandomness
from apel.learners.stable_baselines_parts import (
    ACTION_VALUES,
    Feed,
    check_spaces,
    construct,
    family_of,
    off_policy_algorithm,
    path_of,
    set_up,
)
from apel.learners.torch_trees import arrays_of, state_dict_of, tensors_of

# torch and stable_baselines3 take seconds to import and need not be installed: only the functions that use them import
# them, and their objects are `Any` here.


class StableBaselines:
    """An off-policy algorithm of stable-baselines3, of sb3-contrib, or a user's in their manner.

    Every transition, own or another's, is a step of the algorithm: it advances ``num_timesteps``, the schedules,
    ``learning_starts``, ``train_freq`` and the target network. Acting alone, it does to the last bit what
    ``learn(total_timesteps)`` of the same algorithm with seed ``learner.algorithm.seed`` does.

    Algorithms derived from DQN or QRDQN also have ``action_values(observation)``. Of these, those that explore as their
    ancestor does also give μ(·|s) and can be frozen; of all others μ is not known.

    Parameters
    ----------
    observation_space:
        Box, Discrete, MultiDiscrete or MultiBinary; discrete values counted from 0.
    action_space:
        Discrete.
    seed:
        Of all its randomness; SB3 takes 32 bits of it.
    algorithm:
        Import path ``package.module:Name``.
    policy:
        Name that the algorithm knows, or import path.
    device:
        As torch names it.
    total_timesteps:
        Steps over which the schedules run; they stay where they are then.
    options:
        Of the algorithm's constructor; a text ``package.module:Name`` anywhere in them stands for what it names.

    Raises
    ------
    ValueError
        If stable-baselines3 is not installed, or the algorithm is not off-policy, not for these spaces, or refuses an
        option.
    """

    off_policy: ClassVar[bool] = True
    action_values: Callable[[Any], NDArray[np.float64]]
    """Only if the algorithm is known to have them: whoever needs them can then say so before anything is played."""

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: Any,
        seed: int,
        *,
        algorithm: str = "stable_baselines3:DQN",
        policy: str = "MlpPolicy",
        device: str = "cpu",
        total_timesteps: int = 100_000,
        **options: Any,
    ) -> None:
        check_spaces(observation_space, action_space, total_timesteps, options)
        constructor = off_policy_algorithm(algorithm)
        self._feed = Feed(observation_space, action_space)
        self._randomness = ProcessRandomness(device)
        self._total_timesteps = total_timesteps
        with self._randomness.active():
            self.algorithm = construct(constructor, algorithm, self._feed, seed, device, policy=policy, **options)
            self._callback = set_up(self.algorithm, total_timesteps)
        self._sample_action = self.algorithm._sample_action
        self.algorithm._sample_action = self._given_action
        self._first_action = int(action_space.start)
        self._given = 0
        self._rollout = [0, 0]
        """Steps and episodes since the last one after which ``train_freq`` let it train."""
        self._frozen: Any = None
        family = family_of(constructor)
        self._is_known_to_explore = family is not None and all(
            getattr(constructor, name) is getattr(family, name) for name in ("predict", "_sample_action")
        )
        if family is not None:
            self._values = ACTION_VALUES[path_of(family)]
            self.action_values = self._action_values

    def act(self, observation: Any) -> tuple[int, NDArray[np.float64] | None]:
        """An action of the exploring policy; and the probabilities of all, if they are known."""
        algorithm = self.algorithm
        with self._randomness.active(), self._acting_policy():
            algorithm._last_obs = self._batch(observation)
            probability = self._probability(algorithm._last_obs)
            action, _ = self._sample_action(algorithm.learning_starts, algorithm.action_noise)
        return int(action.item()) + self._first_action, probability

    def learn(self, transition: Transition) -> None:
        """One turn of ``collect_rollouts``, and ``train`` when it is time."""
        from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit

        algorithm = self.algorithm
        self._feed.transition = transition
        self._given = transition.action - self._first_action
        # Progress runs from 1 to 0; beyond, a decaying learning rate would become negative.
        algorithm._total_timesteps = max(self._total_timesteps, algorithm.num_timesteps + 1)
        one_step = TrainFreq(1, TrainFrequencyUnit.STEP)
        with self._randomness.active():
            algorithm._last_obs = self._batch(transition.observation)
            rollout = algorithm.collect_rollouts(
                algorithm.env,
                self._callback,
                one_step,
                algorithm.replay_buffer,
                action_noise=algorithm.action_noise,
                learning_starts=algorithm.learning_starts,
            )
            self._rollout = [self._rollout[0] + 1, self._rollout[1] + rollout.n_episodes]
            self._train_when_due()

    def end_episode(self) -> None:
        """Nothing: the last transition says that it is the last."""

    def freeze(self) -> None:
        """Act on a copy of today's policy until the next call; ε goes on.

        Raises
        ------
        TypeError
            If the algorithm acts in a way of its own, which may not use the policy that is frozen.
        """
        if not self._is_known_to_explore:
            name = type(self.algorithm).__name__
            message = f"found the algorithm {name}, expected one that explores as DQN or QRDQN does, to be frozen"
            raise TypeError(message)
        self._frozen = copy.deepcopy(self.algorithm.policy)

    def state(self) -> State:
        """Networks, optimisers, the filled part of the replay buffer, counters and random states.

        Of the algorithm and of its replay buffer: what SB3 itself would save as tensors, and all attributes that are
        numbers, texts or (of the buffer) arrays.
        """
        algorithm = self.algorithm
        return {
            "numbers": _numbers(algorithm),
            "modules": arrays_of(algorithm.get_parameters()),
            "variables": arrays_of(_variables(algorithm)),
            "frozen": None if self._frozen is None else arrays_of(self._frozen.state_dict()),
            "replay_numbers": _numbers(algorithm.replay_buffer),
            "replay_arrays": {name: array.copy() for name, array in _filled(algorithm.replay_buffer).items()},
            "rollout": list(self._rollout),
            "random": self._randomness.state(),
            "random_actions": algorithm.action_space.np_random.bit_generator.state,
        }

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        algorithm, replay = self.algorithm, self.algorithm.replay_buffer
        vars(algorithm).update(state["numbers"])
        algorithm.set_parameters({name: state_dict_of(stored) for name, stored in state["modules"].items()})
        for name, tensor in _variables(algorithm).items():
            tensor.data = tensors_of(state["variables"][name]).to(tensor.device)
        self._frozen = None
        if state["frozen"] is not None:
            self._frozen = copy.deepcopy(algorithm.policy)
            self._frozen.load_state_dict(state_dict_of(state["frozen"]))
        vars(replay).update(state["replay_numbers"])
        for name, array in state["replay_arrays"].items():
            vars(replay)[name][: len(array)] = array
        self._rollout = list(state["rollout"])
        self._randomness.restore(state["random"])
        algorithm.action_space.np_random.bit_generator.state = state["random_actions"]

    def _train_when_due(self) -> None:
        """What ``OffPolicyAlgorithm.learn()`` does between two rollouts."""
        from stable_baselines3.common.utils import should_collect_more_steps

        algorithm, (steps, episodes) = self.algorithm, self._rollout
        if should_collect_more_steps(algorithm.train_freq, steps, episodes):
            return
        self._rollout = [0, 0]
        gradient_steps = algorithm.gradient_steps if algorithm.gradient_steps >= 0 else steps
        if algorithm.num_timesteps > algorithm.learning_starts and gradient_steps > 0:
            algorithm.train(gradient_steps=gradient_steps, batch_size=algorithm.batch_size)

    def _given_action(self, *_: Any) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Stands for ``_sample_action`` while learning: the action has been taken already, maybe by another."""
        return np.array([self._given]), np.array([self._given])

    def _batch(self, observation: Any) -> Any:
        """A batch of one, in the dtype and layout that SB3's wrappers give to the algorithm."""
        self._feed.observation = observation
        return self.algorithm.env.reset()

    def _probability(self, batch: Any) -> NDArray[np.float64] | None:
        """μ(a|s) = ε/n + (1 − ε) [a = greedy action], with ε = 1 before ``learning_starts``."""
        if not self._is_known_to_explore:
            return None
        algorithm = self.algorithm
        num_actions = int(algorithm.action_space.n)
        if algorithm.num_timesteps < algorithm.learning_starts:
            return np.full(num_actions, 1.0 / num_actions)
        probability = np.full(num_actions, algorithm.exploration_rate / num_actions)
        greedy, _ = algorithm.policy.predict(batch, deterministic=True)
        probability[int(greedy.item())] += 1.0 - algorithm.exploration_rate
        return probability

    def _action_values(self, observation: Any) -> NDArray[np.float64]:
        """Q(s, ·) ``float64[actions]`` of the policy it acts on: today's, or the frozen one."""
        import torch

        batch = self._batch(observation)
        with self._acting_policy(), torch.no_grad():
            policy = self.algorithm.policy
            policy.set_training_mode(False)
            values: NDArray[np.float64] = self._values(policy, policy.obs_to_tensor(batch)[0])[0].cpu().numpy()
        return values.astype(np.float64)

    @contextmanager
    def _acting_policy(self) -> Iterator[None]:
        """Within, the algorithm's policy is the one to act on."""
        learning = self.algorithm.policy
        self.algorithm.policy = learning if self._frozen is None else self._frozen
        try:
            yield
        finally:
            self.algorithm.policy = learning


def _numbers(owner: Any) -> State:
    return {name: value for name, value in vars(owner).items() if isinstance(value, bool | int | float | str)}


def _variables(algorithm: Any) -> dict[str, Any]:
    """The tensors that the algorithm declares beside its modules and optimisers."""
    from stable_baselines3.common.save_util import recursive_getattr

    _, names = algorithm._get_torch_save_params()
    tensors = {name: recursive_getattr(algorithm, name) for name in names}
    return {name: tensor for name, tensor in tensors.items() if tensor is not None}


def _filled(replay: Any) -> dict[str, NDArray[Any]]:
    """The arrays of a replay buffer, without the rows that were never written."""
    # One row more than there are steps: with optimize_memory_usage it holds the last next observation.
    rows = min(replay.size() + 1, replay.buffer_size)
    arrays = {name: value for name, value in vars(replay).items() if isinstance(value, np.ndarray)}
    return {name: array[:rows] if len(array) == replay.buffer_size else array for name, array in arrays.items()}
