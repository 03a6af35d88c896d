"""Readers name a folder of results, or one above it that leaves no doubt."""

from __future__ import annotations

from pathlib import Path

import pytest

from jobs.results.finding import results_at
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
