"""``python -m jobs`` is the command ``apel``."""

from jobs.cli import main

main()
