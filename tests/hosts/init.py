"""The first process of a host, as ``init: true`` has it: starts a command, passes SIGTERM on, collects what is left.

A script that needs nothing but Python: ``init.py COMMAND...``; it ends with the command's exit code.
"""

from __future__ import annotations

import os
import signal
import sys


def main(command: list[str]) -> int:
    """Run the command to its end."""
    child = os.fork()
    if not child:
        os.execvp(command[0], command)
    signal.signal(signal.SIGTERM, lambda number, _: os.kill(child, number))
    while True:
        pid, status = os.wait()
        if pid == child:
            return max(os.waitstatus_to_exitcode(status), -1) % 256


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
