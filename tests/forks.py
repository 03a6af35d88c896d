"""Processes forked from one that has imported this project: an interpreter takes seconds to come so far.

Ray, which looks at its environment when it is imported, is imported after the fork.
"""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

BIN = Path(sys.executable).parent
_ROOT = Path(__file__).parents[1]
_COMMANDS = ("agent", "experiment", "job", "result", "run")
PRELOADED = ["tests.forks", "tests.same_rows", "apel", "cluster", "jobs.cli.main"]
PRELOADED += [f"jobs.cli.{kind}_commands" for kind in _COMMANDS]


def fork(function: Callable[..., Any], *arguments: Any, timeout: float = 400.0) -> int:
    """Call a function of some module in a process of its own; its exit code.

    Raises
    ------
    subprocess.TimeoutExpired
        If it takes longer; the process is killed then.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)
    process = context.Process(target=function, args=arguments)
    process.start()
    process.join(timeout)
    if process.exitcode is None:
        process.kill()
        process.join()
        raise subprocess.TimeoutExpired(str(arguments), timeout)
    return process.exitcode


def apel(
    *words: str, cwd: Path, env: Mapping[str, str], check: bool = True, timeout: float = 400.0
) -> subprocess.CompletedProcess[str]:
    """Call ``apel`` in this environment and no other, as `subprocess.run` would, with what it prints captured."""
    with tempfile.TemporaryDirectory() as folder:
        out, err = Path(folder, "out"), Path(folder, "err")
        code = fork(_command, words, str(cwd), dict(env), str(out), str(err), timeout=timeout)
        ended = subprocess.CompletedProcess(words, code, out.read_text(), err.read_text())
    if check:
        ended.check_returncode()
    return ended


def _command(words: tuple[str, ...], cwd: str, env: dict[str, str], out: str, err: str) -> None:
    """What the child does: become the command, with what it prints in files."""
    for descriptor, path in ((1, out), (2, err)):
        file = os.open(path, os.O_WRONLY | os.O_CREAT)
        os.dup2(file, descriptor)
        os.close(file)
    become(words, cwd, env)


def become(words: tuple[str, ...], cwd: str, env: Mapping[str, str]) -> None:
    """Go on as ``apel``, as the script in `BIN` would begin it."""
    assert "ray" not in sys.modules, "Ray has seen another environment"
    os.environ.clear()
    os.environ.update(env)
    os.chdir(cwd)
    given = [os.path.abspath(entry) for entry in env.get("PYTHONPATH", "").split(os.pathsep) if entry]  # noqa: PTH100
    sys.path[:] = [str(BIN), *given, *(entry for entry in sys.path if entry not in ("", str(_ROOT), *given))]
    sys.argv = [str(BIN / "apel"), *words]
    from jobs.cli.main import main

    main()
