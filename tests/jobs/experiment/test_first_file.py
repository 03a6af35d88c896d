"""What `apel init` writes of an environment's spaces, however these look as texts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from jobs.experiment.first_file import first_file
from jobs.experiment.yaml_source import parse

LONG: dict[str, tuple[spaces.Space[Any], str]] = {
    "many numbers": (spaces.MultiDiscrete([10] * 40), f"MultiDiscrete([{'10 ' * 21}1…"),
    "rows": (spaces.MultiDiscrete(np.full((2, 3), 5)), "MultiDiscrete([[5 5 5] [5 5 5]])"),
}


class Long(gymnasium.Env[Any, Any]):
    """An environment whose space, as a text, has several lines."""

    action_space = spaces.Discrete(2)

    def __init__(self, space: str) -> None:
        self.observation_space = LONG[space][0]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin anywhere."""
        super().reset(seed=seed)
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Go anywhere."""
        return self.observation_space.sample(), 1.0, False, False, {}


@pytest.mark.parametrize("space", LONG)
def test_spaces_of_several_lines(space: str, tmp_path: Path) -> None:
    """They are told in one, so that what follows is no YAML; `first_file` has checked the rest."""
    assert "\n" in str(LONG[space][0])
    name = f"Long{list(LONG).index(space)}-v0"
    gymnasium.register(name, entry_point=lambda: Long(space), max_episode_steps=9)
    try:
        text = first_file("long", name)
    finally:
        del gymnasium.registry[name]
    assert text.splitlines()[0] == f"# {name} (observations {LONG[space][1]}, actions Discrete(2)),"
    assert parse(text, "long.yaml").content["environment"] == {"id": name}
