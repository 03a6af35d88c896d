"""Films of stored episodes: the very ones that were stored, drawn, captioned and written; and what is refused."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from cluster.run_replay import replay_run
from cluster.shard import Execution
from jobs.experiment.yaml_source import SpecError
from jobs.films.film import Caption, captioned, write_film
from jobs.films.scenes import Scene, Wish, check_replay, find_scene
from jobs.results.store import ResultStore, StoreError
from tests.command_line import call
from tests.experiments import SMALL
from tests.same_rows import episode_rows, play, run_rows

CART = """
name: small-cart
runs: 1
episodes: 15
environment: {id: apel/CartPole-v0}
learners:
  Q:
    type: q_learning
    representation: {bins: [{low: -1, high: 1, count: 1}, {low: -1, high: 1, count: 1},
                            {low: -0.2, high: 0.2, count: 4}, {low: -2, high: 2, count: 3}]}
arms:
  alone: {learners: [Q]}
  both: {learners: {Q: 2}, selector: {type: apel, decay: 0.05}}
record: all
"""
SWEPT = """
name: lake
runs: 1
episodes: 5
environment: {id: FrozenLake-v1}
learners: {Q: {type: q_learning}}
arms: {Q: {learners: [Q]}}
sweep: {learners.Q.learning_rate: [0.1, 0.2]}
"""


def played(folder: Path, text: str) -> Path:
    """The results of an experiment, played in shards of several runs and in short streaks."""
    spec = folder / "spec.yaml"
    spec.write_text(text)
    return play(spec, folder / "results", placement="local", shard_size=4, execution=Execution(streak_episodes=7))


@pytest.fixture(scope="module")
def maze(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six runs in a small maze, of a learner alone and of two ensembles, with every episode recorded."""
    return played(tmp_path_factory.mktemp("maze"), SMALL)


@pytest.fixture(scope="module")
def cart(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fifteen episodes on the cart pole."""
    return played(tmp_path_factory.mktemp("cart"), CART)


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without Ray, and in a folder of its own."""
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.chdir(tmp_path)


def scene_of(folder: Path, wish: Wish) -> Scene:
    """What is found for a wish."""
    return find_scene(ResultStore.at(str(folder)), wish)


def durations(path: Path) -> Iterator[int]:
    """How long each picture of a GIF stays, in ms."""
    with Image.open(path) as gif:
        for position in range(gif.n_frames):
            gif.seek(position)
            yield gif.info["duration"]


def pictures(path: Path) -> list[np.ndarray]:
    """All pictures of a GIF."""
    with Image.open(path) as gif:
        return [np.array(gif.convert("RGB")) for position in range(gif.n_frames) if gif.seek(position) is None]


@pytest.mark.parametrize("arm", ["Q_full", "APEL", "SSBAS"])
def test_a_replay_is_the_stored_run(maze: Path, arm: str) -> None:
    """Up to the wanted episode each has the stored learner, return and length, also in the middle of a run."""
    rows = episode_rows(maze)
    rows = rows[(rows["arm"] == arm) & (rows["run_index"] == 4)]
    for episode in (0, 23, -1):
        scene = scene_of(maze, Wish(arm, run=4, episode=episode))
        told: list[int] = []
        replay = replay_run(scene.arm, scene.run, scene.episode, told.append)
        stored = rows[rows["episode"] <= scene.episode]
        assert replay.learner.tolist() == stored["selected"].tolist()
        assert replay.length.tolist() == stored["length"].tolist()
        assert replay.episode_return.tolist() == stored["return"].tolist()
        assert len(replay.trajectory) == replay.length[-1]
        assert replay.trajectory.undiscounted_return == replay.episode_return[-1]
        assert check_replay(ResultStore.at(str(maze)), scene, replay) == scene.episode + 1
        assert told == sorted(told)
        assert told[-1] == scene.episode + 1


def test_by_default_the_last_episode_of_the_first_ensemble(maze: Path) -> None:
    """Its first run, first sweep point and last episode."""
    scene = scene_of(maze, Wish())
    runs = run_rows(maze)
    stored = runs[(runs["arm"] == "APEL") & (runs["run_index"] == 0)].iloc[0]
    assert (scene.arm.arm, scene.arm.sweep, scene.run.index) == ("APEL", "", 0)
    assert (scene.run.seed, scene.episode) == (stored["seed"], stored["episodes"] - 1)
    assert scene_of(maze, Wish(episode=-2)).episode == scene.episode - 1


@pytest.mark.parametrize("arm", ["APEL", "Q_full"])
def test_film_of_a_maze(maze: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arm: str) -> None:
    """A GIF in the current folder with one picture per state, that begins at the start and ends elsewhere; results stay
    untouched.
    """
    before = {path: path.read_bytes() for path in maze.rglob("*") if path.is_file()}
    assert call_out(capsys, "watch", str(maze), "--arm", arm, "--run", "2", "--episode", "70", "--fps", "20") == 0
    rows = episode_rows(maze)
    row = rows[(rows["arm"] == arm) & (rows["run_index"] == 2) & (rows["episode"] == 70)].iloc[0]
    path = tmp_path / f"{arm}-run2-episode70.gif"
    found = pictures(path)
    assert len(found) == row["length"] + 1
    assert not np.array_equal(found[0], found[-1])
    assert found[0].shape == found[-1].shape
    assert found[0].shape[1] >= 240
    *times, last = durations(path)
    assert set(times) == {50}
    assert last == 1500
    assert {path: path.read_bytes() for path in maze.rglob("*") if path.is_file()} == before


def call_out(capsys: pytest.CaptureFixture[str], *arguments: str) -> int:
    """Exit code of a command that says nothing on standard error."""
    code, error = call(capsys, *arguments)
    assert error == ""
    return code


def test_watch_says_what_was_filmed(maze: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The path, who played, return and length."""
    from jobs.cli import result_commands

    said: list[str] = []
    monkeypatch.setattr(result_commands.OUT, "print", lambda text, **_: said.append(str(text)))
    result_commands.watch(str(maze), episode=0, output=Path("first.gif"), max_frames=10)
    row = episode_rows(maze).query("arm == 'APEL' and run_index == 0 and episode == 0").iloc[0]
    learner = ("Q_full", "Q_red")[row["selected"]]
    assert said[:2] == [
        "first.gif",
        f"APEL · run 0 · episode 0: {learner} played, return {row['return']:g}, {row['length']} steps",
    ]
    assert said[2].startswith("every ")
    assert 2 <= len(pictures(Path("first.gif"))) <= 10


@pytest.mark.parametrize(("arm", "learner"), [("both", "Q#"), ("alone", "Q")])
def test_film_of_a_cart_pole(cart: Path, capsys: pytest.CaptureFixture[str], arm: str, learner: str) -> None:
    """Of an environment that is not finite, with a learner that sees it in bins."""
    assert call_out(capsys, "watch", str(cart), "--arm", arm, "-o", "cart.gif") == 0
    row = episode_rows(cart).query(f"arm == '{arm}' and episode == 14").iloc[0]
    found = pictures(Path("cart.gif"))
    assert len(found) == row["length"] + 1
    assert not np.array_equal(found[0][:210], found[-1][:210])


def test_film_as_mp4(cart: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By ffmpeg, where there is one."""
    pytest.importorskip("imageio_ffmpeg")
    assert call_out(capsys, "watch", str(cart), "--episode", "3", "-o", "cart.mp4") == 0
    assert b"ftyp" in Path("cart.mp4").read_bytes()[:12]
    assert [path.name for path in Path.cwd().glob("*.mp4")] == ["cart.mp4"]


def test_mp4_without_ffmpeg(cart: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """It says what would help, before anything is played."""
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    monkeypatch.setattr(shutil, "which", lambda _: None)
    code, error = call(capsys, "watch", str(cart), "-o", "cart.mp4")
    assert code == 2
    assert "found no ffmpeg" in error


BAD = {
    "arm": (("--arm", "UCB"), "--arm: found 'UCB', expected one of 'Q_full', 'APEL', 'SSBAS'"),
    "sweep": (("--sweep", "x=1"), "--sweep: found 'x=1', expected one of ''"),
    "run": (("--run", "6"), "--run: found 6, expected a finished run of APEL: there are 6, from 0 to 5"),
    "episode": (("--episode", "80"), "--episode: found 80, expected -"),
    "episode from the end": (("--episode", "-81"), "--episode: found -81, expected -"),
    "suffix": (("-o", "film.avi"), "--output: found 'film.avi', expected a name that ends in .gif or .mp4"),
    "folder": (("-o", "no/film.gif"), "expected a folder that exists: there is no 'no'"),
    "no pictures": (("--max-frames", "1"), "--max-frames"),
    "no time": (("--fps", "0"), "--fps"),
}


@pytest.mark.parametrize(("arguments", "message"), BAD.values(), ids=BAD)
def test_bad_input(maze: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], message: str) -> None:
    """One message, exit code 2, and no file."""
    code, error = call(capsys, "watch", str(maze), *arguments)
    assert code == 2
    assert message in error
    assert not list(Path.cwd().iterdir())


def test_no_results(maze: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A folder that holds none, or those of a job that is not done, is refused; so is a folder as output."""
    unfinished = shutil.copytree(maze, tmp_path / "unfinished")
    (unfinished / "runs.parquet").unlink()
    for folder in (tmp_path / "nowhere", unfinished):
        assert call(capsys, "watch", str(folder)) == (
            2,
            f"error: {folder}: found no runs.parquet, expected the folder of a finished experiment\n",
        )
    (tmp_path / "folder.gif").mkdir()
    assert "found the folder" in call(capsys, "watch", str(maze), "-o", "folder.gif")[1]


def test_run_that_failed(maze: Path, tmp_path: Path) -> None:
    """A run without a row cannot be watched."""
    copy = shutil.copytree(maze, tmp_path / "copy")
    runs = pd.read_parquet(copy / "runs.parquet")
    runs[(runs["arm"] != "APEL") | (runs["run_index"] != 0)].to_parquet(copy / "runs.parquet")
    with pytest.raises(SpecError, match="--run: found 0, expected a finished run of APEL: there are 5, from 1 to 5"):
        scene_of(copy, Wish())


def test_another_run_than_the_stored_one_is_refused(maze: Path, tmp_path: Path) -> None:
    """Whether a recorded episode differs or the whole run's steps, it says where, and what was found and expected."""
    copy = shutil.copytree(maze, tmp_path / "copy")
    store = ResultStore.at(str(copy))
    scene = find_scene(store, Wish(run=1))
    replay = replay_run(scene.arm, scene.run, scene.episode)
    for path in (copy / "episodes" / "arm=APEL").iterdir():
        rows = pd.read_parquet(path, partitioning=None)
        rows.loc[(rows["run_index"] == 1) & (rows["episode"] == 17), "length"] += 1
        rows.to_parquet(path)
    with pytest.raises(StoreError, match=r"episode 17 of APEL · run 1, played again here: found selected ., return"):
        check_replay(store, scene, replay)
    shutil.rmtree(copy / "episodes")
    assert check_replay(store, scene, replay) == 0
    runs = pd.read_parquet(copy / "runs.parquet")
    runs["steps"] += 1
    runs.to_parquet(copy / "runs.parquet")
    with pytest.raises(StoreError, match=r"APEL · run 1, played again here: found \d+ steps, expected what is stored"):
        check_replay(store, find_scene(store, Wish(run=1)), replay)


def test_what_cannot_be_rendered(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Gymnasium's finite environments are played from tables, which nobody draws; a sweep point goes by its label."""
    lake = played(tmp_path, SWEPT)
    scene = scene_of(lake, Wish(sweep="learners.Q.learning_rate=0.2"))
    assert scene.arm.sweep == "learners.Q.learning_rate=0.2"
    assert scene.run.learners[0].options["learning_rate"] == 0.2
    code, error = call(capsys, "watch", str(lake))
    assert code == 2
    assert error.startswith("error: FrozenLake-v1 cannot be rendered: ")


def test_caption_has_room_below_a_small_picture() -> None:
    """Pictures are enlarged by whole factors, and texts are cut where they have no room."""
    image = np.zeros((10, 11, 3), dtype=np.uint8)
    image[3, 4] = (255, 0, 0)
    whole = np.array(captioned(image, Caption(("a" * 200, "b"), ("right", "1"))))
    assert whole.shape[1] == 22 * 11
    assert whole.shape[0] % 2 == 0
    assert (whole[3 * 22 : 4 * 22, 4 * 22 : 5 * 22] == (255, 0, 0)).all()
    assert (whole[220:] != whole[-1, -1]).any()


def test_nothing_half_written_is_left(tmp_path: Path) -> None:
    """An environment that fails on the way costs the film, not the file of an earlier one."""
    path = tmp_path / "film.gif"
    path.write_bytes(b"earlier")

    def broken() -> Iterator[Image.Image]:
        yield Image.new("RGB", (4, 4))
        message = "the motor is stuck"
        raise OSError(message)

    with pytest.raises(OSError, match="the motor is stuck"):
        write_film(path, broken(), 3, 10)
    assert [(file.name, file.read_bytes()) for file in tmp_path.iterdir()] == [("film.gif", b"earlier")]
