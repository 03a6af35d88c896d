"""The facts that ``apel doctor`` gathers, where they follow from something that a test can hold in its hand."""

from __future__ import annotations

import json
from importlib.metadata import version
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from jobs.doctor import gathering
from tests.command_line import called


def test_unmet_requirements() -> None:
    """The core's are told from an extra's; an extra that names another one needs what that needs."""
    required = [
        Requirement("numpy>=2"),
        Requirement("pydantic>=99"),
        Requirement('no-such-package>=1; extra == "service"'),
        Requirement('apel[service]; extra == "video"'),
        Requirement('pandas; extra == "video"'),
        Requirement('numba; python_version < "3.0"'),
    ]
    assert gathering.unmet(required, "") == {"pydantic>=99": version("pydantic")}
    assert gathering.unmet(required, "service") == {"no-such-package>=1": None}
    assert gathering.unmet(required, "video") == {"no-such-package>=1": None}


def test_pins_that_differ() -> None:
    """A comment, a package that is not here, and a local version make no difference."""
    here = version("numpy")
    pins = f"numpy=={here} # tested\nno-such-package==1.0\npydantic==0.1\n"
    assert gathering.differing(pins) == {"pydantic": ("0.1", version("pydantic"))}


def test_token(tmp_path: Path) -> None:
    """Found where Ray looks: in the environment, in the file that it names, in the home folder."""
    assert gathering.found_token({}, tmp_path).source == ""
    assert gathering.found_token({"RAY_AUTH_TOKEN": "secret"}, tmp_path).source == "RAY_AUTH_TOKEN"
    file = tmp_path / ".ray" / "auth_token"
    file.parent.mkdir()
    file.write_text("secret")
    file.chmod(0o600)
    found = gathering.found_token({"RAY_AUTH_MODE": "token"}, tmp_path)
    assert (found.mode, found.source, found.readable_by_others) == ("token", str(file), False)
    file.chmod(0o644)
    assert gathering.found_token({"RAY_AUTH_TOKEN_PATH": str(file)}, Path("/nowhere")).readable_by_others


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """The command says what is wrong, and ends with 1; what it prints for programs says the same."""
    monkeypatch.setattr(gathering, "_cluster_error", lambda address: f"could not reach {address}")
    (tmp_path / "file").write_text("")
    place = str(tmp_path / "file" / "results")
    ended = called(capsys, "doctor", "--results", place, "--address", "http://127.0.0.1:1")
    assert ended.code == 1
    assert f"BAD  results: {place}: " in ended.out
    assert "BAD  cluster: could not reach http://127.0.0.1:1" in ended.out
    ended = called(capsys, "doctor", "--results", str(tmp_path / "new"), "--address", "http://127.0.0.1:1", "--json")
    states = {one["subject"]: one["state"] for one in json.loads(ended.out)}
    assert states["results"] == "fine"
    assert states["cluster"] == "problem"
    assert not (tmp_path / "new").exists()
