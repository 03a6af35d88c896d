"""Readers name a folder of results, or one above it that leaves no doubt."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Any

import pytest
from pyarrow import fs

from jobs.results.finding import results_at
from jobs.results.storage import Folder
from jobs.results.store import StoreError


def stored(folder: Path) -> Path:
    """A folder that looks like finished results."""
    folder.mkdir(parents=True)
    (folder / "runs.parquet").touch()
    return folder


@pytest.mark.parametrize("named", ["results/lander/1a", "results/lander", "results"])
def test_only_results(tmp_path: Path, named: str) -> None:
    """The folder itself, the experiment's, and the root lead to the same results."""
    one = stored(tmp_path / "results/lander/1a")
    assert results_at(str(tmp_path / named), print).folder.path() == str(one)


def test_several_results(tmp_path: Path) -> None:
    """Where there are several nobody guesses, and they are listed."""
    for name in ("1a", "2b"):
        stored(tmp_path / "lander" / name)
    with pytest.raises(StoreError, match=r"lander: found 2 results below it, expected one of them: .*1a, .*2b$"):
        results_at(str(tmp_path / "lander"), print)


def test_no_results(tmp_path: Path) -> None:
    """Of a folder without any, the message is that of the folder which was named; no link is followed."""
    elsewhere = stored(tmp_path / "elsewhere")
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "1a").symlink_to(elsewhere)
    with pytest.raises(StoreError, match=r"here: found no runs\.parquet, expected the folder of a finished experiment"):
        results_at(str(tmp_path / "here"), print).runs()


def test_file_in_the_place_of_a_folder(tmp_path: Path) -> None:
    """Whoever names a file of the results is told so."""
    one = stored(tmp_path / "results/lander/1a")
    with pytest.raises(StoreError, match=r"runs\.parquet: found a file, expected a folder with results"):
        results_at(str(one / "runs.parquet"), print)


class AwayAtFirst:
    """A file system whose first listing of a folder fails, as while a network is down."""

    type_name = "local"

    def __init__(self) -> None:
        self._real, self.has_failed = fs.LocalFileSystem(), False

    def get_file_info(self, what: Any) -> Any:
        if isinstance(what, fs.FileSelector) and not self.has_failed:
            self.has_failed = True
            raise OSError(errno.ECONNRESET, "reset")
        return self._real.get_file_info(what)


def test_listing_is_tried_again(tmp_path: Path) -> None:
    """A store that is away for a moment is asked again, also for the names in it."""
    stored(tmp_path / "lander")
    folder = Folder(str(tmp_path), sleep=lambda _: None)
    folder._filesystem = away = AwayAtFirst()
    assert folder.top_folder_names() == ["lander"]
    assert away.has_failed
