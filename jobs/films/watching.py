"""A film of one episode of stored results."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from PIL import Image

from apel.building.registry import environment_factory
from apel.environments import World
from apel.environments.rendering import frames, rendered_world
from apel.experience.trajectory import Trajectory
from cluster.run_replay import ReplayedRun, replay_run
from jobs.experiment.yaml_source import SpecError
from jobs.films.film import Caption, captioned, check_output, write_film
from jobs.films.scenes import Scene, check_replay
from jobs.results.store import ResultStore

_MOST_FPS = 30.0


@dataclass(frozen=True)
class FilmOptions:
    """How to film.

    Attributes
    ----------
    output:
        A .gif or .mp4; None names it after the episode, in the current folder.
    fps:
        Pictures per second; None takes the environment's, at most 30.
    max_frames:
        At least 2. Of an episode with more states every n-th is shown, the first and the last one always.
    """

    output: Path | None = None
    fps: float | None = None
    max_frames: int = 500


@dataclass(frozen=True)
class Film:
    """What was filmed."""

    path: Path
    learner: str
    episode_return: float
    length: int
    every: int
    """How many steps lie between two pictures."""
    num_checked: int
    """How many recorded episodes of the run the replay was held against."""


@dataclass(frozen=True)
class Shown:
    """An episode that is to be drawn: what stands below it, who plays, and what was played."""

    label: str
    learner: str
    episode: int
    trajectory: Trajectory


def film_scene(store: ResultStore, scene: Scene, options: FilmOptions, told: Callable[[int], None]) -> Film:
    """Replay a run up to the scene, and film that; ``told`` gets the number of episodes so far.

    Raises
    ------
    SpecError
        If the environment cannot be rendered, the run cannot be played, or the file cannot be written.
    StoreError
        If the replay is not what is stored.
    """
    path = options.output or Path(f"{scene.arm.arm}-run{scene.run.index}-episode{scene.episode}.gif")
    check_output(path)
    run, environment = scene.to_play(), scene.run.environment
    with _refused():
        # First, for the replay may take long.
        world = rendered_world(environment, run.seed, environment_factory(environment.id))
        replay = replay_run(scene.arm, run, scene.episode, told)
    num_checked = check_replay(store, scene, replay)
    shown = Shown(scene.label, _learner(scene, replay), scene.episode, replay.trajectory)
    every = film_episode(world, shown, replace(options, output=path))
    length, episode_return = len(replay.trajectory), float(replay.episode_return[-1])
    return Film(path, shown.learner, episode_return, length, every, num_checked)


def film_episode(world: World, shown: Shown, options: FilmOptions) -> int:
    """Film an episode to where the options say; returns how many steps lie between two pictures.

    Raises
    ------
    SpecError
        If the file cannot be written, or the episode, played again, does not go as it did.
    """
    length = len(shown.trajectory)
    every = -(-length // (options.max_frames - 1))
    pictures = _pictures(world, shown, every)
    path = options.output or Path("episode.gif")
    write_film(path, pictures, 1 + -(-length // every), options.fps or _usual_fps(world))
    return every


def _pictures(world: World, shown: Shown, every: int) -> Iterator[Image.Image]:
    left = shown.label, f"{shown.learner} plays"
    with _refused():
        for frame in frames(world, shown.episode, shown.trajectory, every):
            right = f"episode {shown.episode:,} · step {frame.step:,}", f"return {frame.return_so_far:.6g}"
            yield captioned(frame.image, Caption(left, right))


@contextmanager
def _refused() -> Iterator[None]:
    """What cannot be played or rendered is bad input, like a field of an experiment file."""
    try:
        yield
    except ValueError as error:
        raise SpecError(str(error)) from error


def _learner(scene: Scene, replay: ReplayedRun) -> str:
    return scene.arm.learner_names[int(replay.learner[-1])]


def _usual_fps(world: World) -> float:
    return min(float(world.environment.metadata.get("render_fps") or _MOST_FPS), _MOST_FPS)
