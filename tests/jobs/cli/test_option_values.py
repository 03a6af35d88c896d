"""Values of options that cannot be: one clear error, exit code 2, and nothing is started or written."""

from __future__ import annotations

from pathlib import Path

import pytest

from jobs.experiment.yaml_source import SpecError
from jobs.remote.places import dashboard_address, ray_address
from tests.command_line import call

NO_NUMBER = ("nan", "inf", "1e400", "", "[/a]", "\x1b[2J")
NO_COUNT = ("nan", "[/a]", "0", "-1", "1.5", "9" * 40)
NO_ADDRESS = (
    "",
    " ",
    ":",
    "host:",
    ":6379",
    "host:0",
    "host:99999",
    "host:x",
    "a b:1",
    "\x1b[2J:1",
    "http://h:1",
    "[::1",
)
NO_DASHBOARD = (
    "",
    ":",
    "127.0.0.1:8265",
    "http://",
    "http://:8265",
    "http://[",
    "http://h:99999",
    "http://a b",
    "ftp://h",
)
VALUES = {
    ("run", "--runs"): NO_COUNT[:-1],
    ("run", "--seed"): (*NO_NUMBER, "-1", "1.5"),
    ("run", "--cpus"): NO_COUNT,
    ("run", "--shard-size"): NO_COUNT[:-1],
    ("run", "--checkpoint-episodes"): NO_COUNT[:-1],
    ("run", "--checkpoint-seconds"): (*NO_NUMBER, "-1"),
    ("run", "--arms"): ("", ",", "APEL,", "nobody", "[/red]"),
    ("run", "--placement"): ("", "remote", "[/red]"),
    ("run", "--address"): NO_ADDRESS,
    ("run", "--set"): ("", "=", "=1", "runs", "name=[/red]", "[/red]=1"),
    ("submit", "--address"): NO_DASHBOARD,
    ("submit", "--results"): ("here", "s3://key:secret@bucket/x"),
    ("submit", "--log"): ("tensorboard:here", "mlflow:sqlite:///here.db"),
    ("run", "--log"): (
        "",
        ":",
        "tensorboard:",
        "mlfow",
        "wandb:x",
        "no such:Name",
        "no_such:Name",
        "json:dumps",
        "a:",
        "[/a]",
    ),
    ("submit", "--module"): ("", "no such", "[/red]", "../up"),
    ("design", "--adapt-within"): (*NO_NUMBER, "0", "-1", "1e-300", "1e300"),
    ("design", "--rise-within"): (*NO_NUMBER, "0", "-1", "1e300"),
    ("design", "--explore"): (*NO_NUMBER, "0", "-1", "1", "1e-300", "5e-324"),
    ("watch", "--fps"): (*NO_NUMBER, "0", "51"),
    ("watch", "--max-frames"): NO_COUNT[:-1],
    ("reproduce", "--scale"): ("", "huge", "[/red]"),
    ("reproduce", "--group"): ("", "theory", "[/red]"),
}
CASES = [(command, f"{option}={value}") for (command, option), values in VALUES.items() for value in values]


@pytest.mark.parametrize(("command", "words"), CASES, ids=ascii)
def test_value_is_refused(
    command: str,
    words: str,
    small: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The message names the option or what was found; there is no traceback, and no file."""
    monkeypatch.chdir(tmp_path)
    subject = [str(small)] if command in ("run", "submit", "watch") else []
    local = ["--placement", "local"] if command == "run" and not words.startswith("--placement") else []
    code, error = call(capsys, command, *subject, *local, words)
    assert code == 2
    assert "Traceback" not in error
    assert "\x1b[2J" not in error
    assert {path.name for path in tmp_path.iterdir()} <= {small.name}


@pytest.mark.parametrize("word", ["\udcff", "a\udc80b"])
def test_bytes_that_are_no_text(word: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A shell may hand on bytes that are no UTF-8: they could be neither looked up nor shown."""
    for command in ("show", "run", "claims", "jobs"):
        code, error = call(capsys, command, word)
        assert (code, "expected text in UTF-8" in error) == (2, True)


@pytest.mark.parametrize("address", ["auto", "local", "head:6379", "10.0.0.1:6379", "[::1]:6379", "ray://head:10001"])
def test_addresses_of_clusters(address: str) -> None:
    """What Ray understands is left as it is."""
    assert ray_address("--address", address) == address


@pytest.mark.parametrize("address", ["http://127.0.0.1:8265", "https://head", "http://[::1]:8265", "https://h/path"])
def test_addresses_of_dashboards(address: str) -> None:
    """With or without a port or a path."""
    assert dashboard_address("--address", address) == address


@pytest.mark.parametrize("address", NO_ADDRESS)
def test_no_address(address: str) -> None:
    """Each is refused with what would be one."""
    with pytest.raises(SpecError, match="expected auto or HOST:PORT"):
        ray_address("--address", address)
