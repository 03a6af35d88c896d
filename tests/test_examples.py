"""Environments of other packages: every example of `docs/examples` runs, where its packages are installed."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.same_rows import play, run_rows

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"
SMALL = ("runs=1", "episodes=2", "environment.max_episode_steps=12")
SB3 = ("stable_baselines3", "sb3_contrib")
NEEDED = {
    "minigrid": ("minigrid", "torch"),
    "minatar": ("minatar", "torch"),
    "lunar-lander": ("Box2D", "torch"),
    "highway": ("highway_env", *SB3),
    "parking": ("highway_env", *SB3),
    "six-dqn-cartpole": (),
    "six-dqn-acrobot": (),
}


def test_every_example_is_played_here() -> None:
    assert sorted(NEEDED) == sorted(path.stem for path in EXAMPLES.glob("*.yaml"))


@pytest.mark.filterwarnings("default")  # of packages that are not ours
@pytest.mark.parametrize("name", NEEDED)
def test_example_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two short episodes of one run."""
    for package in NEEDED[name]:
        pytest.importorskip(package)
    monkeypatch.syspath_prepend(EXAMPLES)
    rows = run_rows(play(EXAMPLES / f"{name}.yaml", tmp_path, *SMALL, placement="local"))
    assert set(rows["episodes"]) == {2}


def test_shipped_lander_runs(tmp_path: Path) -> None:
    """The shipped experiment with continuous actions."""
    for package in ("Box2D", *SB3):
        pytest.importorskip(package)
    rows = run_rows(play(Path("lunar-lander-continuous"), tmp_path, *SMALL, placement="local"))
    assert rows["episodes"].tolist() == [2] * 3
