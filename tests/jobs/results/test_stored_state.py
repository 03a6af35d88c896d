"""Stored state that is not what it should be: it is played again, or said in one error; never taken for a result."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cluster.events import ShardEvent, ShardReplayed
from cluster.shard import Execution, Shard
from jobs.analysis.pages.report import write_report
from jobs.analysis.stored_summary import stored_summary
from jobs.experiment.spec import Experiment
from jobs.experiment.spec_files import load_experiment
from jobs.experiment.yaml_source import SpecError
from jobs.progress.observers import Observer
from jobs.progress.progress import JobProgress
from jobs.reproduction.claims.stored_results import identified
from jobs.results.episodes import read_episodes
from jobs.results.store import ResultStore, StoreError
from jobs.runner import Outcome, Settings, run_experiment
from tests.command_line import call
from tests.conftest import SMALL
from tests.same_rows import assert_same, episode_rows, folder_of, run_rows

OFTEN = Execution(
    streak_episodes=5, checkpoint_seconds=0.0, checkpoint_share=1.0, checkpoint_episodes=1, progress_seconds=0.0
)


class Listener(Observer):
    """Keeps what is said; breaks the job off at its n-th event."""

    def __init__(self, num_events: int = -1) -> None:
        self.said: list[str] = []
        self._left = num_events

    def noted(self, message: str) -> None:
        self.said.append(message)

    def progressed(self, shard: Shard, event: ShardEvent, progress: JobProgress) -> None:
        if isinstance(event, ShardReplayed):
            self.said.append(f"{shard.label}: {event.reason}")
        self._left -= 1
        if not self._left:
            raise KeyboardInterrupt


@pytest.fixture(scope="module")
def experiment(tmp_path_factory: pytest.TempPathFactory) -> Experiment:
    """Three arms, of which two are played, six runs, 30 episodes."""
    path = tmp_path_factory.mktemp("spec") / "small.yaml"
    path.write_text(SMALL.replace("episodes: 80", "episodes: 30"))
    return load_experiment(str(path), [])


def run(experiment: Experiment, results: Path, observer: Observer | None = None, **options: object) -> Outcome:
    """Run in this process, three runs in a shard."""
    options = {"shard_size": 3, "arms": ("Q_full", "APEL"), **options}
    wanted = Settings(results=str(results), placement="local", **options)  # type: ignore[arg-type]
    return run_experiment(experiment, wanted, observer or Listener())


@pytest.fixture(scope="module")
def whole(experiment: Experiment, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the undisturbed experiment."""
    return folder_of(run(experiment, tmp_path_factory.mktemp("whole")))


@pytest.fixture(scope="module")
def broken_off(experiment: Experiment, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results root of a job that was broken off with a shard done and another at a checkpoint."""
    root = tmp_path_factory.mktemp("broken-off")
    with pytest.raises(KeyboardInterrupt):
        run(experiment, root, Listener(14), execution=OFTEN)
    return root


def copy_of(folder: Path, root: Path) -> Path:
    """The same results below another, empty root."""
    shutil.rmtree(root, ignore_errors=True)
    target = root / folder.parent.name / folder.name
    shutil.copytree(folder, target)
    return target


def the_only(root: Path) -> Path:
    """The results of the experiment below a root."""
    (spec,) = root.rglob("spec.yaml")
    return spec.parent


DAMAGES: dict[str, Callable[[bytes, bytes, int], bytes]] = {
    "a flipped bit": lambda own, _, at: (
        own[: at // 8 % len(own)] + bytes([own[at // 8 % len(own)] ^ (1 << at % 8)]) + own[at // 8 % len(own) + 1 :]
    ),
    "cut off": lambda own, _, at: own[: at % len(own)],
    "another's": lambda _, other, __: other,
    "lengthened": lambda own, other, at: own + other[: 1 + at % 20],
}


def files_of(folder: Path) -> list[Path]:
    """Those that are read back."""
    return sorted(path for path in folder.rglob("*") if path.is_file() and path.suffix != ".html")


def damaged(data: st.DataObject, folder: Path) -> str:
    """Damage one of the files; returns which, and how."""
    files = files_of(folder)
    path = data.draw(st.sampled_from(files), label="file")
    other = data.draw(st.sampled_from([one for one in files if one != path]), label="other")
    kind = data.draw(st.sampled_from(sorted(DAMAGES)), label="damage")
    path.write_bytes(DAMAGES[kind](path.read_bytes(), other.read_bytes(), data.draw(st.integers(0, 2**20))))
    return f"{path.relative_to(folder)}: {kind}"


EXAMPLES = settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))


@EXAMPLES
@given(data=st.data())
def test_whatever_is_damaged_the_rows_are_the_same(
    experiment: Experiment, whole: Path, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """Flip a bit of a file, cut it off or swap it with another one: the next `apel run` comes to the same rows."""
    folder = copy_of(whole, tmp_path_factory.getbasetemp() / "damaged")
    damaged(data, folder)
    run(experiment, folder.parents[1])
    assert_same(folder, whole)
    ResultStore.at(str(folder)).summary()


@EXAMPLES
@given(data=st.data())
def test_whatever_is_damaged_a_job_goes_on(
    experiment: Experiment, whole: Path, broken_off: Path, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """The same for a job that was broken off: checkpoints, its shards' rows, episodes that were put aside."""
    folder = copy_of(the_only(broken_off), tmp_path_factory.getbasetemp() / "resumed")
    damaged(data, folder)
    run(experiment, folder.parents[1], execution=OFTEN)
    assert_same(folder, whole)


@settings(EXAMPLES, max_examples=40)
@given(data=st.data())
def test_reading_damaged_results(whole: Path, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    """Whatever is damaged, reading gives the right rows, or one clear error that names the place."""
    folder = copy_of(whole, tmp_path_factory.getbasetemp() / "read")
    what = damaged(data, folder)
    store = ResultStore.at(str(folder))
    right = ResultStore.at(str(whole))
    for read in (
        lambda one: one.runs(),
        stored_summary,
        lambda one: one.experiment().identity,
        lambda one: read_episodes(one.folder, "APEL", ["return", "length", "probability"], ""),
        lambda one: [(found.name, found.identity) for found in identified([one])],
        lambda one: bool(write_report(one)),
    ):
        found, error = None, None
        try:
            found = read(store)
        except (StoreError, SpecError) as caught:
            error = caught
        assert str(folder) in str(error) if error else found == read(right) or what.startswith("spec.yaml"), what


def test_stored_parts_are_put_aside_and_damaged(
    experiment: Experiment, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Episodes that did not fit into memory, and were damaged before their shard was over: it is played again."""
    monkeypatch.setattr("cluster.coordinator._MAX_ROWS_IN_MEMORY", 10)
    with pytest.raises(KeyboardInterrupt):
        run(experiment, tmp_path, Listener(5), execution=OFTEN)
    spilled = next(tmp_path.rglob("spilled/*/*.parquet"))
    content = bytearray(spilled.read_bytes())
    content[len(content) // 3] ^= 1
    spilled.write_bytes(content)
    listener = Listener()
    assert_same(folder_of(run(experiment, tmp_path, listener, execution=OFTEN)), whole)
    assert sum("put aside do not fit" in line for line in listener.said) == 1


def test_a_part_under_another_name(experiment: Experiment, whole: Path, tmp_path: Path) -> None:
    """A copy of a part does not count its runs twice, with a checksum or, as of older versions, without one."""
    folder = copy_of(whole, tmp_path)
    for name in ("copy.parquet", "000100-000102.parquet"):
        shutil.copy(folder / "parts/arm=APEL/000000-000002.parquet", folder / "parts/arm=APEL" / name)
        shutil.copy(folder / "episodes/arm=APEL/000000-000002.parquet", folder / "episodes/arm=APEL" / name)
    unlabelled(folder / "parts/arm=APEL/000100-000102.parquet")
    listener = Listener()
    run(experiment, tmp_path, listener)
    assert_same(folder, whole)
    assert len(listener.said) == 2
    assert any("found the file 'arm=APEL/000000-000002.parquet'" in line for line in listener.said)
    assert any("found runs that arm=APEL/000000-000002.parquet holds too" in line for line in listener.said)
    assert len(list(folder.rglob("damaged/parts/*/*"))) == 2


def unlabelled(path: Path, **changed: object) -> None:
    """A file as older versions wrote it, with some columns changed."""
    frame = pd.read_parquet(path, dtype_backend="pyarrow").assign(**changed)
    pq.write_table(pa.Table.from_pandas(frame, preserve_index=False).replace_schema_metadata(None), path)


def test_a_word_on_the_terminal(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is put away is said, with --quiet too; the next time all is well."""
    command = ["run", str(small), "--placement", "local", "--results", str(tmp_path), "--arms", "APEL", "--quiet"]
    assert call(capsys, *command) == (0, "")
    part = next(tmp_path.rglob("parts/*/*.parquet"))
    (the_only(tmp_path) / "manifest.json").write_text("{")
    part.write_bytes(part.read_bytes()[:-1])
    code, error = call(capsys, *command)
    assert code == 0
    assert f"parts/arm=APEL/{part.name}: found an unreadable file" in error
    assert "put into damaged/; runs that are missing are played again" in error
    assert "manifest.json: found no valid JSON" in error
    assert call(capsys, *command) == (0, "")


FOREIGN: dict[str, dict[str, object]] = {
    "run_index": {"run_index": [0, 1, 999]},
    "seed": {"seed": [1, 2, 3]},
    "negative": {"run_index": [-1, 0, 1]},
    "arm": {"arm": "Q_full"},
    "sweep": {"sweep": "x=1"},
    "type": {"steps": ["1", "2", "3"]},
    "missing": {"run_index": None},
}


@pytest.mark.parametrize("kind", FOREIGN)
@pytest.mark.parametrize("is_labelled", [True, False])
def test_rows_outside_of_the_plan(
    experiment: Experiment, whole: Path, tmp_path: Path, kind: str, is_labelled: bool
) -> None:
    """Rows of runs that the experiment does not have are put away, and the runs played again."""
    folder = copy_of(whole, tmp_path)
    path = folder / "parts/arm=APEL/000000-000002.parquet"
    label = pq.read_schema(path).metadata
    unlabelled(path, **FOREIGN[kind])
    if is_labelled:
        pq.write_table(pq.read_table(path).replace_schema_metadata(label), path)
    listener = Listener()
    run(experiment, tmp_path, listener)
    assert_same(folder, whole)
    assert ["parts/arm=APEL/000000-000002.parquet" in line for line in listener.said] == [True]


def test_two_accounts_of_one_run(experiment: Experiment, whole: Path, tmp_path: Path) -> None:
    """Where two files say different things of the same runs, neither is believed."""
    folder = copy_of(whole, tmp_path)
    first, second = (folder / f"parts/arm=APEL/{name}.parquet" for name in ("000000-000002", "000000-000003"))
    shutil.copy(first, second)
    unlabelled(first, steps=[1, 2, 3])
    unlabelled(second)
    listener = Listener()
    run(experiment, tmp_path, listener)
    assert_same(folder, whole)
    assert len(listener.said) == 2


def test_results_of_an_older_version(experiment: Experiment, whole: Path, tmp_path: Path) -> None:
    """Without labels and without the newer column they are taken as they are, and nothing is played."""
    folder = copy_of(whole, tmp_path)
    for path in (*folder.glob("parts/*/*"), folder / "runs.parquet", folder / "summary.parquet"):
        frame = pd.read_parquet(path, dtype_backend="pyarrow")
        frame = frame.drop(columns=[name for name in frame.columns if "last_tenth" in name])
        pq.write_table(pa.Table.from_pandas(frame, preserve_index=False).replace_schema_metadata(None), path)
    manifest = json.loads((folder / "manifest.json").read_text())
    del manifest["checksum"]
    (folder / "manifest.json").write_text(json.dumps(manifest))
    store = ResultStore.at(str(folder))
    assert stored_summary(store).num_rows == 2
    listener = Listener()
    assert run(experiment, tmp_path, listener).num_computed == 0
    assert listener.said == []
    pd.testing.assert_frame_equal(run_rows(folder), run_rows(whole).drop(columns="last_tenth_return"))
    pd.testing.assert_frame_equal(episode_rows(folder), episode_rows(whole))


def test_rows_twice_are_no_results(whole: Path, tmp_path: Path) -> None:
    """Reading refuses a table that has a run twice, or one that the experiment does not have."""
    folder = copy_of(whole, tmp_path)
    table = pq.read_table(folder / "runs.parquet").replace_schema_metadata(None)
    pq.write_table(pa.concat_tables([table, table.slice(length=1)]), folder / "runs.parquet")
    with pytest.raises(StoreError, match=r"runs\.parquet: found run 0 of '\w+' 2 times, expected it once"):
        ResultStore.at(str(folder)).runs()
    index = table["run_index"].to_pylist()
    foreign = pa.array([999, *index[1:]])
    pq.write_table(table.set_column(3, "run_index", foreign), folder / "runs.parquet")
    with pytest.raises(StoreError, match=r"runs\.parquet: found run 999 of '\w+' with the seed"):
        ResultStore.at(str(folder)).runs()


BAD_FILES: dict[str, tuple[str, bytes | None]] = {
    "no manifest's form": ("manifest.json", b"[1, 2]"),
    "an empty manifest": ("manifest.json", b""),
    "a manifest of nothing": ("manifest.json", b"{}"),
    "deep JSON": ("manifest.json", b"[" * 100_000),
    "a spec that is no UTF-8": ("spec.yaml", b"name: \xff\xfe"),
    "an empty spec": ("spec.yaml", b""),
    "an empty table": ("runs.parquet", b""),
    "a text for a table": ("summary.parquet", b"PAR1 and more PAR1"),
    "a folder for a table": ("runs.parquet", None),
    "a folder for the summary": ("summary.parquet", None),
    "a folder for the manifest": ("manifest.json", None),
    "a folder for the spec": ("spec.yaml", None),
}


@pytest.mark.parametrize("kind", BAD_FILES)
def test_commands_over_damaged_results(
    kind: str, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`apel show` and `apel claims` do without what they need not, or end with one error and exit code 2."""
    name, content = BAD_FILES[kind]
    folder = copy_of(whole, tmp_path)
    (folder / name).unlink()
    if content is None:
        (folder / name).mkdir()
    else:
        (folder / name).write_bytes(content)
    for command in ("show", "claims"):
        code, error = call(capsys, command, str(folder))
        assert "Traceback" not in error
        assert code in (0, 2)
        assert (code == 2) == error.startswith("error: ")
    code, error = call(capsys, "show", str(folder))
    assert code == (2 if name == "runs.parquet" else 0)


def test_folder_for_a_file_to_come(experiment: Experiment, tmp_path: Path) -> None:
    """What would be in the way of a shard's rows is said before anything is played."""
    place = tmp_path / experiment.name / experiment.identity / "parts/arm=APEL/000000-000002.parquet"
    place.mkdir(parents=True)
    with pytest.raises(StoreError, match=r"000000-000002\.parquet: found a folder, expected a file"):
        run(experiment, tmp_path)


PLACES = ["", "  ", "s3://", "s3:///results", "s3://?region=eu-west-1", "s3:/bucket/results", "gs://"]


@pytest.mark.parametrize("place", PLACES)
def test_no_place_for_results(place: str, small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """No results are written to the root of all files for want of a name."""
    code, error = call(capsys, "run", str(small), "--placement", "local", "--results", place)
    assert code == 2
    assert "Traceback" not in error
    assert error.startswith("error: --results: found ")
    assert "expected a folder, or a URI" in error


@contextmanager
def arms_of(experiment: Experiment, *names: str) -> Iterator[Experiment]:
    """The same with arms of other names."""
    arms = dict(zip(names, experiment.arms.values(), strict=False))
    yield experiment.model_copy(update={"arms": arms})


def test_arms_that_look_like_one_number(experiment: Experiment, tmp_path: Path) -> None:
    """Nothing that is read here guesses a type from a folder's name."""
    with arms_of(experiment, "1", "01") as other:
        folder = folder_of(run(other, tmp_path, arms=("1", "01")))
    rows = ResultStore.at(str(folder)).runs().to_pandas()
    assert sorted(rows["arm"].unique()) == ["01", "1"]
    for arm in ("1", "01"):
        episodes = read_episodes(ResultStore.at(str(folder)).folder, arm, ["run_index"], "")
        assert episodes is not None
        assert len(episodes) == rows.loc[rows["arm"] == arm, "episodes"].sum()
