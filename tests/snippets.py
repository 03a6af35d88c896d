"""Pieces of code, each in a new process that is forked from one which has imported what takes seconds to import."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

_SERVER = """
import importlib, json, os, sys, tempfile, traceback, warnings

def play(asked):
    os.environ.clear()
    os.environ.update(asked["env"])
    os.chdir(asked["cwd"])
    sys.path[:0] = asked["path"]
    sys.dont_write_bytecode = True
    warnings.simplefilter("always", RuntimeWarning)
    if "numba" in sys.modules:
        sys.modules["numba"].core.config.reload_config()
    exec(compile(asked["code"], "<snippet>", "exec"), {"__name__": "__main__"})

for name in sys.argv[1:]:
    importlib.import_module(name)
for line in sys.stdin:
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        child = os.fork()
        if not child:
            os.dup2(out.fileno(), 1)
            os.dup2(err.fileno(), 2)
            code = 1
            try:
                play(json.loads(line))
                code = 0
            except BaseException:
                traceback.print_exc()
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        out.seek(0), err.seek(0)
        print(json.dumps([code, out.read(), err.read()]), flush=True)
"""


class Snippets:
    """A process that plays them, one at a time."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def play(
        self, code: str, env: Mapping[str, str], cwd: Path | None = None, path: Sequence[str] = ()
    ) -> subprocess.CompletedProcess[str]:
        """What becomes of one, as `subprocess.run` tells it; ``path`` comes before all other folders of modules."""
        assert self._process.stdin
        assert self._process.stdout
        asked = {"code": code, "env": dict(env), "cwd": str(cwd or Path.cwd()), "path": list(path)}
        self._process.stdin.write(json.dumps(asked) + "\n")
        self._process.stdin.flush()
        return subprocess.CompletedProcess("snippet", *json.loads(self._process.stdout.readline()))


@contextmanager
def snippets(*modules: str) -> Iterator[Snippets]:
    """Start a process that imports these, without MKL's mode and numba's folder in its environment."""
    kept = {key: value for key, value in os.environ.items() if key not in ("MKL_CBWR", "NUMBA_CACHE_DIR")}
    with subprocess.Popen(
        [sys.executable, "-c", _SERVER, *modules],
        env=kept, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    ) as process:  # fmt: skip
        yield Snippets(process)
