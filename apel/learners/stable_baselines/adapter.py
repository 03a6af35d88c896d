"""Off-policy algorithms of stable-baselines3, with discrete and with continuous actions, as base learners.

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
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.experience.action_form import ActionForm
from apel.learners.base import State, Transition
from apel.learners.stable_baselines.exploration import (
    ACTION_VALUES,
    density_of,
    epsilon_greedy,
    family_of,
    is_squashed,
    noise_of,
    path_of,
)
from apel.learners.stable_baselines.own_replay import OwnReplay
from apel.learners.stable_baselines.parts import (
    Feed,
    check_algorithm,
    check_options,
    construct,
    off_policy_algorithm,
    set_up,
    train_when_due,
)
from apel.learners.stable_baselines.process_randomness import ProcessRandomness
from apel.learners.stable_baselines.sb3_spaces import check_actions
from apel.learners.stable_baselines.stored_state import (
    algorithm_state,
    learned_modules,
    learned_variables,
    restore_algorithm,
    with_own_options,
)
from apel.learners.stable_baselines.torch_trees import arrays_of, state_dict_of
from apel.learners.supported_spaces import sb3_spaces
from apel.numerics import rounding, threads

# Only the functions that use torch and SB3 import them: they take seconds, and need not be there. Theirs is `Any` here.


class StableBaselines:
    """An off-policy algorithm of stable-baselines3, of sb3-contrib, or a user's in their manner.

    Every transition, own or another's, is a step of the algorithm: it advances ``num_timesteps``, the schedules,
    ``learning_starts``, ``train_freq`` and the target network. Acting alone, it does to the last bit what
    ``learn(total_timesteps)`` of the same algorithm with seed ``learner.algorithm.seed`` does.

    Algorithms derived from DQN or QRDQN also have ``action_values(observation)``, those derived from SAC, TD3, DDPG,
    TQC or CrossQ ``greedy_action(observation)``. Those that explore as their ancestor does can be frozen; of them the
    kin of DQN and QRDQN give μ(·|s), and that of SAC, TQC and CrossQ the density of their action, if there is no
    `action_noise`. (The clipped noise of TD3 and DDPG has none.) Of all others μ is not known.

    A continuous action that was rounded across a bound when it was scaled to the environment's is put onto it.

    Parameters
    ----------
    observation_space:
        Box, Discrete, MultiDiscrete or MultiBinary; with ``MultiInputPolicy`` a Dict of these.
    action_space:
        Discrete, or a Box with finite bounds.
    seed:
        Of all its randomness; SB3 takes 32 bits of it.
    algorithm:
        Import path ``package.module:Name``.
    policy:
        Name that the algorithm knows, or import path.
    action_noise:
        Of algorithms with continuous actions, see `apel.learners.stable_baselines.parts.noise_of`.
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
    supported_spaces = staticmethod(sb3_spaces)
    action_values: Callable[[Any], NDArray[np.float64]]
    greedy_action: Callable[[Any], NDArray[Any]]
    """Both only if the algorithm is known to have them: who needs them can then say so before anything is played."""

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: Any,
        seed: int,
        *,
        algorithm: str = "stable_baselines3:DQN",
        policy: str = "MlpPolicy",
        action_noise: Mapping[str, Any] | None = None,
        device: str = "cpu",
        total_timesteps: int = 100_000,
        **options: Any,
    ) -> None:
        check_actions(action_space)
        check_options(total_timesteps, options)
        rounding.settle()
        constructor = off_policy_algorithm(algorithm)
        rounding.warn_if_too_late()
        threads.settle()
        self._feed = Feed(observation_space, action_space)
        self._randomness = ProcessRandomness(device)
        self._total_timesteps = total_timesteps
        with self._randomness.active():
            noise = {} if action_noise is None else {"action_noise": noise_of(action_noise, action_space)}
            options = {"policy": policy, **noise, **options}
            self.algorithm = construct(constructor, algorithm, self._feed, seed, device, **options)
            check_algorithm(self.algorithm)
            self._callback = set_up(self.algorithm, total_timesteps)
        self._sample_action = self.algorithm._sample_action
        self.algorithm._sample_action = self._given_action
        self._actions = ActionForm(action_space)
        self._given: tuple[Any, Any] = (None, None)
        self._chosen: tuple[Any, Any] | None = None
        """The continuous action that was chosen last, and what SB3 remembers of it."""
        self._rollout = [0, 0]
        """Steps and episodes since the last one after which ``train_freq`` let it train."""
        self._frozen: Any = None
        self._own_replay: OwnReplay | None = None
        self._has_acted = False
        family = family_of(constructor)
        self._is_known_to_explore = family is not None and all(
            getattr(constructor, name) is getattr(family, name) for name in ("predict", "_sample_action")
        )
        self._has_density = self._is_known_to_explore and is_squashed(family) and self.algorithm.action_noise is None
        if family is not None and self._actions.is_discrete:
            self._values = ACTION_VALUES[path_of(family)]
            self.action_values = self._action_values
        elif family is not None:
            self.greedy_action = self._greedy_action

    def act(self, observation: Any) -> tuple[Any, NDArray[np.float64] | float | None]:
        """An action of the exploring policy; and μ, if it is known."""
        algorithm, self._has_acted = self.algorithm, True
        with self._randomness.active(), self._acting_policy():
            batch = algorithm._last_obs = self._batch(observation)
            is_known = self._is_known_to_explore and self._actions.is_discrete
            known = epsilon_greedy(algorithm, batch) if is_known else None
            action, remembered = self._sample_action(algorithm.learning_starts, algorithm.action_noise)
            if self._actions.is_discrete:
                return int(action.item()) + self._actions.first, known
            density = density_of(algorithm, self._actions.space, batch, remembered) if self._has_density else None
        self._chosen = self._within_bounds(action[0]), remembered
        return self._chosen[0].copy(), density

    def learn(self, transition: Transition) -> None:
        """One turn of ``collect_rollouts``, and ``train`` when it is time."""
        from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit

        algorithm = self.algorithm
        if self._own_replay is not None:
            self._own_replay.add(algorithm.replay_buffer.pos, is_own=self._has_acted)
        self._has_acted = False
        self._feed.transition = transition
        self._given = self._as_sb3_knows(transition.action)
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
            if train_when_due(algorithm, *self._rollout):
                self._rollout = [0, 0]

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
            message = f"found the algorithm {name}, expected one that explores as those of SB3 do, to be frozen"
            raise TypeError(message)
        self._frozen = copy.deepcopy(self.algorithm.policy)

    def replay_own(self, share: float) -> None:
        """See `HasReplayMemory`: what is drawn from the replay buffer; a step is own if `act` was called before it.

        Raises
        ------
        TypeError
            If the buffer draws in a way of its own.
        """
        self._own_replay = OwnReplay(self.algorithm.replay_buffer, share)

    def state(self) -> State:
        """What `algorithm_state` says, and where the adapter stands."""
        return {
            **algorithm_state(self.algorithm),
            "frozen": None if self._frozen is None else arrays_of(self._frozen.state_dict()),
            "rollout": list(self._rollout),
            "random": self._randomness.state(),
            **({} if self._own_replay is None else {"own": self._own_replay.state()}),
        }

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        restore_algorithm(self.algorithm, state)
        self._frozen = None
        if state["frozen"] is not None:
            self._frozen = copy.deepcopy(self.algorithm.policy)
            self._frozen.load_state_dict(state_dict_of(state["frozen"]))
        if self._own_replay is not None:
            self._own_replay.restore(state.get("own", ()))
        self._chosen, self._has_acted = None, False
        self._rollout = list(state["rollout"])
        self._randomness.restore(state["random"])

    def begin_from(self, state: State) -> None:
        """Begin with networks, optimisers, memory and counters of another one, see `apel.learners.starting.Beginner`.

        What the constructor is told is no counter, and stays what it was told here.

        Raises
        ------
        ValueError
            If the other one's memory is of another size.
        """
        algorithm = self.algorithm
        own, sizes = self.state(), (int(state["replay_numbers"]["buffer_size"]), algorithm.replay_buffer.buffer_size)
        if sizes[0] != sizes[1]:
            message = f"buffer_size: found {sizes[1]}, expected {sizes[0]}, as of the learner that it begins with"
            raise ValueError(message)
        kept = {name: own[name] for name in ("frozen", "noise", "random", "random_actions")}
        numbers = with_own_options(state["numbers"], own["numbers"], type(algorithm))
        memory = type(algorithm.replay_buffer)
        kept["replay_numbers"] = with_own_options(state["replay_numbers"], own["replay_numbers"], memory)
        modules = learned_modules(state["modules"], own["modules"])
        variables = learned_variables(state["variables"], own["variables"])
        self.restore({**state, **kept, "numbers": numbers, "modules": modules, "variables": variables})

    def save(self, path: str) -> None:
        """Write the algorithm as stable-baselines3's own zip file, which its ``load`` reads; without replay buffer, as
        that does it.
        """
        self.algorithm.save(path, exclude=["_sample_action"])

    def _given_action(self, *_: Any) -> tuple[Any, Any]:
        """Stands for ``_sample_action`` while learning: the action has been taken already, maybe by another."""
        return self._given

    def _as_sb3_knows(self, action: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        """A batch of one action, and what SB3 remembers of it: of continuous ones where they lie between −1 and 1."""
        if self._actions.is_discrete:
            counted = np.array([action - self._actions.first])
            return counted, counted
        chosen, self._chosen = self._chosen, None
        batch = np.asarray(action)[None]
        if chosen is not None and np.array_equal(chosen[0], action):
            return batch, chosen[1]  # its own, as it was before it was scaled
        return batch, self.algorithm.policy.scale_action(batch)

    def _within_bounds(self, action: NDArray[Any]) -> NDArray[Any]:
        space = self._actions.space
        return np.clip(action, space.low, space.high).astype(space.dtype)

    def _greedy_action(self, observation: Any) -> NDArray[Any]:
        """The mean, or the mode, of the policy it acts on: today's, or the frozen one."""
        with self._acting_policy():
            action, _ = self.algorithm.policy.predict(self._batch(observation), deterministic=True)
        return self._within_bounds(action[0])

    def _batch(self, observation: Any) -> Any:
        """A batch of one, in the dtype and layout that SB3's wrappers give to the algorithm."""
        self._feed.show(observation)
        return self.algorithm.env.reset()

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
