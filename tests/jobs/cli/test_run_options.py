"""`run` and `submit` take the same options, and what is said to the one is what the other's job is told."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import pytest
import typer
from typer.testing import CliRunner

from cluster.shard import Execution
from jobs.cli.commands import loaded
from jobs.cli.main import main
from jobs.cli.option_groups import with_option_groups
from jobs.cli.run_options import RunOptions
from jobs.experiment.spec import Experiment
from jobs.remote.job import Job
from jobs.runner import Settings
from tests.command_line import call

OF_RUN_ALONE = {"--debug", "--cpus", "--quiet"}
"""Of the Ray that is started here, and of what is printed here; a job has a Ray already, and prints into its log."""
OF_SUBMIT_ALONE = {"--module", "--follow"}
"""What is sent along, and what is printed here of the job."""
WORDS = {
    "arms": ("--arms", "APEL,SSBAS"),
    "placement": ("--placement", "packed"),
    "shard_size": ("--shard-size", "3"),
    "fresh": ("--fresh",),
    "checkpoint_seconds": ("--checkpoint-seconds", "0.0"),
    "checkpoint_episodes": ("--checkpoint-episodes", "7"),
    "log": ("--log", "tensorboard:/shared/events", "--log", "board.lights:Lights"),
    "until": ("--until", "decided"),
    "max_runs": ("--until", "decided", "--max-runs", "5"),
    "error": ("--until", "decided", "--error", "0.1"),
}
"""Every field of `RunOptions`, at a value that is not its default; those that need another one after that."""


def options_of(command: str) -> set[str]:
    """The options that a command lists."""
    parameters = loaded(command, "run_commands" if command == "run" else "job_commands").params
    return {option for parameter in parameters for option in parameter.opts if option.startswith("--")} - {"--help"}


class _CalledError(Exception):
    """What a command was about to do is known; it is not done."""


def settings_of(words: Sequence[str]) -> tuple[Settings, list[str], int]:
    """The settings with which `apel run` would run, who would be told how it goes on, and how many runs."""
    found: list[Settings] = []
    logs: list[str] = []
    runs: list[int] = []

    def run(experiment: Experiment, settings: Settings, *__: object) -> None:
        runs.append(experiment.runs)
        found.append(settings)
        raise _CalledError

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jobs.cli.run_commands.run_experiment", run)
        patch.setattr("jobs.cli.run_commands.observer_of", lambda log, _: logs.append(log))
        patch.setattr(sys, "argv", ["apel", "run", *words])
        with pytest.raises(_CalledError):
            main()
    return found[0], logs, runs[0]


def sent_by(words: Sequence[str], small: Path) -> list[str]:
    """The words for `apel run` with which `apel submit` would submit a job."""
    sent: list[str] = []

    def submit(_: Experiment, *, address: str, options: Sequence[str], **__: object) -> Job:
        sent.extend(options)
        return Job("small-maze-1", address)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jobs.remote.job.submit", submit)
        patch.setattr(sys, "argv", ["apel", "submit", str(small), *words])
        with pytest.raises(SystemExit) as caught:
            main()
    assert not caught.value.code
    return sent


def test_same_options() -> None:
    """What `run` can be told `submit` can, and the other way round, but for what would mean nothing to it."""
    assert options_of("run") - OF_RUN_ALONE == options_of("submit") - OF_SUBMIT_ALONE
    assert options_of("run") >= OF_RUN_ALONE
    assert options_of("submit") >= OF_SUBMIT_ALONE
    assert options_of("run") >= {word for words in WORDS.values() for word in words if word.startswith("--")}


def test_all_options_are_tried_here() -> None:
    """An option that is added must be tried below."""
    assert list(WORDS) == [field.name for field in fields(RunOptions)]


@pytest.mark.parametrize("name", WORDS)
def test_each_is_passed_on(name: str, small: Path) -> None:
    """A job that is submitted with an option runs as `apel run` does with it, and not as it does without."""
    words = WORDS[name]
    sent = sent_by(words, small)
    assert tuple(sent) == words
    assert settings_of([str(small), *sent]) == settings_of([str(small), *words])
    assert settings_of([str(small), *sent]) != settings_of([str(small)])


def test_all_are_passed_on_together(small: Path) -> None:
    """By hand: what each of the options means."""
    last = {"fresh": -1, "log": -4}
    words = [word for name, option in WORDS.items() for word in option[last.get(name, -2) :]]
    sent = sent_by(words, small)
    assert sent == words
    assert settings_of([str(small), *sent]) == (
        Settings(
            arms=("APEL", "SSBAS"),
            placement="packed",
            shard_size=3,
            fresh=True,
            execution=Execution(checkpoint_seconds=0.0, checkpoint_episodes=7),
            error=0.1,
        ),
        ["tensorboard:/shared/events", "board.lights:Lights"],
        5,
    )


def test_same_experiment(small: Path) -> None:
    """What is said of the experiment itself is in the one that is sent: the job's `run` is told its file, no more."""
    words = (str(small), "--runs", "3", "--seed", "7", "--set", "episodes=9", "--set", "arms.APEL.selector.decay=0.2")
    found: list[Experiment] = []

    def take(experiment: Experiment, *_: object, **__: object) -> None:
        found.append(experiment)
        raise _CalledError

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jobs.cli.run_commands.run_experiment", take)
        patch.setattr("jobs.remote.job.submit", take)
        for command in ("run", "submit"):
            patch.setattr(sys, "argv", ["apel", command, *words])
            with pytest.raises(_CalledError):
                main()
    ran, sent = found
    assert ran == sent
    assert (sent.runs, sent.seed, sent.episodes) == (3, 7, 9)
    assert sent.arms["APEL"].selector is not None
    assert sent.arms["APEL"].selector.options == {"decay": 0.2}


def test_nothing_is_sent_of_nothing(small: Path) -> None:
    """A job that is told nothing is the same as one that is told what it would do anyway."""
    assert sent_by([], small) == sent_by(["--placement", "actors", "--checkpoint-seconds", "30"], small) == []


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--placement", "cloud"), "--placement: found 'cloud', expected actors, packed or local"),
        (("--arms", "Best"), "--arms: found 'Best', expected some of Q_full, APEL, SSBAS"),
        (
            ("--log", "tensorboard:events"),
            "--log tensorboard: found 'events', expected an absolute path on the cluster's nodes",
        ),
        (("--log", "tensorboard:s3://key:hidden@lab/e"), "--log tensorboard: found credentials in s3://***@lab/e"),
        (("--log", "mlflow:sqlite:///m.db"), "--log mlflow: found 'sqlite:///m.db', expected an absolute path"),
        (("--log", "mlflow:http://me:hidden@board"), "--log: found credentials in http://***@board, expected none"),
        (("--log", "mlfow"), "--log: found 'mlfow', expected tensorboard[:DIR], mlflow[:URI], wandb, or an import"),
    ],
)
def test_refused_before_it_is_sent(
    words: tuple[str, ...], expected: str, small: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What no job could do is refused on the user's own machine."""
    code, error = call(capsys, "submit", str(small), *words)
    assert code == 2
    assert error.startswith(f"error: {expected}")
    assert "hidden" not in error


def test_observer_is_sent_along(small: Path) -> None:
    """The module of an observer of one's own travels with the job, where it lies in this folder."""
    needed: list[str] = []

    def submit(*_: object, **given: Any) -> None:
        needed.extend(given["needed"])
        raise _CalledError

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jobs.remote.job.submit", submit)
        patch.setattr(sys, "argv", ["apel", "submit", str(small), "--log", "board.lights:Lights", "--log", "wandb"])
        with pytest.raises(_CalledError):
            main()
    assert needed == ["board"]


@dataclass(frozen=True)
class Size:
    """A group of options."""

    width: Annotated[int, typer.Argument()]
    height: int = 2


def test_groups_of_options() -> None:
    """Fields become arguments and options with their defaults, and come back as the group."""
    program, seen = typer.Typer(), []

    def draw(size: Size, colour: str = "red") -> None:
        """Draw."""
        seen.append((size, colour))

    program.command()(with_option_groups(draw))
    assert CliRunner().invoke(program, ["3"]).exit_code == 0
    assert CliRunner().invoke(program, ["4", "--height", "5", "--colour", "blue"]).exit_code == 0
    assert seen == [(Size(3, 2), "red"), (Size(4, 5), "blue")]


def test_option_in_two_groups() -> None:
    """Two options of one name would be one."""

    def draw(size: Size, height: int = 1) -> None:
        """Draw."""

    with pytest.raises(TypeError, match="found an option twice"):
        with_option_groups(draw)
