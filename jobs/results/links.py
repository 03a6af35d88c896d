"""Symbolic links in results are not followed: whoever can write to results could let them lead anywhere.

That concerns what lies below a `jobs.results.storage.Folder`. Its own path may lead over links: whoever runs this has
named it. Object stores have no links.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

from pyarrow import fs


def first_link(filesystem: Any, base: str, name: str) -> str:
    """The shortest beginning of ``name``, a path below ``base``, that is a link; empty for none."""
    if filesystem.type_name != "local" or not name:
        return ""
    parts = name.split("/")
    beginnings = ("/".join(parts[: count + 1]) for count in range(len(parts)))
    return next((start for start in beginnings if os.path.islink(f"{base}/{start}")), "")  # noqa: PTH114 - no URI


def all_below(filesystem: Any, base: str) -> list[Any]:
    """What pyarrow knows of everything below a folder, links and what lies behind them apart; none without a folder."""
    if filesystem.type_name != "local":
        found: list[Any] = filesystem.get_file_info(fs.FileSelector(base, allow_not_found=True, recursive=True))
        return found
    return list(filesystem.get_file_info(list(_paths_below(base))))


def _paths_below(folder: str) -> Iterator[str]:
    with suppress(FileNotFoundError), os.scandir(folder) as entries:  # another process may delete it meanwhile
        for entry in entries:
            if not entry.is_symlink() and _is_text(entry.name):
                yield entry.path
                if entry.is_dir():
                    yield from _paths_below(entry.path)


def _is_text(name: str) -> bool:
    """Whether pyarrow can be asked for it; of what this program writes every name is."""
    return name.isascii() or name.encode("utf-8", "replace").decode() == name
