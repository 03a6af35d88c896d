"""An experiment killed with SIGKILL in the middle, and resumed: the same rows as undisturbed.

::

    python -m benchmarks.killed_and_resumed pendulum FOLDER --set runs=2 --set episodes=20

In ``FOLDER/undisturbed`` it is played to its end. In ``FOLDER/killed`` its process dies at once when a shard has
written a checkpoint, and another one goes on. Runs and episodes are compared value for value.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd

from jobs.results.manifest import checked_manifest

_APEL = [sys.executable, "-c", "from jobs.cli.main import main; main()"]
_KEYS = ["arm", "sweep", "run_index"]


def main() -> None:
    """Play, kill, resume, compare, print as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("spec")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--set", action="append", default=[], dest="overrides")
    parser.add_argument("--arm", default="APEL", help="Killed when this one has a checkpoint.")
    arguments = parser.parse_args()
    sets = [word for one in arguments.overrides for word in ("--set", one)]
    command = [*_APEL, "run", arguments.spec, "--placement", "local", "--quiet", "--checkpoint-seconds", "2", *sets]
    undisturbed, killed = arguments.folder / "undisturbed", arguments.folder / "killed"
    subprocess.run([*command, "--results", str(undisturbed)], check=True)
    status = killed_at(f"*/*/checkpoints/arm={arguments.arm}/*.npz", [*command, "--results", str(killed)], killed)
    left = sorted(str(path.relative_to(killed)) for path in killed.glob("*/*/checkpoints/*/*.npz"))
    subprocess.run([*command, "--results", str(killed)], check=True)
    counts = {name: compared(name, undisturbed, killed) for name in ("runs.parquet", "episodes")}
    sessions = [
        len(checked_manifest(next(folder.glob("*/*/manifest.json")).read_bytes())["sessions"])
        for folder in (undisturbed, killed)
    ]
    found = {"spec": arguments.spec, "overrides": arguments.overrides, "exit_status": status, "checkpoints": left}
    print(json.dumps({**found, "equal_rows": counts, "sessions_in_manifests": sessions}))


def killed_at(pattern: str, command: list[str], results: Path) -> int:
    """Exit status of a process that is killed as soon as there is such a file."""
    with subprocess.Popen(command) as process:
        while process.poll() is None and not any(results.glob(pattern)):
            time.sleep(0.02)
        process.kill()
    return process.wait()


def compared(name: str, one: Path, other: Path) -> int:
    """How many rows are equal, which all of them are.

    Raises
    ------
    AssertionError
        If one is not.
    """
    tables = [rows(next(folder.glob(f"*/*/{name}"))) for folder in (one, other)]
    pd.testing.assert_frame_equal(*tables, check_exact=True)
    return len(tables[0])


def rows(path: Path) -> pd.DataFrame:
    """Sorted, lists as tuples of which no number is missing but as None."""
    table = pd.read_parquet(path)
    table["arm"] = table["arm"].astype(str)
    for column in table.columns:
        if table[column].map(lambda value: hasattr(value, "__len__") and not isinstance(value, str)).any():
            table[column] = [tuple(None if one != one else one for one in values) for values in table[column]]
    keys = [*_KEYS, "episode"] if "episode" in table else _KEYS
    return table.sort_values(keys).reset_index(drop=True)


if __name__ == "__main__":
    main()
