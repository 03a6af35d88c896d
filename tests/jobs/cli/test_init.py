"""`apel init`: a file that is valid as it stands, with learners that suit the environment."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import pytest
from gymnasium import spaces

from jobs.experiment.spec_files import load_experiment
from tests.command_line import call, printed
from tests.user_code import Corridor


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


class Switches(gymnasium.Env[int, object]):
    """Of a kind for whose actions nothing comes along."""

    observation_space = spaces.Discrete(2)
    action_space = spaces.MultiBinary(3)

    def reset(self, **_: object) -> tuple[int, dict[str, object]]:
        return 0, {}


def test_tables(capsys: pytest.CaptureFixture[str]) -> None:
    """A finite environment gets tables, the threshold that Gymnasium knows, and a comment for every learner."""
    told = printed(capsys, "init", "lake.yaml", "--env", "FrozenLake-v1")
    assert "wrote lake.yaml" in told
    assert "apel run lake.yaml --arms ensemble --runs 1" in told
    experiment = load_experiment("lake.yaml")
    assert experiment.name == "lake"
    assert {one.type for one in experiment.learners.values()} == {"q_learning", "dyna_q"}
    assert list(experiment.arms) == [*experiment.learners, "ensemble"]
    assert experiment.arms["ensemble"].learner_names == list(experiment.learners)
    assert experiment.arms["ensemble"].selector is not None
    assert experiment.arms["ensemble"].selector.type == "incumbent"
    assert experiment.environment.max_episode_steps is None
    assert experiment.criterion is not None
    assert experiment.criterion.at_least == 0.70
    text = Path("lake.yaml").read_text()
    assert text.isascii() or "ε" in text
    assert max(map(len, text.splitlines())) <= 120
    assert printed(capsys, "validate", "lake.yaml").startswith("lake (")


def test_networks(capsys: pytest.CaptureFixture[str]) -> None:
    """Vectors get networks."""
    printed(capsys, "init", "cart.yaml", "--env", "CartPole-v1")
    experiment = load_experiment("cart.yaml")
    assert experiment.models == "final"  # so that `apel export` need not play a run again
    assert experiment.steps == 100_000
    assert experiment.learners["DQN"].options["total_steps"] == experiment.steps
    types = [one.type for one in experiment.learners.values()]
    assert len(types) >= 5
    assert set(types) == {"dqn", "acer", "sac"}


def test_import_path(capsys: pytest.CaptureFixture[str]) -> None:
    """One's own environment, whose episodes nothing limits."""
    printed(capsys, "init", "2 own.yaml", "--env", "tests.user_code:Corridor")
    experiment = load_experiment("2 own.yaml")
    assert experiment.name == "tests.user_code-Corridor"
    assert experiment.environment.id == f"tests.user_code:{Corridor.__name__}"
    assert experiment.environment.max_episode_steps == 500


BAD = {
    "there already": (["there.yaml", "--env", "FrozenLake-v1"], "there.yaml: found a file that is there already"),
    "no yaml": (["there.txt", "--env", "FrozenLake-v1"], "found the file 'there.txt', expected a .yaml"),
    "no folder": (["no/where.yaml", "--env", "FrozenLake-v1"], "expected a .yaml in a folder that exists"),
    "no such environment": (["new.yaml", "--env", "FrozenLak-v1"], "Did you mean: `FrozenLake`?"),
    "no such class": (["new.yaml", "--env", "tests.user_code:Coridor"], "did you mean Corridor?"),
    "no environment": (["new.yaml", "--env", "tests.user_code:leave"], "--env: tests.user_code:leave"),
    "nothing that suits": (["new.yaml", "--env", f"{__name__}:Switches"], "MultiBinary(3)"),
    "no environment named": (["new.yaml"], "--env"),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_input(what: str, capsys: pytest.CaptureFixture[str]) -> None:
    """One clear error, and no file is written, nor changed."""
    Path("there.yaml").write_text("name: mine")
    words, expected = BAD[what]
    code, error = call(capsys, "init", *words)
    assert code == 2
    assert expected in error
    assert "Traceback" not in error
    assert [path.read_text() for path in Path().iterdir()] == ["name: mine"]
