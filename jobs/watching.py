"""A film of one episode of stored results."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from apel.environments import World
from apel.environments.rendering import frames, rendered_world
from cluster.learner_host import environment_factory
from cluster.replaying import Replay, replay_run
from jobs.film import Caption, captioned, check_output, write_film
from jobs.scenes import Scene, check_replay
from jobs.store import ResultStore
from jobs.yaml_source import SpecError

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
    environment = scene.run.environment
    with _refused():
        # First, for the replay may take long.
        world = rendered_world(environment, scene.run.seed, environment_factory(environment))
        replay = replay_run(scene.arm, scene.run, scene.episode, told)
    num_checked = check_replay(store, scene, replay)
    length = len(replay.trajectory)
    every = -(-length // (options.max_frames - 1))
    pictures = _pictures(world, scene, replay, every)
    write_film(path, pictures, 1 + -(-length // every), options.fps or _usual_fps(world))
    return Film(path, _learner(scene, replay), float(replay.episode_return[-1]), length, every, num_checked)


def _pictures(world: World, scene: Scene, replay: Replay, every: int) -> Iterator[Image.Image]:
    left = scene.label, f"{_learner(scene, replay)} plays"
    with _refused():
        for frame in frames(world, scene.episode, replay.trajectory, every):
            right = f"episode {scene.episode:,} · step {frame.step:,}", f"return {frame.return_so_far:.6g}"
            yield captioned(frame.image, Caption(left, right))


@contextmanager
def _refused() -> Iterator[None]:
    """What cannot be played or rendered is bad input, like a field of an experiment file."""
    try:
        yield
    except ValueError as error:
        raise SpecError(str(error)) from error


def _learner(scene: Scene, replay: Replay) -> str:
    return scene.arm.learner_names[int(replay.learner[-1])]


def _usual_fps(world: World) -> float:
    return min(float(world.environment.metadata.get("render_fps") or _MOST_FPS), _MOST_FPS)
