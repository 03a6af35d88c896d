"""A job whose driver is a process of its own, and may be started again and again."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from tests.soak.timeline import Tail, Timeline

PROJECT = Path(__file__).parents[2]


class Job:
    """The same command, time after time, until it says that all is done.

    Attributes
    ----------
    timeline:
        How far its shards have come.
    waits:
        What it said where it had to wait for an earlier driver.
    """

    def __init__(self, words: Sequence[str], folder: Path, timeline: Timeline) -> None:
        folder.mkdir(parents=True)
        self.timeline, self.waits = timeline, list[str]()
        self.num_sessions = 0
        self.began = time.monotonic()
        self._words, self._folder = list(words), folder
        self._driver: subprocess.Popen[bytes]
        self._tail: Tail
        self.start()

    def start(self) -> None:
        """Start the driver, once its predecessor is gone."""
        self.num_sessions += 1
        events = self._file("events")
        command = [sys.executable, "-m", "tests.soak.command", str(events), *self._words]
        with self._file("out").open("wb") as out, self._file("err").open("wb") as err:
            self._driver = subprocess.Popen(command, cwd=PROJECT, stdout=out, stderr=err)
        self._tail = Tail(events)

    def poll(self) -> int | None:
        """Take in what has happened; the exit code of the driver, None while it runs."""
        code = self._driver.poll()
        for event in self._tail.events():
            self.timeline.add(event)
            if event["what"] == "waiting":
                self.waits.append(event["message"])
        return code

    def wait(self, seconds: float) -> int:
        """The exit code of the driver once it is over.

        Raises
        ------
        TimeoutError
            If that takes longer.
        """
        deadline = time.monotonic() + seconds
        while (code := self.poll()) is None:
            if time.monotonic() > deadline:
                message = f"{self._file('out')}: expected the driver to end within {seconds:.0f} s, found it running"
                raise TimeoutError(message)
            time.sleep(0.05)
        return code

    def kill(self) -> int:
        """Kill the driver with signal 9; the number of the process."""
        self._driver.kill()
        self._driver.wait()
        self.poll()
        return self._driver.pid

    def said(self) -> str:
        """What the driver has written to its standard error, the storage library's own chatter left out."""
        lines = self._file("err").read_text(errors="replace").splitlines()
        return "\n".join(line for line in lines if "s3fs.cc" not in line)

    def close(self) -> None:
        """End the driver if it runs."""
        if self._driver.poll() is None:
            self.kill()

    def _file(self, kind: str) -> Path:
        return self._folder / f"session-{self.num_sessions:03d}.{kind}"
