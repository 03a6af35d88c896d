"""What docs/security.md says of this program, and of the Ray below it, as far as it is cheap to try."""

from __future__ import annotations

import io
import json
import pickle
import stat
import urllib.error
import urllib.request
from collections.abc import Mapping
from pathlib import Path

import grpc
import numpy as np
import pytest

from cluster.checkpoint import CheckpointError, unpack
from jobs.experiment.spec_files import load_experiment
from jobs.experiment.yaml_source import SpecError
from tests.command_line import Called, called
from tests.experiments import SMALL
from tests.ray_head import PLANTED, Head

OPEN = {"/": 200, "/api/gcs_healthz": 200, "/api/authentication_mode": 200}
CLOSED = ("/api/jobs/", "/api/v0/nodes", "/api/v0/logs", "/nodes?view=summary", "/api/cluster_status", "/api/version")


class Bomb:
    """Writes a file where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        return Path.write_text, (self.path, "gone off")


def planted(kind: str, bomb: Bomb) -> bytes:
    """A file that runs code wherever somebody unpickles it."""
    if kind == "pickle":
        return pickle.dumps(bomb)
    content = io.BytesIO()
    array = np.empty(1, dtype=object)
    array[0] = bomb
    if kind == "npz":
        np.savez(content, tree=array)
    else:
        np.save(content, array, allow_pickle=True)
    return content.getvalue()


@pytest.mark.parametrize("kind", ["pickle", "npz", "npy"])
def test_planted_checkpoint(kind: str, tmp_path: Path) -> None:
    """A pickle in place of a checkpoint is refused, and not run."""
    content = planted(kind, Bomb(tmp_path / "gone"))
    with pytest.raises(CheckpointError, match="found an unreadable state"):
        unpack(content)
    assert not (tmp_path / "gone").exists()


def test_planted_checkpoint_of_a_job(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same in the results of a job that is to go on: it begins its shard anew."""
    words = ["run", str(small), "--placement", "local", "--arms", "APEL", "--shard-size", "6", "--quiet"]
    words += ["--results", str(tmp_path / "there")]
    assert called(capsys, *words) == Called(0, "", "")
    (part,) = (tmp_path / "there").rglob("parts/*/*.parquet")
    folder = part.parents[2]
    checkpoint = folder / "checkpoints" / part.parent.name / f"{part.stem}.npz"
    part.unlink()
    checkpoint.parent.mkdir(parents=True)
    checkpoint.write_bytes(planted("pickle", Bomb(tmp_path / "gone")))
    assert called(capsys, *words).code == 0
    assert part.exists()
    assert not checkpoint.exists()
    assert not (tmp_path / "gone").exists()


def test_yaml_is_data(tmp_path: Path) -> None:
    """An experiment file cannot make objects."""
    path = tmp_path / "evil.yaml"
    path.write_text(SMALL + f'title: !!python/object/apply:pathlib.Path.touch ["{tmp_path}/gone"]\n')
    with pytest.raises(SpecError, match=r"found the tag .!!python"):
        load_experiment(str(path))
    assert not (tmp_path / "gone").exists()


def status_of(url: str, token: str = "") -> int:
    """What a server answers."""
    request = urllib.request.Request(url, headers={"Authorization": f"Bearer {token}"} if token else {})
    try:
        with urllib.request.urlopen(request, timeout=10) as response:
            return int(response.status)
    except urllib.error.HTTPError as error:
        with error:
            return error.code


@pytest.mark.ray
def test_dashboard_without_the_token(head: Head) -> None:
    """Without it the dashboard shows that it is there, and nothing else; a job cannot be submitted."""
    assert {path: status_of(head.url + path) for path in OPEN} == OPEN
    assert {path: status_of(head.url + path) for path in CLOSED} == dict.fromkeys(CLOSED, 401)
    assert status_of(f"{head.url}/api/jobs/", "0" * 64) == 403
    assert status_of(f"{head.url}/api/jobs/", head.env["RAY_AUTH_TOKEN"]) == 200
    request = urllib.request.Request(f"{head.url}/api/jobs/", data=b'{"entrypoint": "id"}', method="POST")
    with pytest.raises(urllib.error.HTTPError, match="401") as caught:
        urllib.request.urlopen(request, timeout=10)
    caught.value.close()


@pytest.mark.ray
def test_gcs_without_the_token(head: Head) -> None:
    """So does the port that drivers and nodes connect to."""

    def ask(token: str) -> grpc.StatusCode:
        with grpc.insecure_channel(head.address) as channel:
            call = channel.unary_unary("/ray.rpc.NodeInfoGcsService/GetClusterId")
            metadata = [("authorization", f"Bearer {token}")] if token else None
            try:
                call(b"", metadata=metadata, timeout=10)
            except grpc.RpcError as error:
                return error.code()
        return grpc.StatusCode.OK

    assert ask("") is ask("0" * 64) is grpc.StatusCode.UNAUTHENTICATED
    assert ask(head.env["RAY_AUTH_TOKEN"]) is grpc.StatusCode.OK


@pytest.mark.ray
def test_no_secret_is_written(head: Head, small: Path, tmp_path: Path) -> None:
    """What the nodes have in their environment is in no result, no log, no metric, and no account of a job: of this
    one, and of all that were submitted to the same cluster before.
    """
    (tmp_path / ".env").write_text(f"PASSWORD={PLANTED['AWS_SECRET_ACCESS_KEY']}\n")
    words = ("--results", str(tmp_path / "there"), "--arms", "APEL", "--placement", "packed", "--follow")
    submitted = head.apel("submit", str(small), *words, cwd=tmp_path)
    job = submitted.stdout.splitlines()[0]
    said = [submitted.stdout, submitted.stderr, head.apel("status", job, "--json", cwd=tmp_path).stdout]
    said += [answer(f"{head.url}/api/jobs/", head.env)]
    node = json.loads(answer(f"{head.url}/api/v0/nodes", head.env))["data"]["result"]["result"][0]
    port = Path(head.temp_dir, "session_latest", f"metrics_export_port_{node['node_id']}").read_text()
    metrics = answer(f"http://127.0.0.1:{port.strip()}/metrics", {})
    assert "small-maze" in metrics
    folders = [Path(head.temp_dir, "session_latest", "logs"), tmp_path / "there", Path(head.env["XDG_STATE_HOME"])]
    files = [path for folder in folders for path in folder.rglob("*") if path.is_file()]
    assert {"manifest.json", "job.json"} <= {path.name for path in files}
    record = Path(head.env["XDG_STATE_HOME"], "apel", "jobs", job)
    assert stat.S_IMODE(record.stat().st_mode) == 0o700
    for secret in (*PLANTED.values(), head.env["RAY_AUTH_TOKEN"]):
        assert not [text for text in [*said, metrics] if secret in text]
        assert not [path for path in files if secret.encode() in path.read_bytes()]


def answer(url: str, env: Mapping[str, str]) -> str:
    """What a server answers to whoever has the token in ``env``."""
    headers = {"Authorization": f"Bearer {env['RAY_AUTH_TOKEN']}"} if env else {}
    with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=10) as response:
        return str(response.read().decode())
