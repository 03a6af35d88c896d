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
import pkgutil
import random
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, ClassVar, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.learners.base import State, Transition

# torch and stable_baselines3 take seconds to import and need not be installed: only the functions that use them import
# them, and their objects are `Any` here.

_ACTION_VALUES: Mapping[str, Callable[[Any, Any], Any]] = {
    "stable_baselines3.dqn.dqn:DQN": lambda policy, observation: policy.q_net(observation),
    "sb3_contrib.qrdqn.qrdqn:QRDQN": lambda policy, observation: policy.quantile_net(observation).mean(dim=1),
}
"""Q(s, ·) of the algorithms that are known to act ε-greedily on it, ``[batch, actions]``."""

_OF_SB3S_LOOP = frozenset({"verbose", "tensorboard_log", "stats_window_size", "_init_setup_model"})
"""Options that concern nothing but the loop which is not run here."""


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
        _check(observation_space, action_space, total_timesteps, options)
        constructor = _off_policy_algorithm(algorithm)
        self._feed = _Feed(observation_space, action_space)
        self._randomness = _Randomness(device)
        self._total_timesteps = total_timesteps
        with self._randomness.active():
            self.algorithm = _construct(constructor, algorithm, self._feed, seed, device, policy=policy, **options)
            self._callback = _set_up(self.algorithm, total_timesteps)
        self._sample_action = self.algorithm._sample_action
        self.algorithm._sample_action = self._given_action
        self._first_action = int(action_space.start)
        self._given = 0
        self._rollout = [0, 0]
        """Steps and episodes since the last one after which ``train_freq`` let it train."""
        self._frozen: Any = None
        family = _family(constructor)
        self._is_known_to_explore = family is not None and all(
            getattr(constructor, name) is getattr(family, name) for name in ("predict", "_sample_action")
        )
        if family is not None:
            self._values = _ACTION_VALUES[_path(family)]
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
            "modules": _arrays(algorithm.get_parameters()),
            "variables": _arrays(_variables(algorithm)),
            "frozen": None if self._frozen is None else _arrays(self._frozen.state_dict()),
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
        algorithm.set_parameters({name: _state_dict(stored) for name, stored in state["modules"].items()})
        for name, tensor in _variables(algorithm).items():
            tensor.data = _tensors(state["variables"][name]).to(tensor.device)
        self._frozen = None
        if state["frozen"] is not None:
            self._frozen = copy.deepcopy(algorithm.policy)
            self._frozen.load_state_dict(_state_dict(state["frozen"]))
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


class _Feed(gymnasium.Env[Any, Any]):
    """An environment without dynamics: it shows the observation and the transition that it was given last."""

    def __init__(self, observation_space: spaces.Space[Any], action_space: Any) -> None:
        # Copies, because SB3 seeds the action space and draws from it.
        self.observation_space = copy.deepcopy(observation_space)
        self.action_space = spaces.Discrete(int(action_space.n))
        self.observation = self.observation_space.sample()
        self.transition: Transition | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        return self.observation, {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert self.transition is not None  # noqa: S101 - learn() has set it
        _, _, reward, following, terminated, truncated, _ = self.transition
        return following, reward, terminated, truncated, {}


class _RandomStates(NamedTuple):
    """States of the random streams of a process."""

    python: tuple[Any, ...]
    numpy: Any
    torch: Any
    cuda: list[Any]


class _Randomness:
    """The random states of one learner, the process's only while `active` (in a process with one thread)."""

    def __init__(self, device: str) -> None:
        from stable_baselines3.common.utils import get_device

        try:
            # Elsewhere CUDA is left alone: to ask for its states would claim memory on it.
            self._uses_cuda = get_device(device).type == "cuda"
        except RuntimeError as error:
            message = f"device: found {device!r}, expected one that torch knows: {error}"
            raise ValueError(message) from error
        self._own = self._states_of_process()

    @contextmanager
    def active(self) -> Iterator[None]:
        """Within, the process draws from these states."""
        outside = self._states_of_process()
        self._enter(self._own)
        try:
            yield
        finally:
            self._own = self._states_of_process()
            self._enter(outside)

    def state(self) -> State:
        """The states as arrays and numbers."""
        version, words, gauss = self._own.python
        return {
            "python": [version, np.array(words), gauss],
            "numpy": copy.deepcopy(self._own.numpy),
            "torch": _arrays(self._own.torch),
            "cuda": _arrays(self._own.cuda),
        }

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        version, words, gauss = state["python"]
        python = (version, tuple(words.tolist()), gauss)
        self._own = _RandomStates(python, state["numpy"], _tensors(state["torch"]), _tensors(state["cuda"]))

    def _states_of_process(self) -> _RandomStates:
        import torch

        cuda = torch.cuda.get_rng_state_all() if self._uses_cuda else []
        numpy_state = np.random.get_state(legacy=False)  # noqa: NPY002 - it is the stream that SB3 draws from
        return _RandomStates(random.getstate(), numpy_state, torch.get_rng_state(), cuda)

    def _enter(self, states: _RandomStates) -> None:
        import torch

        random.setstate(states.python)
        np.random.set_state(states.numpy)  # noqa: NPY002 - as above
        torch.set_rng_state(states.torch)
        if self._uses_cuda:
            torch.cuda.set_rng_state_all(states.cuda)


def _check(observation_space: Any, action_space: Any, total_timesteps: int, options: Mapping[str, Any]) -> None:
    if not isinstance(action_space, spaces.Discrete):
        message = f"found the action space {action_space}, expected a Discrete one"
        raise ValueError(message)
    discrete = spaces.Discrete | spaces.MultiDiscrete
    if not isinstance(observation_space, spaces.Box | spaces.MultiBinary | discrete):
        message = f"found the observation space {observation_space}, expected Box, Discrete, MultiDiscrete, MultiBinary"
        raise ValueError(message)
    if isinstance(observation_space, discrete) and np.any(observation_space.start):
        message = f"found the observation space {observation_space}, expected values that are counted from 0"
        raise ValueError(message)
    if total_timesteps < 1:
        message = f"total_timesteps: found {total_timesteps}, expected at least 1"
        raise ValueError(message)
    for name in sorted(_OF_SB3S_LOOP.intersection(options)):
        message = f"found the option {name!r}, which has no effect here, expected it to be left out"
        raise ValueError(message)


def _off_policy_algorithm(path: str) -> Any:
    try:
        from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
    except ImportError as error:
        message = f'found no stable-baselines3 ({error}), expected it to be installed: pip install "apel[sb3]"'
        raise ValueError(message) from error
    found = _named(path)
    if not isinstance(found, type) or not issubclass(found, OffPolicyAlgorithm):
        message = (
            f"algorithm: found {path!r}, expected a subclass of stable-baselines3's OffPolicyAlgorithm: others cannot "
            "learn from the trajectories of other learners"
        )
        raise ValueError(message)
    return found


def _construct(constructor: Any, path: str, feed: _Feed, seed: int, device: str, **options: Any) -> Any:
    from stable_baselines3.common.vec_env import DummyVecEnv

    resolved = _resolved(options)
    if isinstance(resolved.get("train_freq"), list):  # SB3 takes (2, "episode") as a tuple only, which JSON has not
        resolved["train_freq"] = tuple(resolved["train_freq"])
    word = int(np.random.SeedSequence(seed).generate_state(1)[0])
    try:
        return constructor(env=DummyVecEnv([lambda: feed]), seed=word, device=device, **resolved)
    except AssertionError as error:  # which is how SB3 tells its users
        message = f"algorithm: found {path!r}, expected one for this environment: {error}"
        raise ValueError(message) from error


def _set_up(algorithm: Any, total_timesteps: int) -> Any:
    """What ``learn()`` does before its loop; returns the callback of that loop, which does nothing."""
    from stable_baselines3.common.logger import Logger

    algorithm.set_logger(Logger(folder=None, output_formats=[]))
    _, callback = algorithm._setup_learn(total_timesteps)
    algorithm.start_time = 0  # the time of day is no part of a learner's state
    return callback


def _family(constructor: type) -> Any:
    """The ancestor whose action values are known, if there is one."""
    return next((ancestor for ancestor in constructor.__mro__ if _path(ancestor) in _ACTION_VALUES), None)


def _path(one: type) -> str:
    return f"{one.__module__}:{one.__qualname__}"


def _named(path: str) -> Any:
    try:
        return pkgutil.resolve_name(path)
    except (ImportError, AttributeError, ValueError) as error:
        message = f"found {path!r}, expected an import path 'package.module:Name' ({type(error).__name__}: {error})"
        raise ValueError(message) from error


def _resolved(option: Any) -> Any:
    match option:
        case str() if ":" in option:
            return _named(option)
        case Mapping():
            return {name: _resolved(one) for name, one in option.items()}
        case list() | tuple():
            return [_resolved(one) for one in option]
    return option


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


def _arrays(tree: Any) -> Any:
    """Tensors as arrays, keys as texts: what a checkpoint can hold."""
    import torch

    match tree:
        case torch.Tensor():
            return tree.detach().cpu().numpy().copy()
        case Mapping():
            return {str(key): _arrays(child) for key, child in tree.items()}
        case list() | tuple():
            return [_arrays(child) for child in tree]
    return tree


def _tensors(tree: Any) -> Any:
    import torch

    match tree:
        case np.ndarray():
            return torch.tensor(tree)
        case dict():
            return {key: _tensors(child) for key, child in tree.items()}
        case list():
            return [_tensors(child) for child in tree]
    return tree


def _state_dict(stored: State) -> Any:
    """The state of a module or of an optimiser; the latter numbers its parameters."""
    tensors = _tensors(stored)
    if "param_groups" in tensors:
        tensors["state"] = {int(index): one for index, one in tensors["state"].items()}
    return tensors
