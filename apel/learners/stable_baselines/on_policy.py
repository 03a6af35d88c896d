"""On-policy algorithms of stable-baselines3 (PPO, A2C), as base learners.

They learn from what they did themselves and from nothing else, so they are members of an ensemble with
``learns_from: own`` alone. As in `.adapter` SB3's ``collect_rollouts`` is called for one step at a time; here the
policy answers there what it has answered in `act`, and the buffer begins and ends a rollout when SB3's loop would.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.experience.action_form import ActionForm
from apel.learners.base import State, Transition
from apel.learners.stable_baselines.parts import Feed, check_options, construct, on_policy_algorithm, set_up
from apel.learners.stable_baselines.process_randomness import ProcessRandomness
from apel.learners.stable_baselines.sb3_spaces import check_actions
from apel.learners.stable_baselines.stored_state import (
    copied,
    learned_modules,
    numbers_of,
    whole,
    with_own_options,
)
from apel.learners.stable_baselines.torch_trees import arrays_of, state_dict_of
from apel.learners.supported_spaces import sb3_on_policy_spaces
from apel.numerics import rounding, threads


class StableBaselinesOnPolicy:
    """An on-policy algorithm of stable-baselines3, of sb3-contrib, or a user's in their manner.

    To the last bit it does what ``learn(total_timesteps)`` of the same algorithm with seed ``learner.algorithm.seed``
    would do with its own episodes in a row. μ(·|s) is known, but for continuous actions that were clipped.

    Parameters
    ----------
    observation_space:
        Box, Discrete, MultiDiscrete or MultiBinary; with ``MultiInputPolicy`` a Dict of these.
    action_space:
        Discrete, MultiDiscrete, MultiBinary, or a Box with finite bounds.
    seed:
        Of all its randomness; SB3 takes 32 bits of it.
    algorithm:
        Import path ``package.module:Name``.
    policy:
        Name that the algorithm knows, or import path.
    device:
        As torch names it.
    total_timesteps:
        Own steps over which the schedules run; they stay where they are then.
    options:
        Of the algorithm's constructor; a text ``package.module:Name`` anywhere in them stands for what it names.

    Raises
    ------
    ValueError
        If stable-baselines3 is not installed, or the algorithm is not on-policy, not for these spaces, explores by
        state-dependent noise, or refuses an option.
    """

    off_policy: ClassVar[bool] = False
    supported_spaces = staticmethod(sb3_on_policy_spaces)

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: Any,
        seed: int,
        *,
        algorithm: str = "stable_baselines3:PPO",
        policy: str = "MlpPolicy",
        device: str = "cpu",
        total_timesteps: int = 100_000,
        **options: Any,
    ) -> None:
        if isinstance(action_space, spaces.Box):
            check_actions(action_space)
        if isinstance(action_space, spaces.MultiDiscrete) and len(action_space.shape) != 1:
            message = f"found the action space {action_space}, expected one of a single dimension, as stable-baselines3"
            raise ValueError(message)
        check_options(total_timesteps, options)
        if options.get("use_sde"):
            message = "use_sde: found true, expected false: noise that lasts for steps is not kept between episodes"
            raise ValueError(message)
        rounding.settle()
        constructor = on_policy_algorithm(algorithm)
        rounding.warn_if_too_late()
        threads.settle()
        self._feed = Feed(observation_space, action_space)
        self._randomness = ProcessRandomness(device)
        self._total_timesteps = total_timesteps
        with self._randomness.active():
            self.algorithm = construct(constructor, algorithm, self._feed, seed, device, policy=policy, **options)
            self._callback = set_up(self.algorithm, total_timesteps)
        self._actions = ActionForm(action_space)
        self._answer: Any = None
        """Actions, values and logarithms of probabilities, as the policy's ``forward`` gave them in `act`."""
        self._forward = self.algorithm.policy.forward
        self.algorithm.policy.forward = lambda *_, **__: self._answer
        self._rollout = _Rollout(self.algorithm.rollout_buffer, self.algorithm.n_steps)

    def act(self, observation: Any) -> tuple[Any, NDArray[np.float64] | float | None]:
        """An action drawn from the policy; and of discrete ones the probabilities of all, of others its density."""
        import torch
        from stable_baselines3.common.utils import obs_as_tensor

        algorithm = self.algorithm
        with self._randomness.active(), torch.no_grad():
            algorithm.policy.set_training_mode(False)
            seen = obs_as_tensor(self._batch(observation), algorithm.device)
            drawn, _, log_probability = self._answer = self._forward(seen)
            if self._actions.is_discrete:
                known = algorithm.policy.get_distribution(seen).distribution.probs[0]
                return int(drawn[0].item()) + self._actions.first, known.cpu().numpy().astype(np.float64)
        action, density = drawn[0].cpu().numpy(), float(log_probability[0].exp())
        space = self._actions.space
        if not isinstance(space, spaces.Box):
            first = space.start if isinstance(space, spaces.MultiDiscrete) else 0  # SB3 counts from 0
            return (action.reshape(space.shape) + first).astype(space.dtype), density
        within = np.clip(action, space.low, space.high)
        return within, density if np.array_equal(within, action) else None

    def learn(self, transition: Transition) -> None:
        """One turn of ``collect_rollouts``, and ``train`` at the end of a rollout."""
        algorithm = self.algorithm
        self._feed.transition = transition
        with self._randomness.active():
            algorithm._last_obs = self._batch(transition.observation)
            self._rollout.begin_when_due()
            algorithm.collect_rollouts(algorithm.env, self._callback, self._rollout, 1)
            if self._rollout.is_full():
                # Progress runs from 1 to 0; beyond, a decaying learning rate would become negative.
                total = max(self._total_timesteps, algorithm.num_timesteps)
                algorithm._update_current_progress_remaining(algorithm.num_timesteps, total)
                algorithm.train()

    def end_episode(self) -> None:
        """Nothing: the last transition says that it is the last."""

    def state(self) -> State:
        """Networks, optimiser, the rollout under way, counters and random states."""
        algorithm, buffer = self.algorithm, self._rollout.buffer
        return {
            "numbers": numbers_of(algorithm),
            "modules": arrays_of(algorithm.get_parameters()),
            "episode_starts": np.array(algorithm._last_episode_starts),
            "buffer_numbers": numbers_of(buffer),
            "buffer_arrays": whole(buffer),
            "random": self._randomness.state(),
        }

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        algorithm, buffer = self.algorithm, self._rollout.buffer
        vars(algorithm).update(state["numbers"])
        algorithm.set_parameters({name: state_dict_of(stored) for name, stored in state["modules"].items()})
        algorithm._last_episode_starts = np.array(state["episode_starts"])
        vars(buffer).update(state["buffer_numbers"])
        vars(buffer).update({name: copied(column) for name, column in state["buffer_arrays"].items()})
        self._randomness.restore(state["random"])

    def begin_from(self, state: State) -> None:
        """Begin with networks, optimiser, counters and rollout of another one, see `apel.learners.starting.Beginner`.

        What the constructor is told is no counter, and stays what it was told here. A rollout of another ``n_steps``
        does not fit: then the first one begins empty.
        """
        own, algorithm = self.state(), self.algorithm
        numbers = with_own_options(state["numbers"], own["numbers"], type(algorithm))
        # The next step is the first of an episode, wherever the other one stood.
        kept = {name: own[name] for name in ("random", "episode_starts")}
        if state["numbers"]["n_steps"] != algorithm.n_steps:
            kept |= {name: own[name] for name in ("buffer_numbers", "buffer_arrays")}
        else:
            buffer = type(self._rollout.buffer)
            kept["buffer_numbers"] = with_own_options(state["buffer_numbers"], own["buffer_numbers"], buffer)
        modules = learned_modules(state["modules"], own["modules"])
        self.restore({**state, **kept, "numbers": numbers, "modules": modules})

    def _batch(self, observation: Any) -> Any:
        """A batch of one, in the dtype and layout that SB3's wrappers give to the algorithm."""
        self._feed.show(observation)
        return self.algorithm.env.reset()


class _Rollout:
    """A rollout buffer that is filled by calls of ``collect_rollouts`` for one step each."""

    def __init__(self, buffer: Any, num_steps: int) -> None:
        self.buffer, self._num_steps = buffer, num_steps

    def begin_when_due(self) -> None:
        """Empty the buffer before the first step, and before the first after a full one."""
        if self.is_full() or self.buffer.pos == 0:
            self.buffer.reset()

    def is_full(self) -> bool:
        """Whether there are as many steps as a rollout has."""
        return int(self.buffer.pos) >= self._num_steps

    def reset(self) -> None:
        """Nothing: the rollout goes on."""

    def add(self, *step: Any) -> None:
        """Keep a step."""
        self.buffer.add(*step)

    def compute_returns_and_advantage(self, **last: Any) -> None:
        """At the end of the rollout alone."""
        if self.is_full():
            self.buffer.compute_returns_and_advantage(**last)
