"""``python -m apel`` is the command ``apel``.

The command belongs to `jobs`, which this package does not import: it is found as the installed entry point of its name.
"""

import sys
from importlib.metadata import entry_points


def run() -> None:
    """Run the command; where this package is not installed, say so."""
    commands = entry_points(group="console_scripts", name="apel")
    if not commands:
        sys.exit("error: found no installed command 'apel', expected this project to be installed: pip install .")
    commands["apel"].load()()


if __name__ == "__main__":
    run()
