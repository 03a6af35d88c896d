"""Files are seen whole or not at all, wherever they lie; faults are told apart, and told without secrets."""

from __future__ import annotations

import errno
import pickle
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from cluster.retry import RetryPolicy
from jobs.results.places import has_credentials, joined, redacted
from jobs.results.storage import Folder
from jobs.results.storage_faults import StorageAwayError, StorageError, is_transient, storage_message


@pytest.fixture(params=["path", "file URI", "S3"])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Folder:
    """An empty folder of each kind."""
    if request.param == "S3":
        return Folder(request.getfixturevalue("s3").fresh())
    return Folder(f"file://{tmp_path}/a" if request.param == "file URI" else str(tmp_path / "a"))


def test_write_and_read(folder: Folder) -> None:
    """What is written is read, in folders that are made as needed."""
    folder.write("b/arm=A B/c.bin", b"content")
    assert folder.read("b/arm=A B/c.bin") == b"content"
    assert folder.names() == ["b/arm=A B/c.bin"]
    assert folder.names("b") == ["arm=A B/c.bin"]
    assert folder.names("nowhere") == []
    assert folder.exists("b")
    assert not folder.exists("nowhere")


def test_overwrite(folder: Folder) -> None:
    """A second write takes the place of the first."""
    folder.write("file", b"first and long")
    folder.write("file", b"second")
    assert folder.read("file") == b"second"
    assert folder.names() == ["file"]


def test_missing_file(folder: Folder) -> None:
    """A file that is not there is told from a storage that does not work."""
    with pytest.raises(FileNotFoundError):
        folder.read("nothing")


def test_failed_write_leaves_the_old_file(folder: Folder) -> None:
    """A write that fails half-way leaves what was there, and nothing else."""
    folder.write("file", b"old")

    def fail(path: str) -> None:
        with folder.filesystem.open_output_stream(path) as stream:
            stream.write(b"half")
            message = "the disk is full"
            raise OSError(message)

    with pytest.raises(OSError, match="the disk is full"):
        folder.write_with("file", fail)
    assert folder.names() == ["file"]
    assert folder.temporary_names() == []
    assert folder.read("file") == b"old"


def test_interrupted_write_leaves_nothing(folder: Folder) -> None:
    """Neither does one that is interrupted, or breaks off with an error that is not the storage's."""
    for error in (KeyboardInterrupt, ValueError):

        def fail(path: str, error: type[BaseException] = error) -> None:
            with folder.filesystem.open_output_stream(path) as stream:
                stream.write(b"half")
                raise error

        with pytest.raises(error):
            folder.write_with("file", fail)
    assert folder.names() == folder.temporary_names() == []


def test_files_of_a_dead_process_are_none(folder: Folder) -> None:
    """What a process that was killed between writing and moving has left is not among the names."""
    left = "parts/arm=A/.0.parquet.12345678.tmp"
    folder.write("parts/arm=A/0.parquet", b"whole")
    folder.write("parts/arm=A/.hidden", b"whole")
    with folder.filesystem.open_output_stream(folder.path(left)) as stream:
        stream.write(b"half")
    assert folder.names() == ["parts/arm=A/.hidden", "parts/arm=A/0.parquet"]
    assert folder.names("parts/arm=A") == [".hidden", "0.parquet"]
    assert folder.temporary_names() == [left]


def test_delete(folder: Folder) -> None:
    """Deleting what is not there is no error."""
    folder.write("a/file", b"1")
    folder.write("a/b/file", b"1")
    folder.delete("a/file")
    folder.delete("a/file")
    assert folder.names() == ["a/b/file"]
    folder.delete_folder("a")
    folder.delete_folder("a")
    assert not folder.exists("a")


def test_sub(folder: Folder) -> None:
    """A folder within is the same place by another name."""
    folder.sub("x y").sub("z").write("file", b"1")
    assert folder.names() == ["x y/z/file"]
    assert Folder(folder.sub("x y").location()).names() == ["z/file"]


def test_travels(folder: Folder) -> None:
    """A folder can be sent to another process."""
    pickle.loads(pickle.dumps(folder)).write("x", b"y")
    assert folder.read("x") == b"y"


def test_parquet(folder: Folder) -> None:
    """Tables are written through the file system, and read back."""
    table = pa.table({"x": [1, 2, 3]})
    folder.write_with("t.parquet", lambda path: pq.write_table(table, path, filesystem=folder.filesystem))
    assert folder.read_with("t.parquet", lambda file: pq.ParquetFile(file).read()).equals(table)


def test_path_and_uri_are_the_same_place(tmp_path: Path) -> None:
    """A path and its URI are the same place."""
    Folder(str(tmp_path / "a")).write("x", b"y")
    assert Folder(f"file://{tmp_path}/a").read("x") == b"y"
    assert Folder("file:///").exists(str(tmp_path / "a" / "x").lstrip("/"))
    assert Folder("/").exists(str(tmp_path / "a" / "x").lstrip("/"))


QUERY = "endpoint_override=127.0.0.1:5555&scheme=http"
JOINED = {
    "path": ("results", "results/n"),
    "path with a slash at its end": ("results/", "results/n"),
    "path with a question mark": ("what?", "what?/n"),
    "the root of all paths": ("/", "/n"),
    "URI": ("s3://bucket/results", "s3://bucket/results/n"),
    "URI with a query": (f"s3://bucket/results?{QUERY}", f"s3://bucket/results/n?{QUERY}"),
    "URI with a slash at its end": (f"s3://bucket/results/?{QUERY}", f"s3://bucket/results/n?{QUERY}"),
    "bucket alone": (f"s3://bucket?{QUERY}", f"s3://bucket/n?{QUERY}"),
}


@pytest.mark.parametrize("kind", JOINED)
def test_joined(kind: str) -> None:
    """A name goes before the query of a URI."""
    root, expected = JOINED[kind]
    assert joined(root, "n") == expected
    assert joined(root, "") == root


# Made up, in the form that they have.
KEY, SECRET = "AKIAEXAMPLE", "abc/def+ghiEXAMPLEKEY"
ESCAPED = SECRET.replace("/", "%2F").replace("+", "%2B")
REDACTED = {
    f"s3://{KEY}:{ESCAPED}@bucket/r": "s3://***@bucket/r",
    f"s3://{KEY}:{ESCAPED}@bucket/r?{QUERY}": f"s3://***@bucket/r?{QUERY}",
    f"s3://{KEY}:{ESCAPED}@bucket/a@b": "s3://***@bucket/a@b",
    f"s3://{KEY}:{SECRET}@bucket/r": "s3://***@bucket/r",
    f"nosuch://{KEY}:{SECRET}@bucket/r": "nosuch://***@bucket/r",
    f"abfs://box@account.dfs.core.windows.net/r?sas_token={SECRET}": (
        "abfs://box@account.dfs.core.windows.net/r?sas_token=***"
    ),
    f"s3://bucket/r?secret_key={SECRET}&scheme=http": "s3://bucket/r?secret_key=***&scheme=http",
}
WITHOUT = (
    "results", "/data/a:b@c", "file:///data/a:b@c", f"s3://bucket/r?{QUERY}", "s3://bucket/a:b@c", "gs://anonymous@box/r",
    "abfs://box@account.dfs.core.windows.net/r", "hdfs://name:8020/user@home",
)  # fmt: skip


@pytest.mark.parametrize("uri", REDACTED)
def test_redacted(uri: str) -> None:
    """Passwords and tokens are left out, also of a URI that is none for a slash in its password."""
    assert has_credentials(uri)
    assert redacted(uri) == REDACTED[uri]
    assert redacted(redacted(uri)) == redacted(uri)
    assert not any(secret in redacted(uri) for secret in (SECRET, ESCAPED))


@pytest.mark.parametrize("uri", WITHOUT)
def test_nothing_to_redact(uri: str) -> None:
    """What looks like credentials in a path, a port or the name of a container is shown."""
    assert not has_credentials(uri)
    assert redacted(uri) == uri


@pytest.mark.parametrize("uri", REDACTED)
def test_bad_uri_without_secrets(uri: str) -> None:
    """No error about a URI shows its secrets, neither in the message nor in what led to it."""
    with pytest.raises((ValueError, OSError)) as caught:
        Folder(f"{uri}{'&' if '?' in uri else '?'}nosuch=1")
    assert caught.value.__suppress_context__
    told = (str(caught.value), repr(caught.value), str(caught.value.__cause__))
    assert not any(secret in text for secret in (SECRET, ESCAPED) for text in told)


def aws(error: str, status: str = "") -> OSError:
    """As pyarrow reports it."""
    return OSError(
        f"When listing objects under key 'x/' in bucket 'b': AWS Error {error}{status} during X operation: y"
    )


TRANSIENT = {
    "no answer from a mount": (OSError(errno.EIO, ""), True),
    "stale handle": (OSError(errno.ESTALE, ""), True),
    "timed out": (TimeoutError(errno.ETIMEDOUT, ""), True),
    "reset": (ConnectionResetError(errno.ECONNRESET, ""), True),
    "refused": (ConnectionRefusedError(errno.ECONNREFUSED, ""), True),
    "no space": (OSError(errno.ENOSPC, ""), False),
    "quota": (OSError(errno.EDQUOT, ""), False),
    "too large": (OSError(errno.EFBIG, ""), False),
    "read-only": (OSError(errno.EROFS, ""), False),
    "no access": (PermissionError(errno.EACCES, ""), False),
    "no permission": (PermissionError(errno.EPERM, ""), False),
    "a file on the way": (NotADirectoryError(errno.ENOTDIR, ""), False),
    "not there": (FileNotFoundError(errno.ENOENT, ""), False),
    "unknown": (OSError("what is this"), False),
    "S3: network": (aws("NETWORK_CONNECTION"), True),
    "S3: slow down": (aws("SLOW_DOWN"), True),
    "S3: unavailable": (aws("SERVICE_UNAVAILABLE"), True),
    "S3: internal": (aws("INTERNAL_FAILURE"), True),
    "S3: timeout": (aws("REQUEST_TIMEOUT"), True),
    "S3: 503": (aws("UNKNOWN", " (HTTP status 503)"), True),
    "S3: 502": (aws("UNKNOWN", " (HTTP status 502)"), True),
    "S3: 429": (aws("UNKNOWN", " (HTTP status 429)"), True),
    "S3: 507": (aws("UNKNOWN", " (HTTP status 507)"), False),
    "S3: 400": (aws("UNKNOWN", " (HTTP status 400)"), False),
    "S3: denied": (aws("ACCESS_DENIED"), False),
    "S3: no bucket": (aws("NO_SUCH_BUCKET"), False),
    "S3: bad signature": (aws("SIGNATURE_DOES_NOT_MATCH"), False),
    "S3: bad certificate": (OSError("AWS Error NETWORK_CONNECTION during X operation: curlCode: 60, SSL"), False),
}


@pytest.mark.parametrize("kind", TRANSIENT)
def test_is_transient(kind: str) -> None:
    """Only what may pass by itself is tried again."""
    error, expected = TRANSIENT[kind]
    assert is_transient(error) is expected


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (OSError(errno.ENOSPC, "x"), "found 'No space left on device' while writing: free space, or choose another"),
        (OSError(errno.EROFS, "x"), "found 'Read-only file system' while writing: see that this user has the right"),
        (aws("NO_SUCH_BUCKET"), "make the bucket, or choose another --results"),
        (aws("ACCESS_DENIED"), "see that this user has the right to, or choose another --results"),
        (aws("SLOW_DOWN"), "see that the storage can be reached from here"),
    ],
)
def test_message(error: OSError, expected: str) -> None:
    """A message says where, what was found and what to do; that results are kept where something was to be written."""
    message = storage_message("s3://b/x", "writing", error)
    assert message.startswith("s3://b/x: found '")
    assert expected in message
    assert message.endswith("; finished work is stored, and the same command resumes from there")
    assert "finished" not in storage_message("s3://b/x", "reading", error)


def test_storage_error_travels() -> None:
    """However often a storage error goes from process to process, it stays the same."""
    error = StorageError(storage_message("here", "writing", OSError(errno.ENOSPC, "")))
    for _ in range(3):
        error = pickle.loads(pickle.dumps(error))
    assert type(error) is StorageError
    assert str(error).count("free space") == 1


class Faulty:
    """Fails so many times before it writes."""

    def __init__(self, folder: Folder, *errors: OSError) -> None:
        self._folder, self._errors = folder, list(errors)

    def write(self, path: str) -> None:
        if self._errors:
            raise self._errors.pop(0)
        with self._folder.filesystem.open_output_stream(path) as stream:
            stream.write(b"content")


def test_transient_faults_are_tried_again(tmp_path: Path) -> None:
    """Faults that may pass are waited out, longer each time."""
    waits: list[float] = []
    folder = Folder(str(tmp_path), RetryPolicy(4, 0.5), waits.append)
    folder.write_with("x", Faulty(folder, aws("SLOW_DOWN"), OSError(errno.EIO, ""), aws("NETWORK_CONNECTION")).write)
    assert folder.read("x") == b"content"
    assert waits == [0.5, 1.0, 2.0]


def test_transient_faults_are_given_up(tmp_path: Path) -> None:
    """A fault that does not pass is an error after a bounded number of attempts."""
    waits: list[float] = []
    folder = Folder(str(tmp_path), RetryPolicy(3, 0.5), waits.append).sub("a")
    with pytest.raises(StorageAwayError, match="see that the storage can be reached"):
        folder.write_with("x", Faulty(folder, *[aws("SLOW_DOWN")] * 3).write)
    assert waits == [0.5, 1.0]
    assert folder.names() == folder.temporary_names() == []


def test_lasting_faults_are_told_at_once(tmp_path: Path) -> None:
    """Nobody waits for a full disk, and the fault of another file that was to be read meanwhile keeps its own name."""
    waits: list[float] = []
    folder = Folder(str(tmp_path), RetryPolicy(3, 0.5), waits.append)
    with pytest.raises(StorageError, match=rf"{tmp_path}/x: found 'No space left on device' while writing: free space"):
        folder.write_with("x", Faulty(folder, OSError(errno.ENOSPC, "")).write)
    with pytest.raises(StorageError, match=r"^elsewhere"):
        folder.write_with("x", Faulty(folder, StorageError("elsewhere: AWS Error SLOW_DOWN")).write)
    assert waits == []


@pytest.mark.parametrize("place", ["/proc/results", "/etc/hostname/results"])
def test_unwritable_place(place: str) -> None:
    """A place that takes no file is an error that names it."""
    with pytest.raises(StorageError, match=f"^{place}/x: found '.*' while writing: see that the place can be used"):
        Folder(place).write("x", b"y")


def test_relative_paths_travel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A relative path is the same place in a process that works in another folder."""
    monkeypatch.chdir(tmp_path)
    sent = pickle.dumps(Folder("results"))
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    pickle.loads(sent).write("x", b"y")
    assert (tmp_path / "results" / "x").read_bytes() == b"y"
