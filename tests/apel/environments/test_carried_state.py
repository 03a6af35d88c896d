"""What is known of what an environment carries from one episode to the next, and what is not."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import NormalizeObservation, NormalizeReward

from apel.environments.carried_state import CarriedStateError
from apel.environments.environment_list import EnvironmentList

RUN = np.zeros(1, dtype=np.int64)


class PaysByEpisode(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Pays for the number of its episodes, which the wrapper that stands behind it does not know of."""

    num_episodes = 0

    def reset(self, **options: Any) -> Any:
        self.num_episodes += 1
        return super().reset(**options)

    def step(self, action: Any) -> Any:
        observation, reward, *rest = super().step(action)
        return observation, float(reward) + self.num_episodes, *rest


class Counting(PaysByEpisode, NormalizeObservation[Any, Any, Any]):
    """Carries that besides what is normalised by."""


class CountingReward(PaysByEpisode, NormalizeReward[Any, Any]):
    """The same of the other wrapper."""


class Telling(Counting):
    """Says what it carries."""

    def state(self) -> dict[str, Any]:
        moments = self.obs_rms
        return {"episodes": self.num_episodes, "moments": [moments.mean.copy(), moments.var.copy(), moments.count]}

    def restore(self, state: dict[str, Any]) -> None:
        self.num_episodes = state["episodes"]
        self.obs_rms.mean, self.obs_rms.var, self.obs_rms.count = state["moments"]


def new(make: Any) -> Any:
    """Around an environment of Gymnasium's, which carries nothing over."""
    return make(gymnasium.make("CartPole-v1"))


def used(make: Any) -> EnvironmentList:
    """After three episodes."""
    environments = EnvironmentList([new(make)])
    for seed in range(3):
        environments.reset(RUN, [seed])
        environments.step(RUN, np.array([0]))
    return environments


@pytest.mark.parametrize("make", [Counting, CountingReward])
def test_subclasses_of_wrappers_that_normalise_may_carry_more(make: Any) -> None:
    """So they are watched like any wrapper that is not known."""
    environments = used(make)
    assert environments.is_taped
    with pytest.raises(CarriedStateError, match=r"carries something over .* state\(\) and restore\(state\)"):
        EnvironmentList([new(make)]).restore(environments.state())


@pytest.mark.parametrize("make", [NormalizeObservation, NormalizeReward])
def test_wrappers_that_normalise_carry_what_is_known(make: Any) -> None:
    """So they need not be watched."""
    environments, again = used(make), EnvironmentList([new(make)])
    assert not environments.is_taped
    again.restore(environments.state())
    assert repr(again.state()) == repr(environments.state())


def test_subclasses_of_wrappers_that_normalise_may_say_what_they_carry() -> None:
    """Then they are asked, and what the wrapper itself would carry is theirs to tell."""
    environments = used(Telling)
    again = new(Telling)
    EnvironmentList([again]).restore(environments.state())
    assert again.num_episodes == 3
    assert again.obs_rms.count > 3
    assert not environments.is_taped
